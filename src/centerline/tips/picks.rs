//! Ends that the user asks for, and ends that the user does not want (the paper's interactive refinement, ref. 32).

use std::f64::consts::TAU;

use nalgebra::Point3;
use rayon::prelude::*;

use crate::mesh::TriangleMesh;
use crate::mesh::measures::bounds;
use crate::mesh::preparation::Surface;

use super::root::{Root, ends_of};
use super::{Branching, Pruning};
use crate::centerline::tips::reeb::ReebGraph;
use crate::centerline::{CancelToken, ExtractError, Parameters};

/// Farthest that a point may lie from its nearest vertex, in diagonals of the input's bounding box.
const OFF: f64 = 0.05;
/// How far from an included point an end may lie that is its own, in the end's radii.
const OWN: f64 = 1.5;
/// How far from an excluded point its end may lie, in the end's radii.
const REACH: f64 = 3.0;

/// A named point, as the vertex nearest to it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Pick {
    /// Its number among the points of its parameter, from 1.
    pub number: usize,
    pub vertex: u32,
}

/// The named points that are nearest to one component.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Picks {
    pub include: Vec<Pick>,
    pub exclude: Vec<Pick>,
    pub root: Option<Pick>,
}

impl Picks {
    /// The same points on a surface whose vertices were numbered anew; most are where they were.
    pub fn renumbered(&self, before: &Surface, after: &Surface) -> Self {
        let moved = |pick: &Pick| {
            let nearest = nearest_vertex(&[Some(after)], &before.mesh.vertices[pick.vertex as usize]);
            Pick { vertex: nearest.map_or(0, |(_, vertex, _)| vertex), ..*pick }
        };
        let all = |picks: &[Pick]| picks.iter().map(moved).collect();
        Self { include: all(&self.include), exclude: all(&self.exclude), root: self.root.as_ref().map(moved) }
    }
}

/// Gives each named point to the component that has the vertex nearest to it; `None` for components that are left
/// out. O(points x vertices).
///
/// # Errors
/// [`ExtractError::OffSurface`] for a point that is far from all, [`ExtractError::Cancelled`].
pub fn place(
    components: &[Option<&Surface>],
    diagonal: f64,
    parameters: &Parameters,
    cancel: &CancelToken,
) -> Result<Vec<Picks>, ExtractError> {
    let mut picks = vec![Picks::default(); components.len()];
    for (spec, points) in parameters.points() {
        for (index, point) in points.iter().enumerate() {
            cancel.check()?;
            let (name, number, most) = (spec.name, index + 1, OFF * diagonal);
            let nearest = nearest_vertex(components, point).filter(|&(_, _, distance)| distance <= most);
            let Some((component, vertex, _)) = nearest else {
                let distance =
                    nearest_vertex(components, point).map_or(f64::INFINITY, |(.., distance)| distance);
                return Err(ExtractError::OffSurface { name, number, distance, most });
            };
            let pick = Pick { number, vertex };
            match name {
                "include" => picks[component].include.push(pick),
                "exclude" => picks[component].exclude.push(pick),
                _ => picks[component].root = Some(pick),
            }
        }
    }
    Ok(picks)
}

/// Whether every named point is within reach of the mesh's box, so far as that is seen without preparing the mesh: what
/// lies off it is [`OFF`] from every vertex as well.
///
/// # Errors
/// [`ExtractError::OffSurface`] for the first one that is not.
pub fn check_reach(mesh: &TriangleMesh, parameters: &Parameters) -> Result<(), ExtractError> {
    let mut points = parameters.points().peekable();
    if mesh.triangles.is_empty() || points.peek().is_none() {
        return Ok(());
    }
    let [low, high] = bounds(mesh);
    let most = OFF * (high - low).norm();
    for (spec, points) in points {
        let is_off = |point: &Point3<f64>| (point.coords - point.coords.sup(&low).inf(&high)).norm() > most;
        if let Some((index, point)) = points.iter().enumerate().find(|(_, point)| is_off(point)) {
            let distances = mesh.vertices.iter().map(|vertex| (vertex - point).norm());
            let distance = distances.fold(f64::INFINITY, f64::min);
            return Err(ExtractError::OffSurface { name: spec.name, number: index + 1, distance, most });
        }
    }
    Ok(())
}

/// Component, vertex and distance.
fn nearest_vertex(components: &[Option<&Surface>], point: &Point3<f64>) -> Option<(usize, u32, f64)> {
    let of_component = |(component, surface): (usize, &Option<&Surface>)| {
        let vertices = surface.map_or(&[][..], |surface| &surface.mesh.vertices);
        let distances = vertices.par_iter().enumerate().map(|(v, p)| ((p - point).norm(), v as u32));
        let (distance, vertex) = distances.min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)))?;
        Some((component, vertex, distance))
    };
    components.iter().enumerate().filter_map(of_component).min_by(|a, b| a.2.total_cmp(&b.2))
}

/// What makes every included point an end.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Kept {
    /// Vertices of leaves that are never pruned.
    pub leaves: Vec<u32>,
    /// Those among them that are no leaf yet: a peak is to be raised there.
    pub raised: Vec<u32>,
}

/// For each included point: nothing where an end is near already, else the leaf at the top of the slope on which it
/// lies, else, where that is far as on the side of a tube, its own vertex.
pub fn keep(surface: &Surface, graph: &ReebGraph, branching: &Branching, include: &[Pick]) -> Kept {
    let mut kept = Kept::default();
    if include.is_empty() {
        return kept;
    }
    let vertices = &surface.mesh.vertices;
    let ends = ends_of(surface, graph, &branching.chains);
    for &Pick { vertex, .. } in include {
        let near = |other: u32, radius: f64| {
            (vertices[other as usize] - vertices[vertex as usize]).norm() < OWN * radius
        };
        // Two peaks beside each other would be one.
        let beside = |&other: &u32| other == vertex || surface.corners.neighbours(vertex).any(|u| u == other);
        if ends.iter().any(|&(end, radius)| near(end, radius)) || kept.raised.iter().any(beside) {
            continue;
        }
        let top = summit(surface, graph, vertex);
        let leaf = graph.arcs.iter().find(|arc| graph.nodes[arc.upper as usize].vertex == top);
        let own = leaf.is_some_and(|arc| near(top, arc.base_length / TAU));
        kept.leaves.push(if own { top } else { vertex });
        if !own {
            kept.raised.push(vertex);
        }
    }
    kept
}

/// The local maximum of the distance that the steepest way up from a vertex leads to.
fn summit(surface: &Surface, graph: &ReebGraph, mut vertex: u32) -> u32 {
    let rank = |v: u32| graph.rank[v as usize];
    loop {
        let highest = surface.corners.neighbours(vertex).max_by_key(|&v| rank(v));
        match highest.filter(|&v| rank(v) > rank(vertex)) {
            Some(next) => vertex = next,
            None => return vertex,
        }
    }
}

/// The end nearest to a vertex as the root; where there is no end at all, the vertex itself.
pub fn root_near(surface: &Surface, graph: &ReebGraph, branching: &Branching, vertex: u32) -> Root {
    Root::nearest(surface, graph, branching, vertex)
        .unwrap_or_else(|| Root::of(surface, vertex, &[vertex].into_iter().collect()))
}

impl Pruning<'_> {
    /// Removes the end nearest to each point; returns the removed arcs, and the numbers of the points that no
    /// removable end is near to.
    pub fn exclude(&mut self, points: &[Pick]) -> (Vec<u32>, Vec<usize>) {
        let (mut excluded, mut idle) = (Vec::new(), Vec::new());
        for pick in points {
            match self.end_near(pick.vertex) {
                Some(arcs) => {
                    arcs.iter().for_each(|&arc| self.alive[arc as usize] = false);
                    excluded.extend(arcs);
                }
                None => idle.push(pick.number),
            }
        }
        (excluded, idle)
    }

    /// The arcs from the nearest end to its junction. A line without a junction keeps both its ends.
    fn end_near(&self, vertex: u32) -> Option<Vec<u32>> {
        let place = self.surface.mesh.vertices[vertex as usize];
        let of = |node: u32| (self.position(node) - place).norm();
        let mut ends: Vec<u32> =
            (0..self.graph.nodes.len() as u32).filter(|&node| self.degree(node) == 1).collect();
        ends.sort_by(|&a, &b| of(a).total_cmp(&of(b)));
        ends.into_iter().find_map(|end| {
            let (arcs, base) = self.leaf_chain(end).filter(|&(_, base)| self.degree(base) > 2)?;
            let radii = arcs.iter().flat_map(|&arc| self.rings(arc)).map(|ring| ring.radius());
            (of(end) < REACH * radii.fold(0.0, f64::max)).then_some(arcs).filter(|_| base != end)
        })
    }
}
