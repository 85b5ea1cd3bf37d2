//! Which half-edges of a triangle soup lie against each other: the edges of the surface.

use std::f64::consts::TAU;

use nalgebra::Vector3;

use super::TriangleMesh;
use super::corner_table::{NONE, next, origin};
use super::edge_groups::{EdgeGroups, half_edge};
use super::sites::Sites;

/// What matching found and mended, for the warnings.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct MatchReport {
    /// Triangles turned to agree with their neighbours.
    pub flipped: Sites,
    /// Edges with more than two triangles, each by one of these.
    pub non_manifold_edges: Sites,
    /// Edges where no consistent orientation exists, each by one of its triangles; the surface is cut there.
    pub conflicting_edges: Sites,
}

/// Orients the triangles consistently (in place) and pairs their half-edges.
///
/// Returns for each half-edge its opposite or [`NONE`]. At edges with more than two triangles those of one surface are
/// paired, and others by angle around the edge, so that touching surfaces come apart. O(n log n) in the valence.
pub fn match_half_edges(mesh: &mut TriangleMesh) -> (Vec<u32>, MatchReport) {
    let mut report = MatchReport::default();
    let groups = EdgeGroups::of(mesh);
    report.flipped = orient(mesh, &groups);
    // Turning triangles renames their half-edges; group anew when any was turned.
    let groups = if report.flipped.count > 0 { EdgeGroups::of(mesh) } else { groups };
    let mut opposite = vec![NONE; 3 * mesh.triangles.len()];
    let mut patches = None;
    let mut pair = |a: u32, b: u32| {
        opposite[a as usize] = b;
        opposite[b as usize] = a;
    };
    for group in groups.iter() {
        match *group {
            [_] => {}
            [a, b] => {
                let (a, b) = (half_edge(a), half_edge(b));
                if origin(&mesh.triangles, a) != origin(&mesh.triangles, b) {
                    pair(a, b);
                } else {
                    report.conflicting_edges.add(a / 3);
                }
            }
            _ => {
                let group: Vec<u32> = group.iter().copied().map(half_edge).collect();
                report.non_manifold_edges.add(group[0] / 3);
                let patches = patches.get_or_insert_with(|| patches_of(mesh, &groups));
                let (own, rest) = pair_by_patch(mesh, &group, patches);
                own.into_iter().chain(pair_by_angle(mesh, &rest)).for_each(|(a, b)| pair(a, b));
            }
        }
    }
    (opposite, report)
}

/// Flood-fills orientation over the edges with exactly two triangles; the majority in each patch stays.
fn orient(mesh: &mut TriangleMesh, groups: &EdgeGroups) -> Sites {
    let pairs = || {
        groups.iter().filter_map(|group| match *group {
            [a, b] => Some((half_edge(a), half_edge(b))),
            _ => None,
        })
    };
    if pairs().all(|(a, b)| origin(&mesh.triangles, a) != origin(&mesh.triangles, b)) {
        return Sites::default();
    }
    let count = mesh.triangles.len();
    let mut mate = vec![NONE; 3 * count];
    for (a, b) in pairs() {
        mate[a as usize] = b;
        mate[b as usize] = a;
    }
    const UNSEEN: u8 = 2;
    let mut turned = vec![UNSEEN; count];
    let mut patch: Vec<u32> = Vec::new();
    let mut flips = Vec::new();
    for seed in 0..count {
        if turned[seed] != UNSEEN {
            continue;
        }
        turned[seed] = 0;
        patch.clear();
        patch.push(seed as u32);
        let mut cursor = 0;
        while cursor < patch.len() {
            let t = patch[cursor];
            cursor += 1;
            for h in 3 * t..3 * t + 3 {
                let other = mate[h as usize];
                if other == NONE || turned[(other / 3) as usize] != UNSEEN {
                    continue;
                }
                let same_direction = u8::from(origin(&mesh.triangles, h) == origin(&mesh.triangles, other));
                turned[(other / 3) as usize] = turned[t as usize] ^ same_direction;
                patch.push(other / 3);
            }
        }
        let turned_here = patch.iter().filter(|&&t| turned[t as usize] == 1).count();
        let minority = u8::from(2 * turned_here <= patch.len());
        flips.extend(patch.iter().copied().filter(|&t| turned[t as usize] == minority));
    }
    for &t in &flips {
        mesh.triangles[t as usize].swap(1, 2);
    }
    flips.sort_unstable();
    flips.into_iter().collect()
}

/// The patch of each triangle: what hangs together over edges with exactly two triangles.
fn patches_of(mesh: &TriangleMesh, groups: &EdgeGroups) -> Vec<u32> {
    let mut patch: Vec<u32> = (0..mesh.triangles.len() as u32).collect();
    // The root of a triangle's tree, which is halved on the way.
    let root = |patch: &mut [u32], mut t: u32| {
        while patch[t as usize] != t {
            let above = patch[patch[t as usize] as usize];
            patch[t as usize] = above;
            t = above;
        }
        t
    };
    for group in groups.iter() {
        if let [a, b] = *group {
            let (a, b) = (root(&mut patch, half_edge(a) / 3), root(&mut patch, half_edge(b) / 3));
            patch[a.max(b) as usize] = a.min(b);
        }
    }
    (0..patch.len() as u32).map(|t| root(&mut patch, t)).collect()
}

/// Pairs the two half-edges of a patch that runs through an edge on which others stand, a sheet or another solid;
/// returns the pairs, and the half-edges that are left.
fn pair_by_patch(mesh: &TriangleMesh, group: &[u32], patches: &[u32]) -> (Vec<(u32, u32)>, Vec<u32>) {
    let patch = |h: u32| patches[(h / 3) as usize];
    let mut sorted = group.to_vec();
    sorted.sort_unstable_by_key(|&h| (patch(h), h));
    let mut pairs = Vec::new();
    let mut rest = Vec::new();
    for own in sorted.chunk_by(|&a, &b| patch(a) == patch(b)) {
        match *own {
            [a, b] if origin(&mesh.triangles, a) != origin(&mesh.triangles, b) => pairs.push((a, b)),
            _ => rest.extend_from_slice(own),
        }
    }
    rest.sort_unstable();
    (pairs, rest)
}

/// Pairs the triangles around an edge so that each pair bounds one wedge of the inside.
fn pair_by_angle(mesh: &TriangleMesh, group: &[u32]) -> Vec<(u32, u32)> {
    let Some(&first) = group.first() else { return Vec::new() };
    let low = group.iter().map(|&h| origin(&mesh.triangles, h)).min().unwrap_or(0);
    let triangle = mesh.triangles[(first / 3) as usize];
    let (a, b) = (triangle[(first % 3) as usize], triangle[(next(first) % 3) as usize]);
    let (from, to) = if a == low { (a, b) } else { (b, a) };
    let axis = mesh.vertices[to as usize] - mesh.vertices[from as usize];
    let axis = axis.try_normalize(0.0).unwrap_or_else(Vector3::z);
    let mut frame: Option<(Vector3<f64>, Vector3<f64>)> = None;
    let mut fans: Vec<(f64, bool, u32)> = Vec::with_capacity(group.len());
    for &h in group {
        let corners = mesh.triangles[(h / 3) as usize];
        let apex = corners[((h % 3 + 2) % 3) as usize];
        let arm = mesh.vertices[apex as usize] - mesh.vertices[from as usize];
        let arm = arm - axis * axis.dot(&arm);
        let (u, v) = *frame.get_or_insert_with(|| {
            let u = arm.try_normalize(0.0).unwrap_or_else(|| axis.yzx().cross(&axis));
            (u, axis.cross(&u))
        });
        let angle = arm.dot(&v).atan2(arm.dot(&u)).rem_euclid(TAU);
        fans.push((angle, origin(&mesh.triangles, h) == low, h));
    }
    fans.sort_by(|x, y| x.0.total_cmp(&y.0).then(x.2.cmp(&y.2)));
    // With outward normals, the inside of a forward triangle lies on the side of smaller angles.
    let mut pairs = Vec::new();
    let mut used = vec![false; fans.len()];
    for i in 0..fans.len() {
        if !fans[i].1 || used[i] {
            continue;
        }
        let before = (1..fans.len()).map(|step| (i + fans.len() - step) % fans.len());
        if let Some(j) = before.into_iter().find(|&j| !fans[j].1 && !used[j]) {
            used[i] = true;
            used[j] = true;
            pairs.push((fans[i].2, fans[j].2));
        }
    }
    pairs
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;

    fn tetrahedron(shift: f64, base: u32) -> (Vec<Point3<f64>>, Vec<[u32; 3]>) {
        let at = |x: f64, y: f64, z: f64| Point3::new(x + shift, y, z);
        let vertices = vec![at(0., 0., 0.), at(1., 0., 0.), at(0., 1., 0.), at(0., 0., 1.)];
        let triangles = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]].map(|t| t.map(|v| v + base));
        (vertices, triangles.to_vec())
    }

    #[test]
    fn a_flipped_triangle_is_turned_back() {
        let (vertices, mut triangles) = tetrahedron(0.0, 0);
        triangles[2].swap(0, 1);
        let mut mesh = TriangleMesh { vertices, triangles };
        let (opposite, report) = match_half_edges(&mut mesh);
        assert_eq!(report, MatchReport { flipped: [2].into_iter().collect(), ..Default::default() });
        assert!(opposite.iter().all(|&h| h != NONE));
    }

    #[test]
    fn two_solids_that_share_an_edge_come_apart() {
        // The second solid is the first turned by 180 degrees around the z axis: they share edge (0, 3).
        let (mut vertices, mut triangles) = tetrahedron(0.0, 0);
        vertices.extend([Point3::new(-1., 0., 0.), Point3::new(0., -1., 0.)]);
        triangles.extend([[0, 5, 4], [0, 4, 3], [4, 5, 3], [0, 3, 5]]);
        let mut mesh = TriangleMesh { vertices, triangles };
        let (opposite, report) = match_half_edges(&mut mesh);
        assert_eq!(report.non_manifold_edges.count, 1);
        for (h, &o) in opposite.iter().enumerate() {
            assert_eq!((h / 3) / 4, (o as usize / 3) / 4, "half-edge {h} is paired with the other solid");
        }
    }
}
