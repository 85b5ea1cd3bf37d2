//! Whether the line reaches every part of its surface: what it misses shows as wall without a line.

use nalgebra::Point3;
use rayon::prelude::*;

use crate::mesh::preparation::Surface;

use super::piece::{self, large_piece};
use super::reach::{NEAR, Radii, Reach, middle_and_area};
use crate::centerline::component::ComponentGraph;
use crate::centerline::graph::Warning;
use crate::centerline::line_tree::LineTree;

/// What of the wall lies farther than so many radii of the line there (first) is told from so large a share of the
/// area on (second): little of it when it lies far.
const FAR: [(f64, Radii, f64); 3] =
    [(1.5, Radii::Wide, 0.005), (2.0, Radii::Wide, 5e-4), (3.0, Radii::Either, 0.005)];
/// The most triangles that are looked at, evenly by number.
const SAMPLES: usize = 20_000;
/// How many of them one task looks at.
const CHUNK: usize = 1000;

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
    let line = &Reach::new(surface, line, graph);
    let step = surface.mesh.triangles.len().div_ceil(SAMPLES).max(1);
    let chunks = surface.mesh.triangles.par_chunks(CHUNK * step);
    let parts: Vec<Covered> =
        chunks.map(|chunk| of_triangles(surface, line, chunk.iter().step_by(step))).collect();
    let mut sum = Covered::default();
    parts.iter().for_each(|part| sum.add(part));
    Covered { piece: large_piece(surface, line), ..sum }
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
        let (middle, area) = middle_and_area(surface, corners);
        sum.area += area;
        if line.covers(&middle, NEAR, Radii::Inscribed, &mut last) {
            sum.near += area;
            continue;
        }
        if line.is_beyond_cut(&middle) {
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
             than {} of the half axes that are usual there from the line",
            piece::FAR
        );
        Some((what, self.piece?))
    }
}
