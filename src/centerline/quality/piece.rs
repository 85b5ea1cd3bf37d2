//! A piece of wall in one that lies far from the line: little beside a large surface, but as large as what a short branch
//! shows of itself.

use std::f64::consts::PI;

use nalgebra::Point3;
use rustc_hash::FxHashSet;

use super::coverage::{Radii, Reach, middle_and_area};
use crate::mesh::preparation::Surface;

/// How far from the line its wall lies, in the branch's usual half axes: the section at a joint takes in what is missing.
pub const FAR: f64 = 1.7;
/// Area of a piece that is told, in that of a circle of the line's radius.
const LARGE: f64 = 0.25;

/// Whether a triangle of wall lies that far, by its middle.
pub fn is_far(reach: &Reach<'_>, middle: &Point3<f64>, last: &mut Option<usize>) -> bool {
    !reach.covers(middle, FAR, Radii::Usual, last)
}

/// The farthest of the `seeds`, which are triangles that lie far, that is of a large piece. Each is as far as its first
/// number says, in radii. A piece is followed until it is large: O(its triangles x log segments).
pub fn large_piece(surface: &Surface, reach: &Reach<'_>, mut seeds: Vec<(f64, u32)>) -> Option<Point3<f64>> {
    seeds.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    let mut seen = FxHashSet::default();
    let mut last = None;
    for (_, seed) in seeds {
        let mut queue = vec![seed];
        let mut circles = 0.0;
        while let Some(triangle) = queue.pop() {
            let (middle, area) = middle_and_area(surface, triangle);
            if !seen.insert(triangle) || reach.is_beyond_cut(&middle) || !is_far(reach, &middle, &mut last) {
                continue;
            }
            let radius = reach.line.nearest_in_radii(&middle).map_or(0.0, |(_, radius)| radius);
            circles += area / (PI * radius * radius);
            if circles > LARGE {
                return Some(middle_and_area(surface, seed).0);
            }
            let around = 3 * triangle..3 * triangle + 3;
            queue.extend(around.map(|h| surface.corners.opposite(h) / 3));
        }
    }
    None
}
