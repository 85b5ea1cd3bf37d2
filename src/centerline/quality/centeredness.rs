//! How far the line's points lie from the middle of the vessel.
//!
//! At inner points of the branches, half a local radius apart or more, the surface is cut perpendicular to the
//! line. A point counts when the closed section around it is one vessel's own:
//!
//! - it is as convex as a vessel's: it fills 0.85 of what its own tangents enclose;
//! - no other branch's inscribed sphere reaches into it, and the same branch does not pass through it twice;
//! - no end lies within one radius of the point: caps are cut aslant.
//!
//! The offset is the distance to the section's centroid, over the radius of the circle of the section's area.

use nalgebra::{Point2, Point3, Rotation2, Unit, Vector2, Vector3};
use rayon::prelude::*;

use crate::mesh::preparation::Surface;

use super::Centeredness;
use super::line_tree::{LineTree, Segment};
use crate::centerline::component::ComponentGraph;
use crate::centerline::cut_plane::section::{Frame, Section, any_perpendicular, section};
use crate::centerline::graph::Branch;
use crate::centerline::triangle_grid::TriangleGrid;

/// Sums over the points that count.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Offsets {
    sum: f64,
    max: f64,
    sections: usize,
}

impl Offsets {
    pub fn add(&mut self, other: &Self) {
        self.sum += other.sum;
        self.max = self.max.max(other.max);
        self.sections += other.sections;
    }

    pub fn centeredness(&self) -> Centeredness {
        let any = self.sections > 0;
        Centeredness {
            mean: any.then(|| self.sum / self.sections as f64),
            max: any.then_some(self.max),
            sections: self.sections,
        }
    }
}

/// The offsets of a component's line.
pub fn measure(
    surface: &Surface,
    grid: &TriangleGrid<'_>,
    line: &LineTree,
    graph: &ComponentGraph,
) -> Offsets {
    let mut degree = vec![0; graph.nodes.len()];
    for branch in &graph.branches {
        degree[branch.from] += 1;
        degree[branch.to] += 1;
    }
    let ends: Vec<Point3<f64>> = graph
        .nodes
        .iter()
        .zip(&degree)
        .filter(|(_, degree)| **degree == 1)
        .map(|(node, _)| node.position)
        .collect();
    let number = |(number, branch)| places(branch).into_iter().map(move |place| (number, place));
    let places: Vec<(usize, usize)> = graph.branches.iter().enumerate().flat_map(number).collect();
    let one = |&(number, place): &(usize, usize)| {
        let branch = &graph.branches[number];
        let own = [branch.from, branch.to].map(|node| graph.nodes[node].position);
        let own_ends = own.into_iter().filter(|position| ends.contains(position));
        let point = branch.points[place];
        let (cut, centroid, radius) = section_around(surface, grid, branch, place)?;
        let clear = own_ends.into_iter().all(|end| (end - point).norm() > radius);
        let alone = clear && is_convex(&cut) && !is_shared(&cut, line, (number, place));
        alone.then(|| centroid.coords.norm() / radius)
    };
    let offsets: Vec<f64> = places.par_iter().filter_map(one).collect();
    let max = offsets.iter().copied().fold(0.0, f64::max);
    Offsets { sum: offsets.iter().sum(), max, sections: offsets.len() }
}

/// The inner points of a branch that are looked at.
fn places(branch: &Branch) -> Vec<usize> {
    /// Least way from one to the next, in local radii.
    const STEP: f64 = 0.5;
    let mut way = 0.0;
    let mut found = Vec::new();
    for place in 1..branch.points.len().saturating_sub(1) {
        way += (branch.points[place] - branch.points[place - 1]).norm();
        if found.is_empty() || way >= STEP * branch.radii[place] {
            way = 0.0;
            found.push(place);
        }
    }
    found
}

/// The closed section around a point of a branch, with its centroid and the radius of the circle of its area;
/// the point is the origin of its plane.
fn section_around(
    surface: &Surface,
    grid: &TriangleGrid<'_>,
    branch: &Branch,
    place: usize,
) -> Option<(Section, Point2<f64>, f64)> {
    let [before, point, after] = [place - 1, place, place + 1].map(|i| branch.points[i]);
    let directions = [point - before, after - point].map(|step| step.try_normalize(0.0));
    let tangent = Unit::try_new(directions[0]? + directions[1]?, 1e-6)?;
    let across = any_perpendicular(*tangent);
    let frame = Frame::new(point, tangent, across);
    // Another try where the first ray ends at a wall that does not go around.
    [frame.u, frame.v, -frame.u, -frame.v].iter().find_map(|direction: &Vector3<f64>| {
        let cut = section(surface, frame, grid.wall_ahead(&point, direction)?)?;
        let measure = cut.measure();
        let around = measure.area > 0.0 && cut.encloses(&Point2::origin());
        around.then(|| (cut, measure.centroid, measure.radius()))
    })
}

/// Whether a section fills most of what its tangents in a few directions enclose.
fn is_convex(cut: &Section) -> bool {
    const DIRECTIONS: usize = 16;
    const FILLED: f64 = 0.85;
    let turn = std::f64::consts::TAU / DIRECTIONS as f64;
    let step = Rotation2::new(turn);
    let mut direction = step.inverse() * Vector2::x();
    let support: [f64; DIRECTIONS] = std::array::from_fn(|_| {
        direction = step * direction;
        cut.points.iter().map(|point| point.coords.dot(&direction)).fold(f64::NEG_INFINITY, f64::max)
    });
    // Length of each tangent between its neighbours.
    let side = |k: usize| {
        let around = support[(k + 1) % DIRECTIONS] + support[(k + DIRECTIONS - 1) % DIRECTIONS];
        (around - 2.0 * support[k] * turn.cos()) / turn.sin()
    };
    let enclosed: f64 = (0..DIRECTIONS).map(|k| 0.5 * support[k] * side(k)).sum();
    cut.measure().area > FILLED * enclosed
}

/// Whether the section around a point is another stretch's as well.
fn is_shared(cut: &Section, line: &LineTree, (branch, place): (usize, usize)) -> bool {
    let frame = &cut.frame;
    let reach = cut.points.iter().map(|point| point.coords.norm()).fold(0.0, f64::max);
    line.any_near(&frame.origin, reach, 1.0, |_, segment| {
        if segment.branch == branch {
            let beside = segment.place + 1 == place || segment.place == place;
            return !beside && passes(segment, cut);
        }
        let (point, radius) = segment.nearest(&frame.origin);
        let depth = (point - frame.origin).dot(&frame.t).abs();
        (depth < radius && cut.encloses(&frame.flat(&point))) || passes(segment, cut)
    })
}

/// Whether a segment passes through the section.
fn passes(segment: &Segment, cut: &Section) -> bool {
    let [a, b] = segment.ends.map(|end| (end - cut.frame.origin).dot(&cut.frame.t));
    if (a < 0.0) == (b < 0.0) {
        return false;
    }
    let [p, q] = segment.ends;
    cut.encloses(&cut.frame.flat(&(p + (q - p) * (a / (a - b)))))
}
