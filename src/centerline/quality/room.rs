//! Whether the spheres that the line tells of fit into the vessel.
//!
//! The told radius is held against the nearest quarter of the wall around an [`OwnSection`]: noise of single vertices is
//! not heard, nor what the facets of a coarse mesh cut off, but a flat side is, and a wall that the line lies beside.

use crate::centerline::component::ComponentGraph;
use crate::centerline::graph::{Branch, Warning};
use crate::centerline::median::median;
use crate::centerline::own_sections::OwnSection;

/// Over how many of those distances it must not fit, in one stretch.
const STRETCH: f64 = 3.0;
/// Told radius over the distance of the wall from which on one section is enough: a narrow place that is shorter than it is
/// wide, which the line passed over.
const FOCAL: f64 = 1.5;
/// Farthest between two sections of a stretch, in radii of the first: what has none between them, as a sac, is not spoken of.
const GAP: f64 = 1.5;

/// What a told radius is held against.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Against {
    /// The wall as its vertices show it: no such sphere is in the vessel.
    Wall,
    /// The facets between them: a prism of six sides and less, or a tube that was sampled by as few.
    Facets,
}

impl Against {
    /// Told radius over the distance from which on it does not fit.
    fn most(self) -> f64 {
        match self {
            Against::Wall => 1.25,
            // A regular prism of 7 sides has 1.11, of 6 sides 1.155.
            Against::Facets => 1.12,
        }
    }

    fn distance(self, section: &OwnSection) -> f64 {
        match self {
            Against::Wall => section.near,
            Against::Facets => section.facets,
        }
    }
}

/// The longest stretch of a line whose spheres do not fit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tight {
    against: Against,
    branch: usize,
    /// Its first and last point in the branch.
    places: [usize; 2],
    length: f64,
    /// Told radius over the distance: the median of a long stretch, the greatest of a short one.
    excess: f64,
}

/// The stretch that is longest against the room that it has; `None` where all spheres fit, or but for single ones.
pub fn measure(graph: &ComponentGraph, sections: &[OwnSection], against: Against) -> Option<Tight> {
    let most = against.most();
    let excess = |section: &OwnSection| {
        graph.branches[section.branch].radii[section.place] / against.distance(section)
    };
    let ways: Vec<Vec<f64>> = graph.branches.iter().map(Branch::ways).collect();
    let way = |a: &OwnSection, b: &OwnSection| ways[a.branch][b.place] - ways[a.branch][a.place];
    let together = |a: &OwnSection, b: &OwnSection| {
        a.branch == b.branch && (excess(a) > most) == (excess(b) > most) && way(a, b) < GAP * a.radius
    };
    let tight = |run: &[OwnSection]| {
        let (first, last) = (run.first()?, run.last()?);
        let length = way(first, last);
        let usual = median(run.iter().map(excess).collect());
        let near = median(run.iter().map(|section| against.distance(section)).collect());
        let worst = run.iter().map(excess).fold(0.0, f64::max);
        let is_long = usual > most && length > STRETCH * near;
        let is_focal = against == Against::Wall && worst > FOCAL;
        let (places, excess) = ([first.place, last.place], if is_long { usual } else { worst });
        let found = Tight { against, branch: first.branch, places, length, excess };
        (is_long || is_focal).then_some((found, length / near))
    };
    let all = sections.chunk_by(together).filter_map(tight);
    all.max_by(|a, b| a.1.total_cmp(&b.1)).map(|(tight, _)| tight)
}

impl Tight {
    /// That of component `index`.
    pub fn warning(&self, index: usize, graph: &ComponentGraph) -> Warning {
        let points = &graph.branches[self.branch].points;
        let [from, to] = self.places.map(|place| points[place]);
        let (code, what) = match self.against {
            Against::Wall => ("radius", "the distance of the wall: no such spheres fit"),
            Against::Facets => (
                "few-sides",
                "the distance of the facets: they are told through the vertices, as of a round vessel; where its sides are flat, \
                 divide by as much",
            ),
        };
        Warning {
            code,
            detail: format!(
                "on {:.4} of branch {} of component {index}, from [{:.4}, {:.4}, {:.4}] to [{:.4}, {:.4}, {:.4}], radii are {:.2} \
                 times {what}",
                self.length, self.branch, from.x, from.y, from.z, to.x, to.y, to.z, self.excess
            ),
        }
    }
}
