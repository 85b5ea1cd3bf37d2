//! Phantoms of many seeds: surfaces that are what their known centerline says.
#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

use std::collections::HashMap;

use nalgebra::Point3;
use rosaline::mesh::TriangleMesh;
use rosaline::mesh::format::{Hint, Limits, read, write_stl_binary};
use rosaline::phantom::{Kind, Phantom, Settings, generate};

const SEEDS: std::ops::Range<u64> = 1..4;

/// Kinds that are made in well under a second in a debug build.
fn kinds() -> impl Iterator<Item = Kind> {
    Kind::ALL.into_iter().filter(|&kind| kind != Kind::Bigtree)
}

/// The rims of a surface that is manifold: every edge has one triangle on each side, or one at all,
/// and at every vertex the triangles make one fan. Panics when it is not.
fn rims(mesh: &TriangleMesh) -> usize {
    let mut next: HashMap<(u32, u32), u32> = HashMap::new();
    for &[a, b, c] in &mesh.triangles {
        for (from, to, other) in [(a, b, c), (b, c, a), (c, a, b)] {
            assert!(next.insert((from, to), other).is_none(), "edge {from}-{to} twice in one direction");
        }
    }
    let mut corners = vec![0; mesh.vertices.len()];
    for &vertex in mesh.triangles.iter().flatten() {
        corners[vertex as usize] += 1;
    }
    // From each edge out of a vertex to the next one around it; a rim's first edge has none before it.
    let mut starts: HashMap<u32, u32> = next.keys().map(|&(from, to)| (from, to)).collect();
    for (&(from, to), _) in next.iter().filter(|((from, to), _)| !next.contains_key(&(*to, *from))) {
        starts.insert(from, to);
    }
    for (&vertex, &first) in &starts {
        let (mut at, mut count) = (first, 0);
        while let Some(&other) = next.get(&(vertex, at)) {
            count += 1;
            at = other;
            if at == first {
                break;
            }
        }
        assert_eq!(count, corners[vertex as usize], "vertex {vertex} has two fans");
    }
    let mut rim: HashMap<u32, u32> = next
        .keys()
        .filter(|&&(from, to)| !next.contains_key(&(to, from)))
        .map(|&(from, to)| (to, from))
        .collect();
    let mut count = 0;
    while let Some(&start) = rim.keys().next() {
        let mut at = start;
        while let Some(after) = rim.remove(&at) {
            at = after;
        }
        count += 1;
    }
    count
}

fn volume(mesh: &TriangleMesh) -> f64 {
    let corner = |vertex: u32| mesh.vertices[vertex as usize].coords;
    let part = |&[a, b, c]: &[u32; 3]| corner(a).dot(&corner(b).cross(&corner(c))) / 6.0;
    mesh.triangles.iter().map(part).sum()
}

/// V - E + F of a closed surface is 2 - 2 genus.
fn genus(mesh: &TriangleMesh) -> i64 {
    let characteristic = mesh.vertices.len() as i64 - mesh.triangles.len() as i64 / 2;
    (2 - characteristic) / 2
}

/// Distances of vertices from the wall of the spheres, without those near a tip or in a sac.
fn deviations(phantom: &Phantom) -> Vec<f64> {
    let line = &phantom.centerline;
    let balls: Vec<_> =
        line.branches.iter().flat_map(|branch| branch.points.iter().zip(&branch.radii)).collect();
    let ends: Vec<_> = (0..line.nodes.len())
        .filter(|&node| line.degree(node) == 1)
        .map(|node| (line.nodes[node].position, line.nodes[node].radius.max(5.0)))
        .collect();
    let near_end = |point: &Point3<f64>| ends.iter().any(|(end, reach)| (point - end).norm() < 2.0 * reach);
    let vertices = phantom.mesh.vertices.iter().step_by(23).filter(|point| !near_end(point));
    let field = |point: &Point3<f64>| {
        let values = balls.iter().map(|(centre, radius)| (point - **centre).norm() - **radius);
        values.fold(f64::INFINITY, f64::min)
    };
    vertices.map(field).collect()
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

#[test]
fn every_clean_phantom_is_a_closed_manifold_of_its_topology() {
    for (kind, tips, loops) in [
        (Kind::Tube, 2, 0),
        (Kind::Bifurcation, 3, 0),
        (Kind::Tree, 9, 0),
        (Kind::Trifurcation, 10, 0),
        (Kind::Loop, 3, 1),
        (Kind::Aneurysm, 4, 0),
        (Kind::Stenosis, 2, 0),
        (Kind::Mixed, 7, 0),
        (Kind::Parallel, 3, 0),
    ] {
        for seed in SEEDS {
            let phantom = generate(kind, seed, &Settings::of(kind)).unwrap();
            assert_eq!(rims(&phantom.mesh), 0, "{kind} {seed}");
            assert_eq!(genus(&phantom.mesh), loops, "{kind} {seed}");
            assert!(volume(&phantom.mesh) > 0.0, "{kind} {seed}: normals point out");
            let line = &phantom.centerline;
            let ends = (0..line.nodes.len()).filter(|&node| line.degree(node) == 1).count();
            assert_eq!(ends, tips, "{kind} {seed}");
            assert_eq!(line.branches.len() as i64 - line.nodes.len() as i64 + 1, loops, "{kind} {seed}");
        }
    }
}

#[test]
fn the_wall_is_where_the_known_radii_say() {
    for kind in kinds() {
        let phantom = generate(kind, 2, &Settings::of(kind)).unwrap();
        let deviations = deviations(&phantom);
        assert!(deviations.len() > 100, "{kind}");
        let voxel = kind.voxel();
        let worst = deviations.iter().fold(0.0_f64, |worst, value| worst.max(value.abs()));
        assert!(worst < 0.25 * voxel, "{kind}: {worst}");
        assert!(mean(&deviations).abs() < 0.03 * voxel, "{kind}: {}", mean(&deviations));
    }
}

#[test]
fn branches_start_and_end_on_their_nodes_in_small_steps() {
    for kind in kinds() {
        let line = generate(kind, 3, &Settings::of(kind)).unwrap().centerline;
        for branch in &line.branches {
            assert_eq!(branch.points[0], line.nodes[branch.from].position, "{kind}");
            assert_eq!(*branch.points.last().unwrap(), line.nodes[branch.to].position, "{kind}");
            let steps = branch.points.windows(2).map(|pair| (pair[1] - pair[0]).norm());
            assert!(steps.into_iter().all(|step| step > 0.0 && step < 0.2), "{kind}");
        }
    }
}

#[test]
fn voxels_make_stairs_on_the_same_line() {
    for kind in [Kind::Tree, Kind::Loop, Kind::Mixed, Kind::Aneurysm] {
        let clean = generate(kind, 1, &Settings::of(kind)).unwrap();
        let stair = generate(kind, 1, &Settings { stair: true, ..Settings::of(kind) }).unwrap();
        assert_eq!(stair.centerline, clean.centerline, "{kind}");
        assert_eq!((rims(&stair.mesh), genus(&stair.mesh)), (0, genus(&clean.mesh)), "{kind}");
        let rough = deviations(&stair).iter().map(|value| value.abs()).collect::<Vec<_>>();
        let rough = mean(&rough) / kind.voxel();
        assert!((0.1..0.5).contains(&rough), "{kind}: {rough}");
    }
}

#[test]
fn noise_moves_the_vertices_of_the_clean_surface() {
    let settings = Settings::of(Kind::Tree);
    let clean = generate(Kind::Tree, 1, &settings).unwrap();
    let noisy = generate(Kind::Tree, 1, &Settings { noise: 0.2, ..settings }).unwrap();
    assert_eq!(noisy.centerline, clean.centerline);
    assert_eq!(noisy.mesh.triangles, clean.mesh.triangles);
    let squares = clean.mesh.vertices.iter().zip(&noisy.mesh.vertices);
    let squares: Vec<_> = squares.map(|(a, b)| (a - b).norm_squared() / 3.0).collect();
    let deviation = mean(&squares).sqrt();
    assert!((deviation - 0.2 * settings.voxel).abs() < 0.002, "{deviation}");
}

#[test]
fn an_open_phantom_has_a_rim_at_every_flat_tip() {
    for (kind, tips) in [(Kind::Tree, 9), (Kind::Loop, 3), (Kind::Aneurysm, 3), (Kind::Mixed, 7)] {
        for seed in SEEDS {
            for stair in [false, true] {
                let settings = Settings { open: true, stair, ..Settings::of(kind) };
                let phantom = generate(kind, seed, &settings).unwrap();
                assert_eq!(rims(&phantom.mesh), tips, "{kind} {seed}");
                assert_eq!(phantom.surface.openings, tips, "{kind} {seed}");
            }
        }
    }
}

#[test]
fn coarse_voxels_keep_the_topology() {
    // The gap of the parallel vessels is half of such a voxel.
    for kind in kinds().filter(|&kind| kind != Kind::Parallel) {
        for seed in SEEDS {
            let settings = Settings { voxel: 3.0 * kind.voxel(), ..Settings::of(kind) };
            let coarse = generate(kind, seed, &settings).unwrap();
            assert_eq!(rims(&coarse.mesh), 0, "{kind} {seed}");
            let fine = generate(kind, seed, &Settings::of(kind)).unwrap();
            assert_eq!(genus(&coarse.mesh), genus(&fine.mesh), "{kind} {seed}");
            let share = coarse.mesh.vertices.len() as f64 / fine.mesh.vertices.len() as f64;
            assert!((0.07..0.16).contains(&share), "{kind} {seed}: {share}");
        }
    }
}

#[test]
fn the_same_seed_gives_the_same_bytes_and_another_seed_another_vessel() {
    let settings = Settings { noise: 0.2, ..Settings::of(Kind::Tree) };
    let first = generate(Kind::Tree, 5, &settings).unwrap();
    assert_eq!(first, generate(Kind::Tree, 5, &settings).unwrap());
    assert_ne!(first.centerline, generate(Kind::Tree, 6, &settings).unwrap().centerline);
}

/// Float coordinates must not make two vertices one, or a reader would weld them.
#[test]
fn a_phantom_comes_back_whole_through_stl() {
    for kind in kinds() {
        let phantom = generate(kind, 4, &Settings::of(kind)).unwrap();
        let mut bytes = Vec::new();
        write_stl_binary(&phantom.mesh, &mut bytes).unwrap();
        let (mesh, _) = read(&bytes, Hint::default(), &Limits::default()).unwrap();
        assert_eq!(mesh.vertices.len(), phantom.surface.vertices, "{kind}");
        assert_eq!(mesh.triangles.len(), phantom.surface.triangles, "{kind}");
    }
}
