//! How far the line's points lie from the middle of the vessel.
//!
//! The points that count are those of the line's [`OwnSection`]s. The offset is the distance to the section's
//! centroid, over the radius of the circle of the section's area.

use super::Centeredness;
use crate::centerline::graph::Warning;
use crate::centerline::own_sections::OwnSection;

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

    /// That of component `index` where no point counts.
    pub fn warning(&self, index: usize) -> Option<Warning> {
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
    let offsets = || sections.iter().map(|section| section.offset / section.radius);
    Offsets { sum: offsets().sum(), max: offsets().fold(0.0, f64::max), sections: sections.len() }
}
