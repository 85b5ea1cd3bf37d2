//! Whether the line is one-dimensional: a point of it is a place of one branch, and a node is where branches meet.
//!
//! A line is thin when all of this holds, `r` being the local radius:
//!
//! - every segment between two points is longer than 1e-6 `r`;
//! - no two segments that follow each other turn back by more than 170 degrees, so that none is passed again;
//! - no two stretches come nearer to each other than 0.05 `r`, except where they meet: within `r` along the same
//!   branch, or both within the radius of a node that they share.

use nalgebra::Point3;
use rayon::prelude::*;

use crate::centerline::component::ComponentGraph;
use crate::centerline::graph::Warning;
use crate::centerline::line_tree::{LineTree, Segment};

/// Least length of a segment, in local radii.
const LEAST: f64 = 1e-6;
/// Cosine of the sharpest turn.
const BACK: f64 = -0.985;
/// Nearest that two stretches may come, in local radii.
const APART: f64 = 0.05;

/// The first stretch of a component's line that is not thin; `None` for a thin line. O(segments log segments) for lines that
/// are.
pub fn first_thick(line: &LineTree, graph: &ComponentGraph) -> Option<Thick> {
    let segments = line.segments();
    let stands = |segment: &Segment| segment.length() <= LEAST * segment.radii[0].max(segment.radii[1]);
    let returns = |index: usize| {
        let next = segments.get(index + 1).filter(|next| next.branch == segments[index].branch);
        next.is_some_and(|next| turns_back(&segments[index], next))
    };
    let is_thick =
        |&index: &usize| stands(&segments[index]) || returns(index) || is_passed_again(line, graph, index);
    let first = (0..segments.len()).into_par_iter().find_first(is_thick)?;
    Some(Thick { branch: segments[first].branch, place: segments[first].ends[0] })
}

/// Where a line is not thin.
#[derive(Debug, Clone, Copy)]
pub struct Thick {
    branch: usize,
    place: Point3<f64>,
}

impl Thick {
    /// That of component `index`.
    pub fn warning(&self, index: usize) -> Warning {
        let Self { branch, place } = self;
        Warning {
            code: "not-thin",
            detail: format!(
                "branch {branch} of component {index} stands still, turns back, or runs where the line runs elsewhere, from \
                 [{:.4}, {:.4}, {:.4}] on: branches may be told twice",
                place.x, place.y, place.z
            ),
        }
    }
}

fn turns_back(first: &Segment, second: &Segment) -> bool {
    let [a, b] = [first, second].map(|segment| segment.ends[1] - segment.ends[0]);
    a.dot(&b) < BACK * a.norm() * b.norm()
}

/// Whether a later segment runs through the same place.
fn is_passed_again(line: &LineTree, graph: &ComponentGraph, index: usize) -> bool {
    let segment = &line.segments()[index];
    let middle = nalgebra::center(&segment.ends[0], &segment.ends[1]);
    line.any_near(&middle, 0.5 * segment.length(), APART, |other, second| {
        other > index
            && !follows(segment, second)
            && is_same_place(segment, second)
            && !meet(segment, second, graph)
    })
}

fn is_same_place(first: &Segment, second: &Segment) -> bool {
    let radius = first.radii.iter().chain(&second.radii).copied().fold(f64::INFINITY, f64::min);
    distance(first, second) < APART * radius
}

/// Whether the second stretch comes soon after the first on the same branch.
fn follows(first: &Segment, second: &Segment) -> bool {
    let radius = first.radii.iter().chain(&second.radii).copied().fold(0.0, f64::max);
    first.branch == second.branch && second.along - (first.along + first.length()) < radius
}

/// Whether two stretches lie together because they come from the same node.
fn meet(first: &Segment, second: &Segment, graph: &ComponentGraph) -> bool {
    let ends = |branch: usize| [graph.branches[branch].from, graph.branches[branch].to];
    let shared = ends(first.branch).into_iter().filter(|node| ends(second.branch).contains(node));
    shared.map(|node| &graph.nodes[node]).any(|node| {
        [first, second]
            .iter()
            .all(|segment| (segment.nearest(&node.position).0 - node.position).norm() < node.radius)
    })
}

/// Least distance between two segments (Ericson 2005, 5.1.9).
fn distance(first: &Segment, second: &Segment) -> f64 {
    let (d1, d2) = (first.ends[1] - first.ends[0], second.ends[1] - second.ends[0]);
    let gap = first.ends[0] - second.ends[0];
    let (a, b, e) = (d1.norm_squared(), d1.dot(&d2), d2.norm_squared());
    let (c, f) = (d1.dot(&gap), d2.dot(&gap));
    let parallel = a * e - b * b;
    let s = if parallel > 1e-12 * a * e { ((b * f - c * e) / parallel).clamp(0.0, 1.0) } else { 0.0 };
    let mut nearest = f64::INFINITY;
    // The nearest pair has one of these places in the first, or an end of the second.
    for s in [s, 0.0, 1.0] {
        let point = first.ends[0] + d1 * s;
        nearest = nearest.min((second.nearest(&point).0 - point).norm());
    }
    for end in &second.ends {
        nearest = nearest.min((first.nearest(end).0 - end).norm());
    }
    nearest
}
