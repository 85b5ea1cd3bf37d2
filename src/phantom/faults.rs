//! Faults of real surfaces, and what is counted of a made one.

use std::collections::HashMap;

use nalgebra::Point3;

use crate::mesh::TriangleMesh;

use super::random::Random;
use super::skeleton::Cut;

/// Moves every coordinate of every vertex by Gaussian noise.
pub(super) fn add_noise(mesh: &mut TriangleMesh, deviation: f64, random: &mut Random) {
    if deviation == 0.0 {
        return;
    }
    for coordinate in mesh.vertices.iter_mut().flat_map(|vertex| vertex.coords.iter_mut()) {
        *coordinate += deviation * random.normal();
    }
}

/// Whether the surface comes within a voxel of a cut: a thin branch may fall between the nodes.
pub(super) fn reaches(mesh: &TriangleMesh, cut: &Cut, voxel: f64) -> bool {
    mesh.vertices.iter().any(|vertex| {
        let away = vertex - cut.point;
        cut.normal.dot(&away) > -voxel && away.norm() < cut.radius + voxel
    })
}

/// Removes the cap of a cut: whatever reaches past half a voxel behind its plane, and what would hang on
/// the rim by a corner.
pub(super) fn open(mesh: &mut TriangleMesh, cut: &Cut, voxel: f64) {
    const BEHIND: f64 = 0.5;
    let gone = |vertex: &Point3<f64>| {
        let away = vertex - cut.point;
        cut.normal.dot(&away) > -BEHIND * voxel && away.norm() < 1.5 * cut.radius + voxel
    };
    let mut gone: Vec<bool> = mesh.vertices.iter().map(gone).collect();
    loop {
        mesh.triangles.retain(|triangle| !triangle.iter().any(|&vertex| gone[vertex as usize]));
        let pinched = pinched(mesh);
        if pinched.is_empty() {
            break;
        }
        for vertex in pinched {
            gone[vertex as usize] = true;
        }
    }
    drop_unused(mesh);
}

/// Vertices where the rim passes twice.
fn pinched(mesh: &TriangleMesh) -> Vec<u32> {
    let mut edges: HashMap<(u32, u32), i32> = HashMap::new();
    for [a, b, c] in &mesh.triangles {
        for (from, to) in [(a, b), (b, c), (c, a)] {
            *edges.entry((*from.min(to), *from.max(to))).or_default() += 1;
        }
    }
    let mut rims = vec![0; mesh.vertices.len()];
    for (&(from, to), _) in edges.iter().filter(|&(_, &count)| count == 1) {
        rims[from as usize] += 1;
        rims[to as usize] += 1;
    }
    (0..).zip(rims).filter(|&(_, count)| count > 2).map(|(vertex, _)| vertex).collect()
}

fn drop_unused(mesh: &mut TriangleMesh) {
    let mut place = vec![u32::MAX; mesh.vertices.len()];
    let mut vertices = Vec::new();
    for vertex in mesh.triangles.iter_mut().flatten() {
        let slot = &mut place[*vertex as usize];
        if *slot == u32::MAX {
            *slot = vertices.len() as u32;
            vertices.push(mesh.vertices[*vertex as usize]);
        }
        *vertex = *slot;
    }
    mesh.vertices = vertices;
}

/// Connected pieces.
pub(super) fn components(mesh: &TriangleMesh) -> usize {
    let mut parent: Vec<u32> = (0..mesh.vertices.len() as u32).collect();
    let mut count = mesh.vertices.len();
    for triangle in &mesh.triangles {
        for other in [triangle[1], triangle[2]] {
            let (a, b) = (root(&mut parent, triangle[0]), root(&mut parent, other));
            if a != b {
                parent[a.max(b) as usize] = a.min(b);
                count -= 1;
            }
        }
    }
    count
}

fn root(parent: &mut [u32], mut vertex: u32) -> u32 {
    while parent[vertex as usize] != vertex {
        parent[vertex as usize] = parent[parent[vertex as usize] as usize];
        vertex = parent[vertex as usize];
    }
    vertex
}

/// Genus of a closed surface in one piece, by Euler's formula: V - 3F/2 + F = 2 - 2g.
pub(super) fn genus(mesh: &TriangleMesh) -> Option<usize> {
    let characteristic = mesh.vertices.len() as i64 - mesh.triangles.len() as i64 / 2;
    usize::try_from(2 - characteristic).ok().map(|twice| twice / 2)
}

/// Diagonal of the bounding box.
pub(super) fn diagonal(mesh: &TriangleMesh) -> f64 {
    let mut vertices = mesh.vertices.iter();
    let Some(first) = vertices.next() else { return 0.0 };
    let (low, high) =
        vertices.fold((*first, *first), |(low, high), vertex| (low.inf(vertex), high.sup(vertex)));
    (high - low).norm()
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;

    /// An octahedron of half width 1.
    fn octahedron() -> TriangleMesh {
        let axis = |axis: usize, sign: f64| Point3::from(Vector3::ith(axis, sign));
        let vertices = (0..3).flat_map(|place| [axis(place, 1.0), axis(place, -1.0)]).collect();
        let triangles =
            vec![[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]];
        TriangleMesh { vertices, triangles }
    }

    #[test]
    fn an_octahedron_is_one_piece_of_genus_0() {
        let mesh = octahedron();
        assert_eq!((components(&mesh), genus(&mesh), diagonal(&mesh)), (1, Some(0), 12.0_f64.sqrt()));
    }

    #[test]
    fn an_opening_takes_the_cap_and_its_vertices() {
        let mut mesh = octahedron();
        let cut = Cut { point: Point3::new(0.0, 0.0, 1.0), normal: Vector3::z_axis(), radius: 1.0 };
        open(&mut mesh, &cut, 0.1);
        assert_eq!((mesh.vertices.len(), mesh.triangles.len()), (5, 4));
    }

    #[test]
    fn noise_has_its_deviation_and_no_noise_changes_nothing() {
        let clean = TriangleMesh { vertices: vec![Point3::origin(); 5000], triangles: Vec::new() };
        let mut mesh = clean.clone();
        add_noise(&mut mesh, 0.0, &mut Random::new(1));
        assert_eq!(mesh, clean);
        add_noise(&mut mesh, 0.25, &mut Random::new(1));
        let squares: f64 = mesh.vertices.iter().map(|vertex| vertex.coords.norm_squared()).sum();
        let deviation = (squares / 15_000.0).sqrt();
        assert!((deviation - 0.25).abs() < 0.01, "{deviation}");
    }
}
