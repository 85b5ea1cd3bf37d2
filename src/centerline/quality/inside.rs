//! How much of the line lies inside the lumen.

use nalgebra::Point3;
use rayon::prelude::*;

use crate::centerline::component::ComponentGraph;
use crate::centerline::graph::{Branch, Warning};
use crate::centerline::triangle_grid::TriangleGrid;

/// Share of the length below which a result carries a warning. Ends lie on the wall itself.
const LEAST: f64 = 0.999;

/// The length of the line, and what of it is outside.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Inside {
    length: f64,
    outside: f64,
    /// The middle of the longest stretch outside, and that stretch's length.
    worst: Option<(Point3<f64>, f64)>,
}

/// Cuts every segment where it meets the surface, and asks of each piece whether it is inside.
pub fn measure(grid: &TriangleGrid<'_>, graph: &ComponentGraph) -> Inside {
    let branches: Vec<Inside> = graph.branches.par_iter().map(|branch| of_branch(grid, branch)).collect();
    let mut sum = Inside::default();
    branches.iter().for_each(|branch| sum.add(branch));
    sum
}

fn of_branch(grid: &TriangleGrid<'_>, branch: &Branch) -> Inside {
    let mut sum = Inside::default();
    // Whether the line was inside where the segment begins; it stays so until it meets the surface.
    let mut state = None;
    for pair in branch.points.windows(2) {
        let way = pair[1] - pair[0];
        let crossings = grid.crossings(&pair[0], &pair[1]);
        let bounds: Vec<f64> =
            [0.0].into_iter().chain(crossings).chain([1.0]).map(|s| s.clamp(0.0, 1.0)).collect();
        for piece in bounds.windows(2).filter(|piece| piece[1] > piece[0]) {
            let middle = pair[0] + way * (0.5 * (piece[0] + piece[1]));
            let inside = state.unwrap_or_else(|| grid.encloses(&middle));
            let length = way.norm() * (piece[1] - piece[0]);
            sum.add(&Inside {
                length,
                outside: if inside { 0.0 } else { length },
                worst: (!inside).then_some((middle, length)),
            });
            state = (bounds.len() == 2).then_some(inside);
        }
    }
    sum
}

impl Inside {
    pub fn add(&mut self, other: &Self) {
        self.length += other.length;
        self.outside += other.outside;
        let longer = |&(_, length): &(Point3<f64>, f64)| self.worst.is_none_or(|(_, most)| length > most);
        self.worst = other.worst.filter(longer).or(self.worst);
    }

    /// 1 of a line without length.
    pub fn share(&self) -> f64 {
        if self.length > 0.0 { 1.0 - self.outside / self.length } else { 1.0 }
    }

    /// That of component `index` where too much is outside.
    pub fn warning(&self, index: usize) -> Option<Warning> {
        let (at, _) = self.worst.filter(|_| self.share() < LEAST)?;
        Some(Warning {
            code: "outside",
            detail: format!(
                "{:.2} % of the line of component {index} lies outside the wall, most of all around \
                 [{:.4}, {:.4}, {:.4}]: the line is wrong there",
                100.0 * (1.0 - self.share()),
                at.x,
                at.y,
                at.z
            ),
        })
    }
}
