//! How far the wall of a line's own vessel may lie.

use nalgebra::{Point3, Vector3};

use crate::mesh::preparation::{Opening, Surface};

use crate::centerline::component::ComponentGraph;
use crate::centerline::graph::{Branch, NodeKind};
use crate::centerline::line_tree::{LineTree, Segment};
use crate::centerline::median::median;

/// Farthest that covered wall lies, in radii of the line there.
pub const NEAR: f64 = 1.5;

/// The radii that far is counted in.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Radii {
    Inscribed,
    /// Long half axes of the ellipses that have the line's two radii: a flat vessel misses no branch.
    Wide,
    /// The same of the branch's usual one.
    Usual,
    /// So many inscribed radii, or a fifth more than the branch's usual long half axis, whichever is more: one place
    /// that is wide may have taken in a branch.
    Either,
}

impl Radii {
    /// How far wall may lie, in inscribed radii.
    fn limit(self, radii: f64, flatness: Flatness) -> f64 {
        const BESIDE: f64 = 1.2;
        match self {
            Self::Inscribed => radii,
            Self::Wide => radii * flatness.here,
            Self::Usual => radii * flatness.usual,
            Self::Either => radii.max(BESIDE * flatness.usual),
        }
    }
}

/// Long over short half axis of the ellipses that have the line's two radii.
#[derive(Debug, Clone, Copy)]
struct Flatness {
    here: f64,
    /// Median of the branch.
    usual: f64,
}

/// A cut that the line ends in: where it is aslant, the wall of the vessel goes on past that end.
struct Cut {
    end: Point3<f64>,
    /// The line's direction there, unit.
    outward: Vector3<f64>,
    /// How far aside of the line's continuation the vessel's own wall may lie.
    aside: f64,
    /// How far from the end its rim may lie.
    reach: f64,
}

impl Cut {
    /// Whether a place is wall of the vessel past the line's end.
    fn is_beyond(&self, place: &Point3<f64>) -> bool {
        let away = place - self.end;
        let along = away.dot(&self.outward);
        (0.0..self.reach).contains(&along) && (away - self.outward * along).norm() < self.aside
    }
}

/// The cuts that the line ends in. O(ends x openings).
fn cuts(surface: &Surface, graph: &ComponentGraph) -> Vec<Cut> {
    /// Triangles at the rim have their middles beside it.
    const BESIDE: f64 = 1.05;
    let at = |v: u32| surface.mesh.vertices[v as usize];
    let of_end = |(branch, at_start): (&Branch, bool)| {
        let last = branch.points.len() - 1;
        let (node, end, before) = if at_start { (branch.from, 0, 1) } else { (branch.to, last, last - 1) };
        if graph.nodes[node].kind != NodeKind::End {
            return None;
        }
        let (point, radius) = (branch.points[end], branch.radii[end]);
        let outward = (point - branch.points[before]).try_normalize(0.0)?;
        let is_here = |opening: &&Opening| (at(opening.centre) - point).norm() < radius;
        let rim = &surface.openings.iter().find(is_here)?.rim;
        let farthest = rim.iter().map(|&v| (at(v) - point).norm()).fold(0.0, f64::max);
        let aside = NEAR * radius * flatness(branch, end);
        Some(Cut { end: point, outward, aside, reach: BESIDE * farthest })
    };
    graph.branches.iter().flat_map(|branch| [(branch, true), (branch, false)]).filter_map(of_end).collect()
}

/// Of each branch the median over its segments.
fn usual(line: &LineTree, here: &[f64], branches: usize) -> Vec<f64> {
    let mut of_branch = vec![Vec::new(); branches];
    for (segment, flatness) in line.segments().iter().zip(here) {
        of_branch[segment.branch].push(*flatness);
    }
    // No ellipse is rounder than a circle.
    of_branch.into_iter().map(|values| median(values).max(1.0)).collect()
}

/// Long over short half axis of the ellipse that has a branch's two radii at a point.
fn flatness(branch: &Branch, at: usize) -> f64 {
    /// Beyond this a section has taken in more than its vessel.
    const FLATTEST: f64 = 4.0;
    let flatness = (branch.equivalent_radii[at] / branch.radii[at]).powi(2);
    // At the far wall of a sac the radius may be nothing.
    if flatness.is_finite() { flatness.clamp(1.0, FLATTEST) } else { 1.0 }
}

/// How far the wall of a line's own vessel may lie.
pub struct Reach<'a> {
    pub line: &'a LineTree,
    /// Of each segment.
    flatness: Vec<Flatness>,
    widest: Flatness,
    cuts: Vec<Cut>,
}

impl<'a> Reach<'a> {
    /// That of a component's line. O(points + ends x openings).
    pub fn new(surface: &Surface, line: &'a LineTree, graph: &ComponentGraph) -> Self {
        let of_segment = |segment: &Segment| {
            let branch = &graph.branches[segment.branch];
            flatness(branch, segment.place).max(flatness(branch, segment.place + 1))
        };
        let here: Vec<f64> = line.segments().iter().map(of_segment).collect();
        let usual = usual(line, &here, graph.branches.len());
        let all = line.segments().iter().zip(here);
        let flatness: Vec<Flatness> =
            all.map(|(segment, here)| Flatness { here, usual: usual[segment.branch] }).collect();
        let most = |of: fn(&Flatness) -> f64| flatness.iter().map(of).fold(1.0, f64::max);
        let widest = Flatness { here: most(|one| one.here), usual: most(|one| one.usual) };
        Self { line, flatness, widest, cuts: cuts(surface, graph) }
    }

    /// Whether a place is wall of a vessel past the cut that its line ends in.
    pub fn is_beyond_cut(&self, place: &Point3<f64>) -> bool {
        self.cuts.iter().any(|cut| cut.is_beyond(place))
    }

    /// Whether a place lies within so many radii of any segment; that of `last` is tried first.
    pub fn covers(&self, place: &Point3<f64>, radii: f64, kind: Radii, last: &mut Option<usize>) -> bool {
        let limit = |index: usize| kind.limit(radii, self.flatness[index]);
        let again = last.is_some_and(|index| self.line.segments()[index].share(place) <= limit(index));
        again
            || self.line.any_near(place, 0.0, kind.limit(radii, self.widest), |index, segment| {
                let found = segment.share(place) <= limit(index);
                if found {
                    *last = Some(index);
                }
                found
            })
    }
}

/// The middle of a triangle, and its area.
pub fn middle_and_area(surface: &Surface, corners: &[u32; 3]) -> (Point3<f64>, f64) {
    let [a, b, c] = corners.map(|v| surface.mesh.vertices[v as usize]);
    (Point3::from((a.coords + b.coords + c.coords) / 3.0), 0.5 * (b - a).cross(&(c - a)).norm())
}
