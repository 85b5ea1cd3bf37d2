//! Geodesic distance over the mesh's edges (section IV.A: the shortest path on the weighted graph
//! of the mesh, edges weighted by their Euclidean length).

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use nalgebra::Point3;
use rayon::prelude::*;

use rustc_hash::{FxHashMap, FxHashSet};

use crate::mesh::corner_table::CornerTable;
use crate::mesh::preparation::Opening;

use crate::centerline::{CancelToken, ExtractError};

/// How far an opening's centre is raised over its rim, in radii of the opening.
pub const RISE: f64 = 4.0;

/// What an edge within a cap is shortened to.
const SHRUNK: f64 = 1e-3;

/// Distances from a source, and the order in which the vertices were reached.
#[derive(Debug, Clone, Default)]
pub struct Geodesic {
    /// Per vertex, in the input's unit; infinite where there is no path.
    pub distance: Vec<f64>,
    /// The vertices reached, by ascending distance; each after its predecessor on the path.
    pub order: Vec<u32>,
}

/// The mesh's edges as a graph: neighbours and edge lengths in compressed rows.
#[derive(Debug, Clone, Default)]
pub struct EdgeGraph {
    start: Vec<u32>,
    links: Vec<(u32, f32)>,
}

impl EdgeGraph {
    /// The edges of a closed surface. O(n).
    pub fn new(vertices: &[Point3<f64>], corners: &CornerTable) -> Self {
        /// Vertices that one thread takes at a time.
        const RUN: usize = 4096;
        let links_of = |v: u32| {
            let length = move |u: u32| (vertices[u as usize] - vertices[v as usize]).norm();
            corners.neighbours(v).map(move |u| (u, length(u) as f32))
        };
        let run = |first: usize| {
            let mut ends = Vec::with_capacity(RUN);
            let mut links = Vec::with_capacity(6 * RUN);
            for v in first..(first + RUN).min(vertices.len()) {
                links.extend(links_of(v as u32));
                ends.push(links.len() as u32);
            }
            (ends, links)
        };
        let runs: Vec<_> = (0..vertices.len()).into_par_iter().step_by(RUN).map(run).collect();
        let mut start = Vec::with_capacity(vertices.len() + 1);
        let mut links = Vec::with_capacity(corners.half_edges());
        start.push(0);
        for (ends, own) in runs {
            let before = links.len() as u32;
            start.extend(ends.into_iter().map(|end| before + end));
            links.extend(own);
        }
        Self { start, links }
    }

    /// Shortens the edges inside a marked region a thousandfold: a distance from any of its vertices
    /// becomes one from all of them, and still rises from a single lowest vertex.
    pub fn shrink(&mut self, region: &[bool]) {
        for v in 0..self.vertices() {
            if region[v] {
                for link in &mut self.links[self.start[v] as usize..self.start[v + 1] as usize] {
                    if region[link.0 as usize] {
                        link.1 *= SHRUNK as f32;
                    }
                }
            }
        }
    }

    /// Makes each opening's centre a far tip: no path crosses an opening, and a branch ends in it
    /// however shortly it was cut.
    pub fn raise(&mut self, openings: &[Opening]) {
        for opening in openings {
            self.raise_vertex(opening.centre, RISE * opening.radius);
        }
    }

    /// Makes each vertex a tip, four of its edges high.
    pub fn raise_vertices(&mut self, vertices: &[u32]) {
        for &v in vertices {
            self.raise_vertex(v, self.peak(v));
        }
    }

    /// How high a vertex is raised that is to be a tip, in the input's unit.
    pub fn peak(&self, vertex: u32) -> f64 {
        let links = self.neighbours(vertex);
        let sum: f64 = links.iter().map(|&(_, length)| f64::from(length)).sum();
        4.0 * sum / links.len().max(1) as f64
    }

    /// Lengthens the edges at a vertex by `rise`.
    fn raise_vertex(&mut self, vertex: u32, rise: f64) {
        let around: Vec<u32> = self.neighbours(vertex).iter().map(|&(u, _)| u).collect();
        for v in around.into_iter().chain([vertex]) {
            let row = self.start[v as usize] as usize..self.start[v as usize + 1] as usize;
            for link in &mut self.links[row] {
                if v == vertex || link.0 == vertex {
                    link.1 += rise as f32;
                }
            }
        }
    }

    /// Neighbours of `v` with the edges' lengths, in cyclic order.
    #[inline]
    pub fn neighbours(&self, v: u32) -> &[(u32, f32)] {
        &self.links[self.start[v as usize] as usize..self.start[v as usize + 1] as usize]
    }

    pub fn vertices(&self) -> usize {
        self.start.len().saturating_sub(1)
    }
}

/// Dijkstra's algorithm from `sources`. O(n log n).
///
/// # Errors
/// [`ExtractError::Cancelled`].
pub fn geodesic(graph: &EdgeGraph, sources: &[u32], cancel: &CancelToken) -> Result<Geodesic, ExtractError> {
    geodesic_told(graph, sources, cancel, |_| ())
}

/// The same; `told` hears of the vertices reached, some thousands at a time, as they are.
///
/// # Errors
/// [`ExtractError::Cancelled`].
pub fn geodesic_told(
    graph: &EdgeGraph,
    sources: &[u32],
    cancel: &CancelToken,
    mut told: impl FnMut(&[u32]),
) -> Result<Geodesic, ExtractError> {
    const RUN: usize = 8192;
    let mut distance = vec![f64::INFINITY; graph.vertices()];
    let mut order = Vec::with_capacity(graph.vertices());
    // Non-negative doubles sort like their bits; the vertex number breaks ties.
    let mut heap: BinaryHeap<Reverse<(u64, u32)>> = BinaryHeap::new();
    for &source in sources {
        if distance[source as usize] > 0.0 {
            distance[source as usize] = 0.0;
            heap.push(Reverse((0, source)));
        }
    }
    while let Some(Reverse((bits, v))) = heap.pop() {
        let reached = f64::from_bits(bits);
        if reached > distance[v as usize] {
            continue;
        }
        order.push(v);
        if order.len().is_multiple_of(RUN) {
            cancel.check()?;
            told(&order[order.len() - RUN..]);
        }
        for &(u, length) in graph.neighbours(v) {
            let through = reached + f64::from(length);
            if through < distance[u as usize] {
                distance[u as usize] = through;
                heap.push(Reverse((through.to_bits(), u)));
            }
        }
    }
    told(&order[order.len() / RUN * RUN..]);
    Ok(Geodesic { distance, order })
}

/// Distances from a cap, of the vertices near it.
#[derive(Debug, Clone, Default)]
pub struct Near {
    distance: FxHashMap<u32, f64>,
    order: Vec<u32>,
}

impl Near {
    /// `None` of a vertex that was not reached.
    pub fn distance(&self, v: u32) -> Option<f64> {
        self.distance.get(&v).copied()
    }

    /// The vertices reached with their distances, the nearest first.
    pub fn reached(&self) -> impl Iterator<Item = (u32, f64)> + '_ {
        self.order.iter().filter_map(|&v| Some((v, self.distance(v)?)))
    }
}

/// Dijkstra's algorithm from the tip of a cap whose own edges are short, as [`EdgeGraph::shrink`] makes them, as far as
/// `onward` says of a vertex and its distance; those where it says no are reached and not gone on from.
/// O(reached x log reached).
///
/// # Errors
/// [`ExtractError::Cancelled`].
pub fn geodesic_near(
    graph: &EdgeGraph,
    (tip, cap): (u32, &FxHashSet<u32>),
    onward: impl Fn(u32, f64) -> bool,
    cancel: &CancelToken,
) -> Result<Near, ExtractError> {
    const RUN: usize = 8192;
    let mut near = Near::default();
    let mut heap = BinaryHeap::from([Reverse((0_u64, tip))]);
    near.distance.insert(tip, 0.0);
    while let Some(Reverse((bits, v))) = heap.pop() {
        let reached = f64::from_bits(bits);
        if near.distance(v).is_some_and(|known| reached > known) {
            continue;
        }
        near.order.push(v);
        if near.order.len().is_multiple_of(RUN) {
            cancel.check()?;
        }
        if !onward(v, reached) {
            continue;
        }
        for &(u, length) in graph.neighbours(v) {
            let short = cap.contains(&v) && cap.contains(&u);
            let through = reached + f64::from(length) * if short { SHRUNK } else { 1.0 };
            let known = near.distance.entry(u).or_insert(f64::INFINITY);
            if through < *known {
                *known = through;
                heap.push(Reverse((through.to_bits(), u)));
            }
        }
    }
    Ok(near)
}
