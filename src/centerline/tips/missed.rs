//! Short branches that may have been taken for bumps.
//!
//! Where a front hides a short branch (see [`super::stumps`]) and one from its tip shows no tube either, as on coarse or
//! noisy walls, a corner is left that rises too little to be an end, and a line from so little would run beside the
//! branch. But it stands over its vessel as no bump does: there the user is told to look.

use super::reeb::ReebGraph;
use super::{Branching, Choice, Leaf, Pruning, ShortTip};
use crate::centerline::Warning;
use crate::centerline::component::ComponentGraph;
use crate::centerline::line_tree::LineTree;
use crate::mesh::preparation::Surface;

/// A leaf that went although it stands high over its vessel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Missed {
    /// The leaf's Reeb node.
    leaf: u32,
    /// How far it stands over the vessel's wall, in radii of its base or of the vessel, whichever is smaller.
    over: f64,
}

impl Pruning<'_> {
    /// A leaf that goes, and what is known of its `tip`, where it may be a branch.
    pub fn missed(
        &self,
        arcs: &[u32],
        (base, leaf): (u32, u32),
        tip: &ShortTip,
        choice: &Choice<'_>,
    ) -> Option<Missed> {
        /// Fewest edges that its base crosses: where it has fewer, noise is as high.
        const EDGES: u32 = 18;
        /// Least rise, in radii of its base.
        const RISE: f64 = 0.25;
        /// Radii that its base may have, in those of the vessel: of a bump as high as it is wide the corner is thinner, and
        /// what is wider lies where fronts meet.
        const WIDTHS: std::ops::Range<f64> = 0.25..1.0;
        /// Least height over the vessel against that of an end.
        const HIGH: f64 = 1.3;
        let &ShortTip { leaf: Leaf { radius, beside: Some(beside), .. }, height, .. } = tip else {
            return None;
        };
        let (first, _) = self.base_of(arcs)?;
        let is_seen = self.graph.arcs[first as usize].base_edges >= EDGES && height >= RISE * radius;
        if !is_seen || !WIDTHS.contains(&(radius / beside)) {
            return None;
        }
        let (over, least) = match self.met_below(base, arcs, radius) {
            Some(met) => (self.over_fronts(met, leaf), radius),
            None => self.over_vessel(arcs, base, leaf, radius)?,
        };
        // What stands higher than a base so wide lets it stands over another vessel.
        let is_own = over <= height + 2.0 * radius;
        let is_high = over >= HIGH * choice.tip_height * least;
        (is_own && is_high && !self.is_excluded(leaf, choice)).then_some(Missed { leaf, over: over / least })
    }

    /// Whether the user said that there is no end near a leaf.
    fn is_excluded(&self, leaf: u32, choice: &Choice<'_>) -> bool {
        /// Reach of a point, in shares of the surface's diagonal.
        const REACH: f64 = 0.05;
        let far = REACH * self.surface.diagonal();
        let place = |vertex: u32| self.surface.mesh.vertices[vertex as usize];
        choice.excluded.iter().any(|pick| (place(pick.vertex) - self.position(leaf)).norm() < far)
    }
}

impl Branching {
    /// A warning where short branches may be missing, with the places of the highest. What lies as near to the `line` as its
    /// own wall is none, but the pocket of a wall in front of a throat.
    pub fn missed_warning(
        &self,
        surface: &Surface,
        graph: &ReebGraph,
        line: &ComponentGraph,
    ) -> Option<Warning> {
        /// So many are told one by one.
        const TOLD: usize = 8;
        /// Farthest that the line's own wall lies, in its radii.
        const WALL: f64 = 1.35;
        if self.missed.is_empty() {
            return None;
        }
        let (mut missed, line) = (self.missed.clone(), LineTree::new(line));
        let tip = |missed: &Missed| surface.mesh.vertices[graph.nodes[missed.leaf as usize].vertex as usize];
        missed.retain(|missed| line.least_share(&tip(missed)) > WALL);
        missed.sort_by(|a, b| b.over.total_cmp(&a.over).then(a.leaf.cmp(&b.leaf)));
        let highest = missed.first()?.over;
        let place = |missed: &Missed| {
            let place = tip(missed);
            format!("[{:.4}, {:.4}, {:.4}]", place.x, place.y, place.z)
        };
        let places: Vec<String> = missed.iter().take(TOLD).map(place).collect();
        Some(Warning {
            code: "short-branch",
            detail: format!(
                "the wall stands up to {highest:.1} radii over its vessel and was taken for bumps ({} in all), the highest near {}: \
                 short branches may be missing there; a point in include makes one an end",
                missed.len(),
                places.join(", ")
            ),
        })
    }
}
