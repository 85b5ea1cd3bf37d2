//! Whether the line reaches every part of its surface: what it misses shows as wall without a line.

use nalgebra::Point3;
use rayon::prelude::*;

use crate::mesh::preparation::Surface;

use crate::centerline::component::ComponentGraph;
use crate::centerline::graph::Warning;
use crate::centerline::line_tree::{LineTree, Segment};

/// Farthest that covered wall lies, in radii of the line there.
const NEAR: f64 = 1.5;
/// What of the wall lies farther than so many radii of the line there (first) is told from so large a share of the
/// area on (second): little of it when it lies far.
const FAR: [(f64, Radii, f64); 3] =
    [(1.5, Radii::Wide, 0.005), (2.0, Radii::Wide, 5e-4), (3.0, Radii::Inscribed, 0.005)];
/// The most triangles that are looked at, evenly by number.
const SAMPLES: usize = 20_000;
/// How many of them one task looks at.
const CHUNK: usize = 1000;

/// The radii that far is counted in.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Radii {
    Inscribed,
    /// Long half axes of the ellipses that have the line's two radii: a flat vessel misses no branch.
    Wide,
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
}

/// The area near the line, and far from it: of each triangle that is looked at, by its middle.
/// O(those x log segments).
pub fn measure(surface: &Surface, line: &LineTree, graph: &ComponentGraph) -> Covered {
    let flatness: Vec<f64> = line.segments().iter().map(|segment| flatness(graph, segment)).collect();
    let line = &Reach { line, widest: flatness.iter().copied().fold(1.0, f64::max), flatness };
    let step = surface.mesh.triangles.len().div_ceil(SAMPLES).max(1);
    let chunks = surface.mesh.triangles.par_chunks(CHUNK * step);
    let parts: Vec<Covered> =
        chunks.map(|chunk| of_triangles(surface, line, chunk.iter().step_by(step))).collect();
    let mut sum = Covered::default();
    parts.iter().for_each(|part| sum.add(part));
    sum
}

/// Long over short half axis of the ellipse that has the line's two radii at a segment.
fn flatness(graph: &ComponentGraph, segment: &Segment) -> f64 {
    /// Beyond this a section has taken in more than its vessel.
    const FLATTEST: f64 = 4.0;
    let branch = &graph.branches[segment.branch];
    let one = |at: usize| (branch.equivalent_radii[at] / branch.radii[at]).powi(2);
    let flatness = one(segment.place).max(one(segment.place + 1));
    // At the far wall of a sac the radius may be nothing.
    if flatness.is_finite() { flatness.clamp(1.0, FLATTEST) } else { 1.0 }
}

/// How far the wall of a line's own vessel may lie.
struct Reach<'a> {
    line: &'a LineTree,
    /// Of each segment.
    flatness: Vec<f64>,
    widest: f64,
}

impl Reach<'_> {
    /// Whether a place lies within so many radii of any segment; that of `last` is tried first.
    fn covers(&self, place: &Point3<f64>, radii: f64, kind: Radii, last: &mut Option<usize>) -> bool {
        let limit = |index: usize| if kind == Radii::Wide { radii * self.flatness[index] } else { radii };
        let again = last.is_some_and(|index| self.line.segments()[index].share(place) <= limit(index));
        let most = if kind == Radii::Wide { radii * self.widest } else { radii };
        again
            || self.line.any_near(place, 0.0, most, |index, segment| {
                let found = segment.share(place) <= limit(index);
                if found {
                    *last = Some(index);
                }
                found
            })
    }
}

fn of_triangles<'a>(
    surface: &Surface,
    line: &Reach<'_>,
    triangles: impl Iterator<Item = &'a [u32; 3]>,
) -> Covered {
    /// As many missed places a task are enough to find the worst nearby.
    const NOTED: usize = 64;
    let mut sum = Covered::default();
    let mut last = None;
    for corners in triangles {
        let [a, b, c] = corners.map(|v| surface.mesh.vertices[v as usize]);
        let area = 0.5 * (b - a).cross(&(c - a)).norm();
        let middle = Point3::from((a.coords + b.coords + c.coords) / 3.0);
        sum.area += area;
        if line.covers(&middle, NEAR, Radii::Inscribed, &mut last) {
            sum.near += area;
            continue;
        }
        let far = FAR.map(|(radii, kind, _)| !line.covers(&middle, radii, kind, &mut last));
        far.into_iter().zip(&mut sum.far).filter(|(far, _)| *far).for_each(|(_, sum)| *sum += area);
        if far.contains(&true) && sum.missed.len() < NOTED {
            sum.missed.push(middle);
        }
    }
    sum
}

impl Covered {
    pub fn add(&mut self, other: &Self) {
        self.area += other.area;
        self.near += other.near;
        self.far.iter_mut().zip(other.far).for_each(|(sum, far)| *sum += far);
        self.missed.extend(&other.missed);
    }

    /// Share of the area near the line; 1 of a surface without area.
    pub fn share(&self) -> f64 {
        if self.area > 0.0 { self.near / self.area } else { 1.0 }
    }

    /// That of component `index` where wall lies farther from its line than its radii allow.
    pub fn warning(&self, index: usize, line: &LineTree) -> Option<Warning> {
        let told = |(far, (.., least)): (&f64, (f64, Radii, f64))| *far > least * self.area;
        let number = self.far.iter().zip(FAR).rposition(told)?;
        let away = |place: &&Point3<f64>| line.least_share(place);
        let place = self.missed.iter().max_by(|a, b| away(a).total_cmp(&away(b)))?;
        Some(Warning {
            code: "wall-without-line",
            detail: format!(
                "{:.2} % of the wall of component {index} lies farther than {} radii from the line, most of all \
                 near [{:.4}, {:.4}, {:.4}]: a branch may be missing there",
                100.0 * self.far[number] / self.area,
                FAR[number].0,
                place.x,
                place.y,
                place.z
            ),
        })
    }
}
