//! The end of the surface that geodesic distances are best taken from: the widest one, all of its cap.
//!
//! A front that starts at one vertex of a wide end's rim, or enters a wide vessel from a thin side
//! branch, runs aslant there and hides short trunks; one that starts from a whole cap does not.

use nalgebra::{Point3, Vector3};

use crate::mesh::corner_table::next;
use crate::mesh::preparation::Surface;

use crate::centerline::segmentation::level_sets::{LevelSet, level_set};
use crate::centerline::tips::Chain;
use crate::centerline::tips::reeb::ReebGraph;

/// Where to take distances from.
#[derive(Debug, Clone, PartialEq)]
pub struct Root {
    pub vertex: u32,
    /// Marks the vertices of the cap around it.
    pub cap: Vec<bool>,
}

/// An end of a chain, seen from the tip inward.
struct End {
    vertex: u32,
    radius: f64,
    /// Unit direction out of the lumen.
    outward: Vector3<f64>,
}

/// The widest end of the chains that is no sac. `None` when no chain has an end.
pub fn root(surface: &Surface, graph: &ReebGraph, chains: &[Chain]) -> Option<Root> {
    let mut degree = vec![0usize; graph.nodes.len()];
    for chain in chains {
        degree[chain.from as usize] += 1;
        degree[chain.to as usize] += 1;
    }
    let mut widest: Option<End> = None;
    for chain in chains {
        for at_start in [true, false] {
            let node = if at_start { chain.from } else { chain.to };
            if degree[node as usize] != 1 {
                continue;
            }
            let Some(end) = end_of(surface, graph, chain, at_start) else { continue };
            if widest.as_ref().is_none_or(|best| end.radius > best.radius) {
                widest = Some(end);
            }
        }
    }
    let end = widest?;
    let cap = cap_around(surface, &end);
    Some(Root { vertex: end.vertex, cap })
}

/// Width and direction of a chain's end; `None` for one shorter than it is wide (a sac, a stump).
fn end_of(surface: &Surface, graph: &ReebGraph, chain: &Chain, at_start: bool) -> Option<End> {
    const LEVELS: usize = 12;
    /// Least length of an end that may be the root, in radii.
    const LEAST: f64 = 1.5;
    let node = if at_start { chain.from } else { chain.to };
    let vertex = graph.nodes[node as usize].vertex;
    let tip = surface.mesh.vertices[vertex as usize];
    let mut rings: Vec<LevelSet> = Vec::new();
    for &(arc, upward) in &chain.arcs {
        let data = &graph.arcs[arc as usize];
        let (low, high) = (graph.nodes[data.lower as usize].level, graph.nodes[data.upper as usize].level);
        for i in 0..LEVELS {
            let share = (i as f64 + 0.5) / LEVELS as f64;
            let level = low + (high - low) * if upward { share } else { 1.0 - share };
            rings.push(level_set(&surface.mesh.vertices, &surface.corners, graph, arc as usize, level));
        }
    }
    if at_start {
        rings.reverse();
    }
    let mut radii: Vec<f64> = rings.iter().map(LevelSet::radius).collect();
    radii.sort_by(f64::total_cmp);
    let radius = *radii.get(radii.len() / 2)?;
    let base = rings.first()?.centroid;
    if (tip - base).norm() < LEAST * radius {
        return None;
    }
    let away = |p: &Point3<f64>| (p - tip).norm();
    let near =
        rings.iter().rev().find(|ring| away(&ring.centroid) > 1.5 * radius).map_or(base, |r| r.centroid);
    let far =
        rings.iter().rev().find(|ring| away(&ring.centroid) > 3.0 * radius).map_or(base, |r| r.centroid);
    let outward = (near - far).try_normalize(1e-6 * radius).or_else(|| (tip - near).try_normalize(0.0))?;
    Some(End { vertex, radius, outward })
}

/// The vertices of the triangles around an end that face outward, connected to its vertex.
fn cap_around(surface: &Surface, end: &End) -> Vec<bool> {
    /// Cosine of the widest angle between a cap's normal and the vessel's direction.
    const FACING: f64 = 0.7;
    let corners = &surface.corners;
    let tip = surface.mesh.vertices[end.vertex as usize];
    let mut cap = vec![false; surface.mesh.vertices.len()];
    cap[end.vertex as usize] = true;
    let faces_out = |t: u32| {
        let [a, b, c] = surface.mesh.triangles[t as usize].map(|v| surface.mesh.vertices[v as usize]);
        let normal = (b - a).cross(&(c - a));
        let near = (a - tip).norm() < 2.5 * end.radius;
        near && normal.dot(&end.outward) > FACING * normal.norm()
    };
    let mut seen = std::collections::BTreeSet::new();
    let mut queue: Vec<u32> = corners.star(end.vertex).map(|h| h / 3).collect();
    while let Some(t) = queue.pop() {
        if !seen.insert(t) || !faces_out(t) {
            continue;
        }
        for h in [3 * t, next(3 * t), next(next(3 * t))] {
            cap[corners.origin(h) as usize] = true;
            queue.push(corners.opposite(h) / 3);
        }
    }
    cap
}
