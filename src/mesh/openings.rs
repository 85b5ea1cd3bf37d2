//! Openings: where the vessel was cut. Each is closed by a cap. A hole in the wall is closed too, and is none.

use std::ops::Range;

use nalgebra::{Point3, Vector3};
use rustc_hash::FxHashSet;

use super::TriangleMesh;
use super::corner_table::{NONE, next, previous};
use super::preparation::Surface;
use super::sites::Sites;

/// An opening of the surface, closed by a fan of triangles around its centre.
#[derive(Debug, Clone, PartialEq)]
pub struct Opening {
    /// The vertex that was put at the centre of the rim.
    pub centre: u32,
    /// Vertices of the rim, in order.
    pub rim: Vec<u32>,
    /// Length of the rim over 2 pi: the radius of the circle with that circumference.
    pub radius: f64,
    /// The triangles of the fan.
    pub cap: Range<u32>,
    /// Whether the mesh had closed it itself, by a plane.
    pub was_closed: bool,
}

impl Opening {
    /// Of its cap, out of the vessel, twice its area long; zero where the rim encloses nothing. `mesh` is its surface's.
    pub fn area_vector(&self, mesh: &TriangleMesh) -> Vector3<f64> {
        self.cap.clone().map(|t| mesh.area_vector(t)).sum()
    }

    /// Radius of the circle with the area within its rim, which a jagged rim does not lengthen.
    pub fn area_radius(&self, mesh: &TriangleMesh) -> f64 {
        (0.5 * self.area_vector(mesh).norm() / std::f64::consts::PI).sqrt()
    }
}

impl Surface {
    /// Whether a triangle closes an opening: it is no wall. O(log openings).
    pub fn is_cap(&self, triangle: u32) -> bool {
        self.opening_of(triangle).is_some()
    }

    /// The opening that a triangle closes. O(log openings).
    pub fn opening_of(&self, triangle: u32) -> Option<&Opening> {
        let after = self.openings.partition_point(|opening| opening.cap.start <= triangle);
        self.openings[..after].last().filter(|opening| opening.cap.contains(&triangle))
    }

    /// The opening whose centre a vertex is. O(log openings).
    pub fn opening_at(&self, vertex: u32) -> Option<&Opening> {
        // All triangles of a centre are its cap's.
        let opening = self.opening_of(self.corners.outgoing(vertex) / 3);
        opening.filter(|opening| opening.centre == vertex)
    }
}

/// Closes every boundary loop by a fan around the centre of its rim; returns the openings, and a vertex of each hole
/// that is none. Rims of vertices in `closed` are those of flat caps. O(boundary edges).
pub(super) fn cap(
    mesh: &mut TriangleMesh,
    opposite: &mut Vec<u32>,
    closed: &FxHashSet<u32>,
) -> (Vec<Opening>, Sites) {
    let mut openings = Vec::new();
    let mut holes = Sites::default();
    let half_edges = opposite.len() as u32;
    for start in 0..half_edges {
        if opposite[start as usize] != NONE {
            continue;
        }
        let rim_edges = boundary_loop(opposite, start);
        if let [a, b] = rim_edges[..] {
            opposite[a as usize] = b;
            opposite[b as usize] = a;
            continue;
        }
        let origin = |h: u32| mesh.triangles[(h / 3) as usize][(h % 3) as usize];
        let rim: Vec<u32> = rim_edges.iter().map(|&h| origin(h)).collect();
        let was_closed = closed.contains(&rim[0]);
        let is_hole = !was_closed && is_hole(mesh, opposite, &rim_edges);
        let (centre_point, length) = rim_centre(mesh, &rim);
        let centre = mesh.vertices.len() as u32;
        mesh.vertices.push(centre_point);
        let first_cap = opposite.len() as u32;
        let count = rim.len() as u32;
        for (i, &h) in rim_edges.iter().enumerate() {
            // The cap runs against the wall: from the rim edge's end to its start, then to the centre.
            let end = rim[(i + 1) % rim.len()];
            mesh.triangles.push([end, rim[i], centre]);
            let own = first_cap + 3 * i as u32;
            let before = first_cap + 3 * ((i as u32 + count - 1) % count);
            let after = first_cap + 3 * ((i as u32 + 1) % count);
            opposite[h as usize] = own;
            opposite.extend([h, before + 2, after + 1]);
        }
        if is_hole {
            holes.add(rim[0]);
            continue;
        }
        let cap = first_cap / 3..first_cap / 3 + count;
        openings.push(Opening { centre, rim, radius: length / std::f64::consts::TAU, cap, was_closed });
    }
    (openings, holes)
}

/// Whether a rim is that of a hole torn in the wall: there the wall around it faces where the hole does, around the
/// opening of a vessel it faces aside. O(triangles near the rim).
fn is_hole(mesh: &TriangleMesh, opposite: &[u32], rim_edges: &[u32]) -> bool {
    /// Mean cosine of the angle between both from which a hole is one. Around a vessel that widens or narrows toward
    /// its cut by less than 30 degrees it is lower.
    const FACING: f64 = 0.5;
    let at = |h: u32| mesh.vertices[mesh.triangles[(h / 3) as usize][(h % 3) as usize] as usize];
    let first = at(rim_edges[0]);
    // The rim runs with the wall on its left, a cap against it.
    let hole: Vector3<f64> = rim_edges.iter().map(|&h| (at(next(h)) - first).cross(&(at(h) - first))).sum();
    let (mut facing, mut all) = (0.0, 0.0);
    for t in wall_around(mesh, opposite, rim_edges) {
        let area = mesh.area_vector(t);
        facing += area.dot(&hole);
        all += area.norm() * hole.norm();
    }
    facing > FACING * all
}

/// The triangles that touch a rim, and those within half its radius of it: marching cubes leaves a chamfer around a cut.
fn wall_around(mesh: &TriangleMesh, opposite: &[u32], rim_edges: &[u32]) -> Vec<u32> {
    const NEAR: f64 = 0.5;
    let at = |h: u32| mesh.vertices[mesh.triangles[(h / 3) as usize][(h % 3) as usize] as usize];
    let length: f64 = rim_edges.iter().map(|&h| (at(next(h)) - at(h)).norm()).sum();
    let reach = NEAR * length / std::f64::consts::TAU;
    let mut seen = FxHashSet::default();
    // Each with the place on the rim that it was come to from.
    let mut found: Vec<(u32, Point3<f64>)> = Vec::new();
    for &edge in rim_edges {
        // The triangles around the edge's first vertex, up to the rim's edge before.
        let mut spoke = edge;
        while spoke != NONE {
            if seen.insert(spoke / 3) {
                found.push((spoke / 3, at(edge)));
            }
            spoke = opposite[previous(spoke) as usize];
        }
    }
    let mut place = 0;
    while let Some(&(t, from)) = found.get(place) {
        place += 1;
        for o in (3 * t..3 * t + 3).map(|h| opposite[h as usize]).filter(|&o| o != NONE) {
            if (at(previous(o)) - from).norm() < reach && seen.insert(o / 3) {
                found.push((o / 3, from));
            }
        }
    }
    found.into_iter().map(|(t, _)| t).collect()
}

/// The boundary half-edges of one opening, each starting where the one before ends.
fn boundary_loop(opposite: &[u32], start: u32) -> Vec<u32> {
    let mut rim = vec![start];
    loop {
        let mut h = next(rim[rim.len() - 1]);
        while opposite[h as usize] != NONE {
            h = next(opposite[h as usize]);
        }
        if h == start {
            return rim;
        }
        rim.push(h);
    }
}

/// Centre of the rim, weighted by its edges' lengths, and its length.
pub(super) fn rim_centre(mesh: &TriangleMesh, rim: &[u32]) -> (Point3<f64>, f64) {
    let mut sum = Vector3::zeros();
    let mut length = 0.0;
    for (i, &v) in rim.iter().enumerate() {
        let (p, q) = (mesh.vertices[v as usize], mesh.vertices[rim[(i + 1) % rim.len()] as usize]);
        let weight = (q - p).norm();
        sum += (p.coords + q.coords) * (0.5 * weight);
        length += weight;
    }
    if length > 0.0 {
        (Point3::from(sum / length), length)
    } else {
        (rim.first().map_or_else(Point3::origin, |&v| mesh.vertices[v as usize]), 0.0)
    }
}
