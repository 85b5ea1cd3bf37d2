//! Level sets of the geodesic distance: the rings that a branch is first seen through.

use nalgebra::{Point3, Vector3};

use crate::mesh::corner_table::CornerTable;

use crate::centerline::tips::reeb::{LevelWalk, ReebGraph, crossing};

/// One component of a level set: a closed polygon on the surface.
#[derive(Debug, Clone)]
pub struct LevelSet {
    /// Crossings of the mesh's edges, in cyclic order.
    pub points: Vec<Point3<f64>>,
    /// The triangle between each point and the next.
    pub triangles: Vec<u32>,
    /// Centre of the polygon, weighted by length.
    pub centroid: Point3<f64>,
    /// Circumference.
    pub length: f64,
    /// The function on it.
    pub level: f64,
}

impl LevelSet {
    /// Radius of the circle with this circumference.
    pub fn radius(&self) -> f64 {
        self.length / std::f64::consts::TAU
    }

    /// Radius of the circle with the area that the polygon spans: zigzag adds nothing to it.
    pub fn area_radius(&self) -> f64 {
        let arms: Vec<Vector3<f64>> = self.points.iter().map(|point| point - self.centroid).collect();
        let twice: Vector3<f64> = arms.iter().zip(arms.iter().cycle().skip(1)).map(|(a, b)| a.cross(b)).sum();
        (0.5 * twice.norm() / std::f64::consts::PI).sqrt()
    }
}

/// The component of the level set at `level` that belongs to `arc`. O(its edges).
///
/// `level` must lie between the arc's nodes; just above the lower node if it is at or below it.
pub fn level_set(
    vertices: &[Point3<f64>],
    corners: &CornerTable,
    graph: &ReebGraph,
    arc: usize,
    level: f64,
) -> LevelSet {
    let (start, rank, level) = start_of(corners, graph, arc, level);
    let expected = graph.arcs[arc].base_edges as usize;
    let mut points = Vec::with_capacity(expected);
    let mut triangles = Vec::with_capacity(expected);
    for h in LevelWalk::new(corners, &graph.rank, rank, start) {
        points.push(crossing(vertices, corners, &graph.function, h, level));
        triangles.push(h / 3);
    }
    let (centroid, length) = polygon_centre(&points);
    LevelSet { points, triangles, centroid, length, level }
}

/// An upward half-edge that the level crosses on the arc, the level's rank, and the level itself.
fn start_of(corners: &CornerTable, graph: &ReebGraph, arc: usize, level: f64) -> (u32, u32, f64) {
    let arc = &graph.arcs[arc];
    let passed = graph.order.partition_point(|&v| graph.function[v as usize] <= level);
    let lower_rank = graph.rank[graph.nodes[arc.lower as usize].vertex as usize];
    let upper_rank = graph.rank[graph.nodes[arc.upper as usize].vertex as usize];
    let rank = (passed.max(1) as u32 - 1).clamp(lower_rank, upper_rank - 1);
    let level = level.max(graph.nodes[arc.lower as usize].level);
    let below = arc.vertices.partition_point(|&v| graph.rank[v as usize] <= rank);
    if below == 0 {
        return (arc.start, rank, level);
    }
    // Between this vertex and the next of its arc no vertex lies, so its upward edges all cross the level.
    let v = arc.vertices[below - 1];
    let upward = corners.star(v).find(|&h| graph.rank[corners.target(h) as usize] > rank);
    (upward.unwrap_or(arc.start), rank, level)
}

/// Centre and length of a closed polygon; the mean of the points where it has no length.
pub fn polygon_centre(points: &[Point3<f64>]) -> (Point3<f64>, f64) {
    let mut sum = Vector3::zeros();
    let mut plain = Vector3::zeros();
    let mut length = 0.0;
    let origin = points.first().copied().unwrap_or_else(Point3::origin);
    for (i, p) in points.iter().enumerate() {
        let q = points[(i + 1) % points.len()];
        let weight = (q - p).norm();
        sum += ((p - origin) + (q - origin)) * (0.5 * weight);
        plain += p - origin;
        length += weight;
    }
    if length > 0.0 {
        (origin + sum / length, length)
    } else {
        (origin + plain / points.len().max(1) as f64, 0.0)
    }
}
