//! What was measured of a line, as users see it.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::centerline::Quality;

/// How good the line is: measured on it and the surface alone, whatever method made it. Components without a
/// line are left out; each is a warning.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct QualityRecord {
    pub homotopy: HomotopyRecord,
    /// Share of the line's length inside the lumen. Below 0.999 there is the warning `outside`.
    #[schema(minimum = 0, maximum = 1)]
    pub inside: f64,
    pub centeredness: CenterednessRecord,
    /// Share of the surface's area, caps of openings included, within 1.5 local radii of the line.
    #[schema(minimum = 0, maximum = 1)]
    pub coverage: f64,
    /// Whether the line is one-dimensional: no segment shorter than 1e-6 local radii, none that turns back by more
    /// than 170 degrees, and no two stretches nearer to each other than 0.05 local radii but where they meet.
    pub thinness: bool,
}

/// Parts and loops of the line against those of the surface.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct HomotopyRecord {
    /// Components of the surface that have a line.
    pub components: usize,
    /// Handles of these components, their openings capped.
    pub genus: usize,
    /// Connected parts of the line.
    pub parts: usize,
    /// Independent loops of the line.
    pub loops: usize,
    /// Whether each component has one part with as many loops as handles. Else there is the warning `homotopy`.
    pub equal: bool,
}

/// Distance of the line's inner points from the centroids of the sections perpendicular to it, in radii of the
/// circles that have the sections' areas. A point counts where the closed section around it is one vessel's own:
/// convex within 15 %, reached by no other branch's inscribed sphere, and a radius away from the branch's ends.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct CenterednessRecord {
    /// Null where no point counts.
    #[schema(required = true)]
    pub mean: Option<f64>,
    /// Null where no point counts.
    #[schema(required = true)]
    pub max: Option<f64>,
    /// How many points count.
    pub sections: usize,
}

impl From<&Quality> for QualityRecord {
    fn from(quality: &Quality) -> Self {
        let Quality { homotopy, inside, centeredness, coverage, thinness } = *quality;
        Self {
            homotopy: HomotopyRecord {
                components: homotopy.components,
                genus: homotopy.genus,
                parts: homotopy.parts,
                loops: homotopy.loops,
                equal: homotopy.equal,
            },
            inside,
            centeredness: CenterednessRecord {
                mean: centeredness.mean,
                max: centeredness.max,
                sections: centeredness.sections,
            },
            coverage,
            thinness,
        }
    }
}
