//! Marching cubes without a table (after Lorensen and Cline, SIGGRAPH 1987).
//!
//! The wall crosses the faces of a cell in segments; they close into loops, and each loop is
//! filled. On a face with four crossings the asymptotic decider (Nielson and Hamann,
//! Visualization 1991) pairs them, from the face's own four values, so that the two cells of a
//! face agree. No triangle has a side across a face, so that two cells never share such a side.
//! The surface is therefore closed and manifold for any field.

use std::collections::HashMap;

use nalgebra::Point3;

use crate::mesh::TriangleMesh;

use super::lumen::{Grid, SIDE};

/// A crossing keeps this share of its edge from the nodes, so that no two crossings coincide.
const APART: f64 = 0.02;

/// The corners of each face of a cell, counter-clockwise from outside. Bit 0 of a corner is x,
/// bit 1 y, bit 2 z.
const FACES: [[usize; 4]; 6] =
    [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];

/// The surface where the field is zero, its normals out of the lumen.
pub(super) fn surface(grid: &Grid) -> TriangleMesh {
    let mut builder = Builder { grid, mesh: TriangleMesh::default(), crossings: HashMap::new() };
    for [i, j, k] in grid.filled() {
        for place in 0..SIDE * SIDE * SIDE {
            builder.cell([i + place % SIDE, j + place / SIDE % SIDE, k + place / SIDE / SIDE]);
        }
    }
    builder.mesh
}

struct Builder<'a> {
    grid: &'a Grid,
    mesh: TriangleMesh,
    /// Vertex on the edge from a node along an axis.
    crossings: HashMap<([usize; 3], usize), u32>,
}

impl Builder<'_> {
    fn cell(&mut self, node: [usize; 3]) {
        let corner = |corner: usize| std::array::from_fn(|axis| node[axis] + (corner >> axis & 1));
        let values: [f64; 8] = std::array::from_fn(|place| self.grid.value(corner(place)));
        let inside = values.iter().filter(|&&value| value < 0.0).count();
        if inside == 0 || inside == 8 {
            return;
        }
        for edges in loops(&values) {
            let ring: Vec<u32> = edges.iter().map(|&edge| self.crossing(node, edge, &values)).collect();
            self.fill(&edges, &ring);
        }
    }

    /// The vertex on an edge of the cell at `node`.
    fn crossing(&mut self, node: [usize; 3], edge: Edge, values: &[f64; 8]) -> u32 {
        let from: [usize; 3] = std::array::from_fn(|axis| node[axis] + (edge.low >> axis & 1));
        let vertices = &mut self.mesh.vertices;
        *self.crossings.entry((from, edge.axis)).or_insert_with(|| {
            let (low, high) = (values[edge.low], values[edge.high()]);
            let share = (low / (low - high)).clamp(APART, 1.0 - APART);
            let mut point = self.grid.point(from);
            point[edge.axis] += share * self.grid.voxel;
            vertices.push(point);
            // The grid has fewer nodes than a u32 counts.
            vertices.len() as u32 - 1
        })
    }

    /// Fills a loop: with its best triangulation, or around its middle if each has a side on a face.
    fn fill(&mut self, edges: &[Edge], ring: &[u32]) {
        let points: Vec<_> = ring.iter().map(|&vertex| self.mesh.vertices[vertex as usize]).collect();
        if let Some(triangles) = triangulate(edges, &points) {
            self.mesh.triangles.extend(triangles.iter().map(|corners| corners.map(|corner| ring[corner])));
            return;
        }
        let sum: nalgebra::Vector3<f64> = points.iter().map(|point| point.coords).sum();
        let middle = self.mesh.vertices.len() as u32;
        self.mesh.vertices.push(Point3::from(sum / points.len() as f64));
        let next = ring.iter().cycle().skip(1);
        self.mesh.triangles.extend(ring.iter().zip(next).map(|(&from, &to)| [from, to, middle]));
    }
}

/// An edge of a cell: from its lower corner along an axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Edge {
    low: usize,
    axis: usize,
}

impl Edge {
    fn between(a: usize, b: usize) -> Self {
        Self { low: a & b, axis: (a ^ b).trailing_zeros() as usize }
    }

    fn high(self) -> usize {
        self.low | 1 << self.axis
    }

    /// Place among the 24 combinations of lower corner and axis.
    fn index(self) -> usize {
        3 * self.low + self.axis
    }

    /// Whether a face of the cell holds both edges.
    fn shares_face(self, other: Self) -> bool {
        let on = |edge: Self, face: &[usize; 4]| face.contains(&edge.low) && face.contains(&edge.high());
        FACES.iter().any(|face| on(self, face) && on(other, face))
    }
}

/// The loops in which the wall crosses a cell's faces, counter-clockwise from outside the lumen.
fn loops(values: &[f64; 8]) -> Vec<Vec<Edge>> {
    let mut next: [Option<Edge>; 24] = [None; 24];
    for face in &FACES {
        for (from, to) in segments(face, values) {
            next[from.index()] = Some(to);
        }
    }
    let mut loops = Vec::new();
    for start in 0..next.len() {
        let mut edges = Vec::new();
        let mut at = start;
        while let Some(edge) = next[at].take() {
            edges.push(edge);
            at = edge.index();
        }
        if !edges.is_empty() {
            loops.push(edges);
        }
    }
    loops
}

/// The wall's segments on a face, from where the way around it enters the lumen to where it leaves.
fn segments(face: &[usize; 4], values: &[f64; 8]) -> Vec<(Edge, Edge)> {
    let inside = |place: usize| values[face[place % 4]] < 0.0;
    let edge = |place: usize| Edge::between(face[place % 4], face[(place + 1) % 4]);
    let exits = (0..4).filter(|&place| inside(place) && !inside(place + 1));
    let entry_before =
        |exit: usize| (1..4).map(|back| exit + 4 - back).find(|&at| !inside(at) && inside(at + 1));
    let entry_after = |exit: usize| (1..4).map(|on| exit + on).find(|&at| !inside(at) && inside(at + 1));
    let crossings = (0..4).filter(|&place| inside(place) != inside(place + 1)).count();
    let joined = crossings == 4 && joins(face, values);
    exits
        .filter_map(|exit| {
            let entry = if joined { entry_after(exit) } else { entry_before(exit) };
            entry.map(|entry| (edge(entry), edge(exit)))
        })
        .collect()
}

/// Whether the two inside corners of a face with four crossings are joined through its middle.
fn joins(face: &[usize; 4], values: &[f64; 8]) -> bool {
    let [a, b, c, d] = face.map(|corner| values[corner]);
    let (inner, outer) = if a < 0.0 { (a * c, b * d) } else { (b * d, a * c) };
    inner > outer
}

/// The triangulation of a loop with the shortest sides, as places in the loop; `None` when each
/// has a side on a face.
fn triangulate(edges: &[Edge], points: &[Point3<f64>]) -> Option<Vec<[usize; 3]>> {
    let count = edges.len();
    let side = |from: usize, to: usize| {
        if to == from + 1 || (from == 0 && to == count - 1) {
            0.0
        } else if edges[from].shares_face(edges[to]) {
            f64::INFINITY
        } else {
            (points[to] - points[from]).norm_squared()
        }
    };
    // cost[from][to] of the polygon from..=to, and the corner that its side from-to goes to.
    let mut cost = vec![vec![0.0_f64; count]; count];
    let mut apex = vec![vec![0; count]; count];
    for span in 2..count {
        for from in 0..count - span {
            let to = from + span;
            let split = |middle: usize| cost[from][middle] + cost[middle][to];
            let best = (from + 1..to).min_by(|&a, &b| split(a).total_cmp(&split(b)))?;
            apex[from][to] = best;
            cost[from][to] = split(best) + side(from, to);
        }
    }
    if !cost[0][count - 1].is_finite() {
        return None;
    }
    let mut triangles = Vec::new();
    let mut open = vec![(0, count - 1)];
    while let Some((from, to)) = open.pop() {
        if to - from >= 2 {
            let middle = apex[from][to];
            triangles.push([from, middle, to]);
            open.extend([(from, middle), (middle, to)]);
        }
    }
    Some(triangles)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every way the corners of a cell can lie, with small and large values.
    #[test]
    fn the_loops_of_any_cell_use_each_crossing_once() {
        for case in 0..256_usize {
            for weight in [1.0, 0.1, 10.0] {
                let value = |corner: usize| {
                    let size = if corner.is_multiple_of(3) { weight } else { 1.0 };
                    if case >> corner & 1 == 1 { -size } else { size }
                };
                let values: [f64; 8] = std::array::from_fn(value);
                let cut = (0..8)
                    .flat_map(|low| (0..3).map(move |axis| Edge { low, axis }))
                    .filter(|edge| edge.low >> edge.axis & 1 == 0)
                    .filter(|edge| (values[edge.low] < 0.0) != (values[edge.high()] < 0.0))
                    .count();
                let loops = loops(&values);
                assert!(loops.iter().all(|edges| edges.len() >= 3), "case {case}");
                assert_eq!(loops.iter().map(Vec::len).sum::<usize>(), cut, "case {case}");
            }
        }
    }

    #[test]
    fn a_corner_is_cut_off_by_one_triangle_that_faces_out() {
        let mut values = [1.0; 8];
        values[0] = -1.0;
        let loops = loops(&values);
        assert_eq!(loops.len(), 1);
        let axes: Vec<_> = loops[0].iter().map(|edge| edge.axis).collect();
        // Seen from outside the corner at the origin, x, y and z go around counter-clockwise.
        assert!([[0, 1, 2], [1, 2, 0], [2, 0, 1]].contains(&[axes[0], axes[1], axes[2]]), "{axes:?}");
    }

    #[test]
    fn two_corners_across_a_face_join_when_their_product_is_larger() {
        let face = [0, 1, 3, 2];
        let values = |inner: f64| [-inner, 1.0, 1.0, -inner, 1.0, 1.0, 1.0, 1.0];
        assert!(joins(&face, &values(2.0)));
        assert!(!joins(&face, &values(0.5)));
        assert!(!joins(&face, &values(1.0)), "voxels that touch along an edge stay apart");
    }
}
