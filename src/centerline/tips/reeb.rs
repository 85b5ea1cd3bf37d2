//! The Reeb graph of a function on a closed surface: each point is one component of a level set.
//!
//! The paper's ref. 25 uses Reeb graphs for skeletons; here it is what keeps the promise of
//! homotopy: the graph of a geodesic distance has one part a component and as many loops as
//! the surface has handles, by construction (Cole-McLaughlin et al., *Loops in Reeb graphs of
//! 2-manifolds*, 2004), and so has every centerline that is made by moving its points.

use std::sync::mpsc;

use nalgebra::Point3;
use rayon::prelude::*;

use crate::mesh::corner_table::{CornerTable, NONE, next};
use crate::mesh::preparation::Surface;

use crate::centerline::tips::geodesic::{EdgeGraph, Geodesic, geodesic_told};
use crate::centerline::{CancelToken, ExtractError};

/// A critical point of the function.
#[derive(Debug, Clone, PartialEq)]
pub struct ReebNode {
    /// The vertex that it lies at.
    pub vertex: u32,
    /// The function there.
    pub level: f64,
}

/// A family of level set components that do not split or merge between two nodes.
#[derive(Debug, Clone, PartialEq)]
pub struct ReebArc {
    /// Node at its lower end.
    pub lower: u32,
    /// Node at its upper end.
    pub upper: u32,
    /// Half-edge from the lower node's vertex upward, across this arc's first level sets.
    pub start: u32,
    /// Regular vertices on the arc, by ascending rank.
    pub vertices: Vec<u32>,
    /// Circumference of the level set component just above the lower node.
    pub base_length: f64,
    /// How many edges that component crosses.
    pub base_edges: u32,
}

/// Nodes and arcs, and the total order of the vertices that they were built with.
#[derive(Debug, Clone, Default)]
pub struct ReebGraph {
    pub nodes: Vec<ReebNode>,
    pub arcs: Vec<ReebArc>,
    /// Place of each vertex in the order of ascending function.
    pub rank: Vec<u32>,
    /// The function, by vertex.
    pub function: Vec<f64>,
    /// The vertices in order.
    pub order: Vec<u32>,
}

/// The Reeb graph of the geodesic distance from `sources`, whose distances are measured along `edges`.
///
/// The sweep follows the front that measures on a thread of its own. O(n log n).
///
/// # Errors
/// [`ExtractError::Cancelled`].
pub fn reeb_graph(
    surface: &Surface,
    edges: &EdgeGraph,
    sources: &[u32],
    cancel: &CancelToken,
) -> Result<ReebGraph, ExtractError> {
    let (tell, hear) = mpsc::channel();
    // That nobody hears any more means that the sweep panicked, which `join` tells.
    let measure = move || geodesic_told(edges, sources, cancel, |reached| drop(tell.send(reached.to_vec())));
    let follow = move || {
        let mut sweep = Sweep::new(&surface.corners);
        let heard = hear.into_iter().take_while(|_: &Vec<u32>| !cancel.is_cancelled());
        heard.flatten().for_each(|v| sweep.pass(v));
        sweep
    };
    let (geodesic, sweep) = rayon::join(measure, follow);
    let geodesic = geodesic?;
    cancel.check()?;
    Ok(measured(surface, geodesic, sweep))
}

/// The Reeb graph of any function that has its only minimum at the first vertex of its order. O(n).
///
/// # Errors
/// [`ExtractError::Cancelled`].
pub fn reeb_graph_of(
    surface: &Surface,
    function: Geodesic,
    cancel: &CancelToken,
) -> Result<ReebGraph, ExtractError> {
    /// Vertices between two looks for a cancellation.
    const RUN: usize = 8192;
    let mut sweep = Sweep::new(&surface.corners);
    for run in function.order.chunks(RUN) {
        cancel.check()?;
        run.iter().for_each(|&v| sweep.pass(v));
    }
    Ok(measured(surface, function, sweep))
}

/// What a sweep has found, with levels and lengths.
fn measured(surface: &Surface, function: Geodesic, sweep: Sweep<'_>) -> ReebGraph {
    let Geodesic { distance, order } = function;
    let Sweep { mut nodes, mut arcs, rank, .. } = sweep;
    for node in &mut nodes {
        node.level = distance[node.vertex as usize];
    }
    let measured = |arc: &mut ReebArc| {
        let (vertices, corners) = (&surface.mesh.vertices, &surface.corners);
        arc.base_length = cycle_length(vertices, corners, (&rank, &distance), arc.start);
    };
    arcs.par_iter_mut().for_each(measured);
    ReebGraph { nodes, arcs, rank, function: distance, order }
}

/// Length of the level set component just above the vertex that the upward half-edge `start` leaves.
fn cycle_length(
    vertices: &[Point3<f64>],
    corners: &CornerTable,
    (rank, function): (&[u32], &[f64]),
    start: u32,
) -> f64 {
    let v = corners.origin(start) as usize;
    let walk = LevelWalk::new(corners, rank, rank[v], start);
    let mut points = walk.map(|h| crossing(vertices, corners, function, h, function[v]));
    let Some(first) = points.next() else { return 0.0 };
    let (last, length) =
        points.fold((first, 0.0), |(last, length), point| (point, length + (point - last).norm()));
    length + (first - last).norm()
}

/// A level that sweeps upward through the surface, and the components of its level set.
///
/// On an oriented closed surface each component is one cycle of crossed edges; regular vertices
/// hand their component on, saddles are resolved by walking the cycles anew.
/// O(n + saddles x cycle length). Source: sweep of Morse functions on 2-manifolds.
struct Sweep<'a> {
    corners: &'a CornerTable,
    /// Per edge (see [`CornerTable::edge`]) that crosses the level: its arc.
    label: Vec<u32>,
    /// Place of each vertex passed; above the level the greatest number.
    rank: Vec<u32>,
    passed: u32,
    /// Their levels and lengths are not known yet.
    nodes: Vec<ReebNode>,
    arcs: Vec<ReebArc>,
    star: Vec<(u32, bool)>,
}

impl<'a> Sweep<'a> {
    fn new(corners: &'a CornerTable) -> Self {
        Self {
            corners,
            label: vec![NONE; corners.half_edges()],
            rank: vec![u32::MAX; corners.vertices()],
            passed: 0,
            nodes: Vec::new(),
            arcs: Vec::new(),
            star: Vec::new(),
        }
    }

    /// Moves the level from just below `v` to just above it.
    fn pass(&mut self, v: u32) {
        let own = self.passed;
        self.passed += 1;
        self.rank[v as usize] = own;
        let mut star = std::mem::take(&mut self.star);
        star.clear();
        star.extend(self.corners.star(v).map(|h| (h, self.rank[self.corners.target(h) as usize] > own)));
        let changes = (0..star.len()).filter(|&i| star[i].1 != star[(i + 1) % star.len()].1).count();
        let regular = changes == 2;
        if regular {
            let below = star.iter().find(|entry| !entry.1).map_or(NONE, |entry| self.label_of(entry.0));
            for &(h, above) in &star {
                if above {
                    self.label[self.corners.edge(h) as usize] = below;
                }
            }
            self.arcs[below as usize].vertices.push(v);
        } else {
            self.pass_critical(v, &star);
        }
        self.star = star;
    }

    fn label_of(&self, h: u32) -> u32 {
        self.label[self.corners.edge(h) as usize]
    }

    /// Ends the arcs below a critical vertex and starts those above it.
    fn pass_critical(&mut self, v: u32, star: &[(u32, bool)]) {
        let node = self.nodes.len() as u32;
        self.nodes.push(ReebNode { vertex: v, level: f64::NAN });
        for &(h, above) in star {
            if !above {
                let arc = self.label_of(h);
                self.arcs[arc as usize].upper = node;
            }
        }
        let first_new = self.arcs.len() as u32;
        for &(h, above) in star {
            let edge = self.corners.edge(h) as usize;
            let fresh = self.label[edge] != NONE && self.label[edge] >= first_new;
            if above && !fresh {
                let base_edges = self.relabel_cycle(h, self.arcs.len() as u32);
                self.arcs.push(ReebArc {
                    lower: node,
                    upper: NONE,
                    start: h,
                    vertices: Vec::new(),
                    base_length: f64::NAN,
                    base_edges,
                });
            }
        }
    }

    /// Gives the level set component just above the critical vertex, through its upward half-edge
    /// `start`, the name `arc`; returns how many edges it crosses.
    fn relabel_cycle(&mut self, start: u32, arc: u32) -> u32 {
        let own = self.rank[self.corners.origin(start) as usize];
        let mut edges = 0;
        for h in LevelWalk::new(self.corners, &self.rank, own, start) {
            self.label[self.corners.edge(h) as usize] = arc;
            edges += 1;
        }
        edges
    }
}

/// The half-edges that a level set component crosses, upward ones, in cyclic order.
///
/// The level lies just above the vertex of rank `level`.
pub struct LevelWalk<'a> {
    corners: &'a CornerTable,
    rank: &'a [u32],
    level: u32,
    start: u32,
    current: u32,
}

impl<'a> LevelWalk<'a> {
    /// `start` must run from a vertex of at most rank `level` to one above it.
    pub fn new(corners: &'a CornerTable, rank: &'a [u32], level: u32, start: u32) -> Self {
        Self { corners, rank, level, start, current: start }
    }
}

impl Iterator for LevelWalk<'_> {
    type Item = u32;

    fn next(&mut self) -> Option<u32> {
        if self.current == NONE {
            return None;
        }
        let h = self.current;
        // In the triangle left of `h`, the apex decides through which side the level leaves.
        let apex = self.corners.origin(next(next(h)));
        let above = self.rank[apex as usize] > self.level;
        // Sides: next(h) runs target -> apex, the other apex -> origin. The one whose ends differ is
        // crossed; its opposite runs upward in the triangle beyond.
        let leaving = if above { next(next(h)) } else { next(h) };
        let onward = self.corners.opposite(leaving);
        self.current = if onward == self.start { NONE } else { onward };
        Some(h)
    }
}

/// Where the function takes `level` on an edge; the nearer end where it is constant.
pub fn crossing(
    vertices: &[Point3<f64>],
    corners: &CornerTable,
    function: &[f64],
    h: u32,
    level: f64,
) -> Point3<f64> {
    let (a, b) = (corners.origin(h) as usize, corners.target(h) as usize);
    let rise = function[b] - function[a];
    let share = if rise > 0.0 { ((level - function[a]) / rise).clamp(0.0, 1.0) } else { 0.5 };
    vertices[a] + (vertices[b] - vertices[a]) * share
}
