//! Tips of the branches: critical points of a geodesic distance (IV.A, the paper's ref. 30).
//!
//! The distance from a root vertex at one extreme of the surface grows along every branch; a tip is a local
//! maximum, and the saddle where its branch meets a longer one bounds it. A maximum whose branch is shorter
//! than it is wide is a bump of the wall.

use std::f64::consts::TAU;

use nalgebra::Point3;

use crate::centerline::ExtractError;
use crate::centerline::control::CancelToken;
use crate::centerline::tips::geodesic::{EdgeGraph, Geodesic, geodesic};

/// A tip of a branch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tip {
    pub vertex: u32,
    /// Geodesic length from the saddle where the branch leaves a longer one to its tip; for the longest
    /// branch, and for the root, from the root to the farthest tip. In the input's unit.
    pub height: f64,
    /// Mean radius of that branch, less those that leave it: area over height and 2 pi.
    pub radius: f64,
}

/// The vertex at one extreme of the surface: the farthest from the farthest of an arbitrary one, with the
/// distances from it. Two Dijkstra runs.
pub fn root(graph: &EdgeGraph, cancel: &CancelToken) -> Result<(u32, Geodesic), ExtractError> {
    let first = geodesic(graph, &[0], cancel)?;
    let root = first.order.last().copied().unwrap_or(0);
    let from_root = geodesic(graph, &[root], cancel)?;
    Ok((root, from_root))
}

/// The root and the local maxima of the distance from it whose height is at least `tip_height` times the
/// radius of their branch, and one edge; highest first, so the first two are the ends of the longest way.
///
/// `O(n)` beyond the sort that `distances` brings along. `areas` in the square of the unit, one a vertex.
pub fn tips(graph: &EdgeGraph, distances: &Geodesic, areas: &[f64], tip_height: f64) -> Vec<Tip> {
    let mut peaks = Peaks::new(graph, tip_height);
    for &v in distances.order.iter().rev() {
        peaks.open(v, areas[v as usize]);
        for &(u, _) in graph.neighbours(v) {
            peaks.merge(v, u, &distances.distance);
        }
    }
    let Some(&root) = distances.order.first() else { return Vec::new() };
    let last = peaks.components.find(root);
    let whole = peaks.tip_of(last, 0.0, &distances.distance);
    let mut tips = peaks.tips;
    tips.extend([Tip { vertex: root, ..whole }, whole]);
    tips.sort_by(|a, b| b.height.total_cmp(&a.height).then(a.vertex.cmp(&b.vertex)));
    tips
}

/// A third of the area of the triangles at each vertex.
pub fn vertex_areas(positions: &[Point3<f64>], triangles: &[[u32; 3]]) -> Vec<f64> {
    let mut areas = vec![0.0; positions.len()];
    for triangle in triangles {
        let [a, b, c] = triangle.map(|v| positions[v as usize]);
        let third = (b - a).cross(&(c - a)).norm() / 6.0;
        triangle.iter().for_each(|&v| areas[v as usize] += third);
    }
    areas
}

/// Components of the part of the surface farther than a falling level.
struct Peaks<'a> {
    graph: &'a EdgeGraph,
    components: Components,
    /// Per component's representative: its highest vertex and its area.
    highest: Vec<u32>,
    area: Vec<f64>,
    opened: Vec<bool>,
    tip_height: f64,
    /// Maxima whose component was a branch when it met a higher one.
    tips: Vec<Tip>,
}

impl<'a> Peaks<'a> {
    fn new(graph: &'a EdgeGraph, tip_height: f64) -> Self {
        let vertices = graph.vertices();
        Self {
            graph,
            components: Components((0..vertices as u32).collect()),
            highest: (0..vertices as u32).collect(),
            area: vec![0.0; vertices],
            opened: vec![false; vertices],
            tip_height,
            tips: Vec::new(),
        }
    }

    fn open(&mut self, v: u32, area: f64) {
        self.opened[v as usize] = true;
        self.area[v as usize] = area;
    }

    /// Joins the components of `v`, at the level, and its neighbour `u`; that of the lower maximum is a
    /// branch with a tip, or a bump whose area belongs to the other.
    fn merge(&mut self, v: u32, u: u32, distance: &[f64]) {
        if !self.opened[u as usize] {
            return;
        }
        let (a, b) = (self.components.find(v), self.components.find(u));
        if a == b {
            return;
        }
        let level = distance[v as usize];
        let key = |c: u32| {
            (distance[self.highest[c as usize] as usize], std::cmp::Reverse(self.highest[c as usize]))
        };
        let (high, low) = if key(a) >= key(b) { (a, b) } else { (b, a) };
        self.components.0[low as usize] = high;
        let tip = self.tip_of(low, level, distance);
        if tip.height >= self.tip_height * tip.radius {
            self.tips.push(tip);
        } else {
            self.area[high as usize] += self.area[low as usize];
        }
    }

    fn tip_of(&self, component: u32, level: f64, distance: &[f64]) -> Tip {
        let vertex = self.highest[component as usize];
        let height = distance[vertex as usize] - level;
        let links = self.graph.neighbours(vertex);
        let edge =
            links.iter().map(|&(_, length)| f64::from(length)).sum::<f64>() / links.len().max(1) as f64;
        // Nothing thinner than an edge is a vessel: it is the one vertex that sticks out.
        let radius =
            if height > 0.0 { self.area[component as usize] / (TAU * height) } else { f64::INFINITY };
        Tip { vertex, height, radius: radius.max(edge) }
    }
}

/// Disjoint sets with path halving.
struct Components(Vec<u32>);

impl Components {
    fn find(&mut self, mut v: u32) -> u32 {
        while self.0[v as usize] != v {
            let above = self.0[self.0[v as usize] as usize];
            self.0[v as usize] = above;
            v = above;
        }
        v
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::centerline::shapes::torus;
    use crate::centerline::test_surfaces::{capsule, closed_surface, voxels};

    fn tips_of(mesh: crate::mesh::TriangleMesh) -> (Vec<Tip>, Vec<Point3<f64>>) {
        let surface = closed_surface(&mesh);
        let graph = EdgeGraph::new(&surface.mesh.vertices, &surface.corners);
        let (_, distances) = root(&graph, &CancelToken::new()).unwrap();
        let areas = vertex_areas(&surface.mesh.vertices, &surface.mesh.triangles);
        (tips(&graph, &distances, &areas, 1.0), surface.mesh.vertices)
    }

    #[test]
    fn a_tube_has_its_two_ends() {
        let (tips, positions) = tips_of(capsule(1.0, 10.0, 24));
        assert_eq!(tips.len(), 2);
        let mut heights: Vec<f64> = tips.iter().map(|tip| positions[tip.vertex as usize].z).collect();
        heights.sort_by(f64::total_cmp);
        assert!(heights[0] < -0.9 && heights[1] > 10.9, "{heights:?}");
        assert!((tips[0].radius - 0.9).abs() < 0.15, "radius {}", tips[0].radius);
    }

    #[test]
    fn stairs_of_a_voxel_tree_are_no_tips_but_its_branches_are() {
        // A trunk along z with one branch along x and a shorter one along -y.
        let near = |p: Vector3<f64>, a: Vector3<f64>, b: Vector3<f64>| {
            let along = ((p - a).dot(&(b - a)) / (b - a).norm_squared()).clamp(0.0, 1.0);
            (p - a - (b - a) * along).norm() < 3.2
        };
        let tree = voxels([-5, -20, -5], [30, 5, 60], |p| {
            near(p, Vector3::zeros(), Vector3::new(0.0, 0.0, 55.0))
                || near(p, Vector3::new(0.0, 0.0, 20.0), Vector3::new(25.0, 0.0, 24.0))
                || near(p, Vector3::new(0.0, 0.0, 40.0), Vector3::new(0.0, -15.0, 44.0))
        });
        let (tips, positions) = tips_of(tree);
        assert_eq!(tips.len(), 4, "{tips:?}");
        let reached = |goal: Vector3<f64>| {
            tips.iter().any(|tip| (positions[tip.vertex as usize].coords - goal).norm() < 5.0)
        };
        assert!(reached(Vector3::new(25.0, 0.0, 24.0)) && reached(Vector3::new(0.0, -15.0, 44.0)));
        assert!(tips.windows(2).all(|pair| pair[0].height >= pair[1].height));
    }

    #[test]
    fn a_ring_gives_two_opposite_points_to_cluster_from() {
        let (tips, positions) = tips_of(torus(5.0, 1.0, 60, 16));
        assert_eq!(tips.len(), 2);
        let [a, b] = [0, 1].map(|k| positions[tips[k].vertex as usize].coords);
        assert!(a.dot(&b) < -20.0);
    }
}
