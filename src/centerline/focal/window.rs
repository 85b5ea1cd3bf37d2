//! Stretches of a line that get points of their own, close together.

use std::ops::Range;

use nalgebra::{Point3, Unit, Vector3};

use crate::centerline::component::ComponentGraph;
use crate::centerline::graph::Branch;
use crate::centerline::own_sections::{OwnSection, Plane, tangent};

/// The most points in a stretch, where the line does not come with half as many.
const MOST: usize = 256;
/// On how much of a stretch's ends what is told anew fades into what was told before, in told radii.
const FADE: f64 = 0.75;

/// A stretch of a branch, by the way along it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stretch {
    pub branch: usize,
    pub from: f64,
    pub to: f64,
    /// Distance of its points.
    pub step: f64,
}

impl Stretch {
    /// Whether `next`, which begins later, is not apart from it.
    pub fn overlaps(&self, next: &Self) -> bool {
        self.branch == next.branch && self.to >= next.from
    }

    /// Those of a line's own sections that lie in it.
    pub fn of<'a>(
        &'a self,
        sections: &'a [OwnSection],
        graph: &ComponentGraph,
    ) -> impl Iterator<Item = &'a OwnSection> {
        let ways = graph.branches[self.branch].ways();
        let of_branch = sections.iter().filter(|section| section.branch == self.branch);
        of_branch.filter(move |section| (self.from..=self.to).contains(&ways[section.place]))
    }

    pub fn add(&mut self, other: &Self) {
        self.from = self.from.min(other.from);
        self.to = self.to.max(other.to);
        self.step = self.step.min(other.step);
    }
}

/// The points of a stretch in its branch.
pub struct Window {
    pub branch: usize,
    pub places: Range<usize>,
    /// Directions of the line as it was told: those of one that is led through a throat would turn with it.
    tangents: Vec<Unit<Vector3<f64>>>,
    /// How much of what is told anew is taken at each, 0 to 1.
    pub fade: Vec<f64>,
}

impl Window {
    /// Those of a line's own sections, in their order, that lie in it.
    pub fn of<'a>(&self, sections: &'a [OwnSection]) -> &'a [OwnSection] {
        let before = |place: usize| sections.partition_point(|s| (s.branch, s.place) < (self.branch, place));
        &sections[before(self.places.start)..before(self.places.end)]
    }

    pub fn planes(&self) -> impl Iterator<Item = Plane> + '_ {
        let all = self.places.clone().zip(&self.tangents);
        all.map(|(place, &tangent)| Plane { branch: self.branch, place, tangent })
    }
}

/// The graph with points close together on the stretches, in the place of those there, and where they are.
pub fn with_points(graph: &ComponentGraph, stretches: &[Stretch]) -> (ComponentGraph, Vec<Window>) {
    let mut finer = graph.clone();
    let mut windows = Vec::new();
    for of_branch in stretches.chunk_by(|a, b| a.branch == b.branch) {
        let branch = &graph.branches[of_branch[0].branch];
        let (ways, tangents) = (branch.ways(), tangents(branch));
        let mut told = Branch::new(branch.from, branch.to, Vec::new(), Vec::new());
        let keep = |told: &mut Branch, places: Range<usize>| {
            told.points.extend_from_slice(&branch.points[places.clone()]);
            told.radii.extend_from_slice(&branch.radii[places]);
        };
        let mut next = 0;
        for stretch in of_branch {
            let first = ways.partition_point(|&way| way <= stretch.from).max(1);
            keep(&mut told, next..first.max(next));
            next = ways.partition_point(|&way| way < stretch.to).min(ways.len() - 1).max(first);
            windows.push(fill(stretch, branch, (&ways, &tangents), next - first, &mut told));
        }
        keep(&mut told, next..ways.len());
        told.equivalent_radii.clone_from(&told.radii);
        finer.branches[of_branch[0].branch] = told;
    }
    (finer, windows)
}

/// Adds the points of a stretch of `branch` to what was `told` of it so far; no fewer than the `dropped` ones were.
fn fill(
    stretch: &Stretch,
    branch: &Branch,
    (ways, tangents): (&[f64], &[Vector3<f64>]),
    dropped: usize,
    told: &mut Branch,
) -> Window {
    let start = told.points.len();
    let mut window =
        Window { branch: stretch.branch, places: start..start, tangents: Vec::new(), fade: Vec::new() };
    let length = stretch.to - stretch.from;
    // Of a step that is no number, two.
    let count = ((length / stretch.step).ceil() as usize).clamp(2, MOST.max(2 * dropped));
    for i in 1..count {
        let way = stretch.from + length * i as f64 / count as f64;
        let after = ways.partition_point(|&other| other < way).clamp(1, ways.len() - 1);
        let step = ways[after] - ways[after - 1];
        let share = if step > 0.0 { ((way - ways[after - 1]) / step).clamp(0.0, 1.0) } else { 0.0 };
        let Some(tangent) = Unit::try_new(tangents[after - 1].lerp(&tangents[after], share), 1e-6) else {
            continue;
        };
        let radius = branch.radii[after - 1] * (1.0 - share) + branch.radii[after] * share;
        let rise = ((way - stretch.from).min(stretch.to - way) / (FADE * radius)).min(1.0);
        window.fade.push(rise * rise * (3.0 - 2.0 * rise));
        window.tangents.push(tangent);
        told.points
            .push(Point3::from(branch.points[after - 1].coords.lerp(&branch.points[after].coords, share)));
        told.radii.push(radius);
    }
    window.places.end = told.points.len();
    window
}

/// Unit direction of a branch at each of its points; nothing where it has none.
fn tangents(branch: &Branch) -> Vec<Vector3<f64>> {
    let last = branch.points.len() - 1;
    let chord = |k: usize| (branch.points[k + 1] - branch.points[k]).try_normalize(0.0).unwrap_or_default();
    let one = |place: usize| match place {
        0 => chord(0),
        place if place == last => chord(last - 1),
        place => tangent(branch, place).map_or(Vector3::zeros(), Unit::into_inner),
    };
    (0..=last).map(one).collect()
}
