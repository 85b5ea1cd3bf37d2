//! Whether the line reaches every part of its surface: what it misses shows as wall without a line.

use nalgebra::Point3;
use rayon::prelude::*;

use crate::mesh::preparation::Surface;

use crate::centerline::graph::Warning;
use crate::centerline::line_tree::LineTree;

/// Farthest that covered wall lies, in radii of the line there.
const NEAR: f64 = 1.5;
/// Farthest that wall may lie without a warning, in radii of the line there: the wall of a flat vessel does.
const FAR: f64 = 3.0;
/// The most triangles that are looked at, evenly by number.
const SAMPLES: usize = 20_000;
/// How many of them one task looks at.
const CHUNK: usize = 1000;

/// Areas of the surface, in squared units of the input.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Covered {
    area: f64,
    near: f64,
    far: f64,
    /// Middles of some triangles that are far.
    missed: Vec<Point3<f64>>,
}

/// The area near the line, and far from it: of each triangle that is looked at, by its middle.
/// O(those x log segments).
pub fn measure(surface: &Surface, line: &LineTree) -> Covered {
    let step = surface.mesh.triangles.len().div_ceil(SAMPLES).max(1);
    let chunks = surface.mesh.triangles.par_chunks(CHUNK * step);
    let parts: Vec<Covered> =
        chunks.map(|chunk| of_triangles(surface, line, chunk.iter().step_by(step))).collect();
    let mut sum = Covered::default();
    parts.iter().for_each(|part| sum.add(part));
    sum
}

fn of_triangles<'a>(
    surface: &Surface,
    line: &LineTree,
    triangles: impl Iterator<Item = &'a [u32; 3]>,
) -> Covered {
    /// As many missed places a task are enough to find the worst nearby.
    const NOTED: usize = 64;
    let mut sum = Covered::default();
    // The segment that was found last is tried first.
    let mut last = None;
    for corners in triangles {
        let [a, b, c] = corners.map(|v| surface.mesh.vertices[v as usize]);
        let area = 0.5 * (b - a).cross(&(c - a)).norm();
        let middle = Point3::from((a.coords + b.coords + c.coords) / 3.0);
        sum.area += area;
        let mut is_within = |radii: f64| {
            let again = last.is_some_and(|index: usize| line.segments()[index].share(&middle) <= radii);
            again
                || line.any_near(&middle, 0.0, radii, |index, segment| {
                    let found = segment.share(&middle) <= radii;
                    if found {
                        last = Some(index);
                    }
                    found
                })
        };
        if is_within(NEAR) {
            sum.near += area;
        } else if !is_within(FAR) {
            sum.far += area;
            if sum.missed.len() < NOTED {
                sum.missed.push(middle);
            }
        }
    }
    sum
}

impl Covered {
    pub fn add(&mut self, other: &Self) {
        self.area += other.area;
        self.near += other.near;
        self.far += other.far;
        self.missed.extend(&other.missed);
    }

    /// Share of the area near the line; 1 of a surface without area.
    pub fn share(&self) -> f64 {
        if self.area > 0.0 { self.near / self.area } else { 1.0 }
    }

    /// That of component `index` where wall lies farther from its line than its radii allow.
    pub fn warning(&self, index: usize, line: &LineTree) -> Option<Warning> {
        /// Least share of the wall that is told.
        const LEAST: f64 = 0.005;
        if self.far <= LEAST * self.area {
            return None;
        }
        let away = |place: &&Point3<f64>| line.least_share(place);
        let place = self.missed.iter().max_by(|a, b| away(a).total_cmp(&away(b)))?;
        Some(Warning {
            code: "wall-without-line",
            detail: format!(
                "{:.1} % of the wall of component {index} lies farther than {FAR} radii from the line, most of all \
                 near [{:.4}, {:.4}, {:.4}]: a branch may be missing there",
                100.0 * self.far / self.area,
                place.x,
                place.y,
                place.z
            ),
        })
    }
}
