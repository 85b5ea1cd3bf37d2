//! Openings that the line does not reach.

use nalgebra::Point3;

use crate::mesh::preparation::{Opening, Surface};

use super::told;
use crate::centerline::component::ComponentGraph;
use crate::centerline::graph::{NodeKind, Warning};

/// Farthest that an end lies from the middle of its opening, in the opening's radii: a jagged rim moves that, and within a
/// quarter of a radius the line keeps its own course.
const OFF: f64 = 0.5;
/// Least radius of an opening against that of the line next to it: a smaller one in a wall is a hole.
const HOLE: f64 = 0.25;

/// That of component `index` where openings have no end in their middle. O(openings x points).
pub fn warning(index: usize, surface: &Surface, graph: &ComponentGraph) -> Option<Warning> {
    let openings = surface.openings.iter().filter(|opening| !opening.was_closed);
    let missed: Vec<(Point3<f64>, f64)> =
        openings.filter_map(|opening| missed(surface, graph, opening)).collect();
    let place = |(at, off): &(Point3<f64>, f64)| {
        format!("that at [{:.4}, {:.4}, {:.4}] by {off:.2} of its radii", at.x, at.y, at.z)
    };
    (!missed.is_empty()).then(|| Warning {
        code: "end-off-axis",
        detail: format!(
            "{} openings of component {index} are missed by the line's nearest end: {}",
            missed.len(),
            told(&missed, place)
        ),
    })
}

/// The middle of an opening, and how far the nearest end lies from it, in its radii; `None` where that is near.
fn missed(surface: &Surface, graph: &ComponentGraph, opening: &Opening) -> Option<(Point3<f64>, f64)> {
    let middle = surface.mesh.vertices[opening.centre as usize];
    let away = |point: &Point3<f64>| (point - middle).norm();
    let ends = graph.nodes.iter().filter(|node| node.kind == NodeKind::End);
    let off = ends.map(|node| away(&node.position)).fold(f64::INFINITY, f64::min) / opening.radius;
    let points = graph.branches.iter().flat_map(|branch| branch.points.iter().zip(&branch.radii));
    let (_, radius) = points.min_by(|a, b| away(a.0).total_cmp(&away(b.0)))?;
    (off > OFF && off.is_finite() && opening.radius > HOLE * radius).then_some((middle, off))
}
