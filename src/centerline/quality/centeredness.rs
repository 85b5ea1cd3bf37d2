//! How far the line's points lie from the middle of the vessel.
//!
//! The points that count are those of the line's [`OwnSection`]s. The offset is the distance to the section's
//! centroid, over the radius of the circle of the section's area.

use nalgebra::Point3;

use super::Centeredness;
use crate::centerline::graph::Warning;
use crate::centerline::own_sections::OwnSection;

/// Offset that is warned of.
const ASIDE: f64 = 0.6;

/// Sums over the points that count.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Offsets {
    sum: f64,
    max: f64,
    /// The middle of the section with the largest.
    farthest: Point3<f64>,
    sections: usize,
}

impl Offsets {
    pub fn add(&mut self, other: &Self) {
        self.sum += other.sum;
        if other.max > self.max {
            (self.max, self.farthest) = (other.max, other.farthest);
        }
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

    /// That of component `index` where no point counts, or one lies far from the middle.
    pub fn warning(&self, index: usize) -> Option<Warning> {
        if self.max > ASIDE {
            let Point3 { coords: at } = self.farthest;
            return Some(Warning {
                code: "off-center",
                detail: format!(
                    "the line of component {index} lies {:.2} radii beside the middle of its vessel, which is [{:.4}, {:.4}, {:.4}] \
                     there, as it does where it misses a narrow place",
                    self.max, at.x, at.y, at.z
                ),
            });
        }
        (self.sections == 0).then(|| Warning {
            code: "no-section",
            detail: format!(
                "no section shows a vessel of component {index} alone, as where it is short or rough: nothing tells how well its \
                 line is centred, and its radii were not held against the wall"
            ),
        })
    }
}

/// The offsets of a component's line.
pub fn measure(sections: &[OwnSection]) -> Offsets {
    let mut all = Offsets::default();
    for section in sections {
        let offset = section.offset / section.radius;
        all.add(&Offsets { sum: offset, max: offset, farthest: section.middle, sections: 1 });
    }
    all
}
