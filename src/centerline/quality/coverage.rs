//! Whether the line reaches every part of its surface: what it misses shows as wall without a line.

use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

use crate::mesh::preparation::{Opening, Surface};

use crate::centerline::component::ComponentGraph;
use crate::centerline::graph::{Branch, NodeKind, Warning};
use crate::centerline::line_tree::{LineTree, Segment};
use crate::centerline::median::median;
use crate::centerline::quality::piece::{self, is_far, large_piece};

/// Farthest that covered wall lies, in radii of the line there.
const NEAR: f64 = 1.5;
/// What of the wall lies farther than so many radii of the line there (first) is told from so large a share of the
/// area on (second): little of it when it lies far.
const FAR: [(f64, Radii, f64); 3] =
    [(1.5, Radii::Wide, 0.005), (2.0, Radii::Wide, 5e-4), (3.0, Radii::Either, 0.005)];
/// The most triangles that are looked at, evenly by number.
const SAMPLES: usize = 20_000;
/// How many of them one task looks at.
const CHUNK: usize = 1000;

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

/// Areas of the surface, in squared units of the input.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Covered {
    area: f64,
    near: f64,
    /// As the entries of [`FAR`] say.
    far: [f64; FAR.len()],
    /// Middles of some triangles that are far.
    missed: Vec<Point3<f64>>,
    /// Where a [`large_piece`] is.
    piece: Option<Point3<f64>>,
}

/// The area near the line, and far from it: of each triangle that is looked at, by its middle.
/// O(those x log segments).
pub fn measure(surface: &Surface, line: &LineTree, graph: &ComponentGraph) -> Covered {
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
    let line = &Reach { line, flatness, widest, cuts: cuts(surface, graph) };
    let step = surface.mesh.triangles.len().div_ceil(SAMPLES).max(1);
    let chunks = surface.mesh.triangles.par_chunks(CHUNK * step);
    let first = |number: usize| (number * CHUNK * step) as u32;
    let of_chunk = |(number, chunk): (usize, &[[u32; 3]])| {
        let triangles = (first(number)..).step_by(step).take(chunk.len().div_ceil(step));
        of_triangles(surface, line, triangles)
    };
    let parts: Vec<(Covered, Vec<(f64, u32)>)> = chunks.enumerate().map(of_chunk).collect();
    let mut sum = Covered::default();
    parts.iter().for_each(|(part, _)| sum.add(part));
    let seeds = parts.into_iter().flat_map(|(_, seeds)| seeds).collect();
    Covered { piece: large_piece(surface, line, seeds), ..sum }
}

/// The middle of a triangle, and its area.
pub fn middle_and_area(surface: &Surface, triangle: u32) -> (Point3<f64>, f64) {
    let [a, b, c] = surface.mesh.triangles[triangle as usize].map(|v| surface.mesh.vertices[v as usize]);
    (Point3::from((a.coords + b.coords + c.coords) / 3.0), 0.5 * (b - a).cross(&(c - a)).norm())
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

impl Reach<'_> {
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

/// What is covered of some triangles, and those that may be of a [`large_piece`], with how far they lie.
fn of_triangles(
    surface: &Surface,
    line: &Reach<'_>,
    triangles: impl Iterator<Item = u32>,
) -> (Covered, Vec<(f64, u32)>) {
    /// As many missed places a task are enough to find the worst nearby.
    const NOTED: usize = 64;
    let (mut sum, mut seeds) = (Covered::default(), Vec::new());
    let mut last = None;
    for triangle in triangles {
        let (middle, area) = middle_and_area(surface, triangle);
        sum.area += area;
        if line.covers(&middle, NEAR, Radii::Inscribed, &mut last) {
            sum.near += area;
            continue;
        }
        if line.is_beyond_cut(&middle) {
            continue;
        }
        if is_far(line, &middle, &mut last) {
            seeds.push((line.line.least_share(&middle), triangle));
        }
        let far = FAR.map(|(radii, kind, _)| !line.covers(&middle, radii, kind, &mut last));
        far.into_iter().zip(&mut sum.far).filter(|(far, _)| *far).for_each(|(_, sum)| *sum += area);
        if far.contains(&true) && sum.missed.len() < NOTED {
            sum.missed.push(middle);
        }
    }
    (sum, seeds)
}

impl Covered {
    pub fn add(&mut self, other: &Self) {
        self.area += other.area;
        self.near += other.near;
        self.far.iter_mut().zip(other.far).for_each(|(sum, far)| *sum += far);
        self.missed.extend(&other.missed);
        self.piece = self.piece.or(other.piece);
    }

    /// Share of the area near the line; 1 of a surface without area.
    pub fn share(&self) -> f64 {
        if self.area > 0.0 { self.near / self.area } else { 1.0 }
    }

    /// That of component `index` where wall lies farther from its line than its radii allow.
    pub fn warning(&self, index: usize, line: &LineTree) -> Option<Warning> {
        let (what, place) = self.share_missed(index, line).or_else(|| self.piece_missed(index))?;
        Some(Warning {
            code: "wall-without-line",
            detail: format!(
                "{what} near [{:.4}, {:.4}, {:.4}]: a branch may be missing there",
                place.x, place.y, place.z
            ),
        })
    }

    /// Where more of the wall than [`FAR`] allows lies far, and what to say of it.
    fn share_missed(&self, index: usize, line: &LineTree) -> Option<(String, Point3<f64>)> {
        let told = |(far, (.., least)): (&f64, (f64, Radii, f64))| *far > least * self.area;
        let number = self.far.iter().zip(FAR).rposition(told)?;
        let away = |place: &&Point3<f64>| line.least_share(place);
        let place = self.missed.iter().max_by(|a, b| away(a).total_cmp(&away(b)))?;
        let (share, radii) = (100.0 * self.far[number] / self.area, FAR[number].0);
        let what = format!(
            "{share:.2} % of the wall of component {index} lies farther than {radii} radii from the line, most of all"
        );
        Some((what, *place))
    }

    /// The same where little of the wall does, but in one piece.
    fn piece_missed(&self, index: usize) -> Option<(String, Point3<f64>)> {
        let what = format!(
            "a piece of the wall of component {index}, as large as a quarter of the vessel's section and more, lies farther \
             than {} radii from the line",
            piece::FAR
        );
        Some((what, self.piece?))
    }
}
