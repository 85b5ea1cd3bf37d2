//! A piece of wall in one that lies far from the line: little beside a large surface, but as large as what a short branch
//! shows of itself.

use std::f64::consts::PI;

use nalgebra::Point3;
use rayon::prelude::*;
use rustc_hash::FxHashSet;

use super::reach::{Radii, Reach, middle_and_area};
use crate::mesh::preparation::Surface;

/// How far from the line its wall lies, in the branch's usual half axes: the section at a joint takes in what is missing.
pub const FAR: f64 = 1.7;
/// Area of a piece that is told, in that of a circle of the line's radius.
const LARGE: f64 = 0.25;

/// Where a large piece is: its triangle that lies farthest, of those that are looked at. A piece is followed until it is large.
/// O((triangles + those of small pieces) x log segments).
pub fn large_piece(surface: &Surface, reach: &Reach<'_>) -> Option<Point3<f64>> {
    let mut seen = FxHashSet::default();
    let mut last = None;
    for (_, seed) in seeds(surface, reach) {
        let mut queue = vec![seed];
        let mut circles = 0.0;
        while let Some(triangle) = queue.pop() {
            let (middle, area) = middle_and_area(surface, &surface.mesh.triangles[triangle as usize]);
            if !seen.insert(triangle) || !is_far(reach, &middle, &mut last) {
                continue;
            }
            let (_, radius) = reach.line.nearest_in_radii(&middle)?;
            circles += area / (PI * radius * radius);
            if circles > LARGE {
                return Some(middle_and_area(surface, &surface.mesh.triangles[seed as usize]).0);
            }
            let around = 3 * triangle..3 * triangle + 3;
            queue.extend(around.map(|h| surface.corners.opposite(h) / 3));
        }
    }
    None
}

/// Triangles that lie far, with how far in radii, the farthest first.
fn seeds(surface: &Surface, reach: &Reach<'_>) -> Vec<(f64, u32)> {
    /// Of so many triangles all are looked at; of more every second, and so on, at least every eighth, as a large piece has more.
    const ALL: usize = 100_000;
    const FEWEST: usize = 8;
    /// How many one task looks at.
    const CHUNK: usize = 2000;
    let all = &surface.mesh.triangles;
    let step = (all.len() / ALL).clamp(1, FEWEST);
    let numbers = (0..all.len() as u32).into_par_iter().step_by(step).chunks(CHUNK);
    let far = |numbers: Vec<u32>| {
        let mut last = None;
        let far = numbers.into_iter().filter_map(|number| {
            let (middle, _) = middle_and_area(surface, &all[number as usize]);
            let is_far = is_far(reach, &middle, &mut last);
            is_far.then(|| (reach.line.least_share(&middle), number))
        });
        far.collect::<Vec<_>>()
    };
    let mut seeds: Vec<(f64, u32)> = numbers.flat_map_iter(far).collect();
    seeds.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    seeds
}

/// Whether a place on the wall lies that far.
fn is_far(reach: &Reach<'_>, place: &Point3<f64>, last: &mut Option<usize>) -> bool {
    !reach.covers(place, FAR, Radii::Usual, last) && !reach.is_beyond_cut(place)
}
