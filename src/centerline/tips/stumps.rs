//! Short wide branches that a front from elsewhere hides.
//!
//! The front from the root comes to a branch as wide as its vessel aslant: it climbs the near side while it goes round
//! the far one, and where both meet, a corner is all that is left of the branch. Seen from its own tip the branch is a
//! tube up to its base, whichever way the root's front comes.

use rustc_hash::{FxHashMap, FxHashSet};

use crate::mesh::preparation::Surface;

use super::geodesic::EdgeGraph;
use super::height::SAMPLES;
use super::reeb::ReebGraph;
use super::tip_view::{TipView, best_tip_view};
use super::{Branching, ShortTip};
use crate::centerline::{CancelToken, ExtractError};

/// Fewest edges that a leaf's base crosses: fewer are a stair or noise.
pub const EDGES: u32 = 12;
/// How far below a tip the tube begins, in radii: what [`super::root::cap_of`] takes.
const CAP: f64 = 0.5;

/// A short branch as its own tip shows it.
#[derive(Debug, Clone)]
pub struct Stump {
    /// Its tip.
    pub vertex: u32,
    /// The vertices of its cap.
    pub cap: FxHashSet<u32>,
    /// Distance from the cap up to which it is a tube, in the input's unit.
    pub base: f64,
    /// Radius of that tube, in the input's unit.
    pub radius: f64,
    /// The vertex of the leaf that showed it.
    pub leaf: u32,
}

/// The short branches that are tubes seen from their tips and that the front from the root shows as less: those that
/// it left out, and those of which it shows only a part. Tips that a front from
/// `elsewhere` left are looked at too. O(wall within some radii of each leaf that is looked at, up to 15 times).
///
/// # Errors
/// [`ExtractError::Cancelled`].
pub fn stumps(
    surface: &Surface,
    edges: &EdgeGraph,
    (graph, branching): (&ReebGraph, &Branching),
    elsewhere: &[ShortTip],
    tip_height: f64,
    cancel: &CancelToken,
) -> Result<Vec<Stump>, ExtractError> {
    let ends = ends(surface, graph, branching);
    let kept = branching.low.iter().map(|tip| (tip, true));
    let went = branching.doubtful.iter().chain(elsewhere).map(|tip| (tip, false));
    let mut found: Vec<Stump> = Vec::new();
    // Two leaves of one branch are one.
    let mut taken: FxHashSet<u32> = FxHashSet::default();
    for (tip, stays) in kept.chain(went) {
        cancel.check()?;
        if taken.contains(&tip.leaf.vertex) {
            continue;
        }
        let opening = surface.opening_at(tip.leaf.vertex);
        // A vessel was cut at an opening, however shortly; one that went is a hole.
        let is_cut = stays && opening.is_some_and(|opening| !opening.was_closed);
        let view = match opening {
            Some(opening) => TipView::of_opening(surface, edges, opening, cancel)?,
            None => best_tip_view(surface, edges, &tip.leaf, cancel)?,
        };
        let Some(view) = view else { continue };
        let own = stays.then_some(tip.leaf.vertex);
        let is_branch = || {
            let is_tube = tip.leaf.beside.is_some_and(|beside| view.is_tube(beside));
            is_tube && view.height() >= view.least_height(tip, tip_height)
        };
        if !view.has_end_but(own, &ends)
            && view.is_one_ring(edges)
            && (is_cut || is_branch())
            && (!stays || view.is_hidden(tip))
            && taken.is_disjoint(&view.stump.cap)
        {
            taken.extend(view.between(0.0..view.stump.base));
            found.push(view.stump);
        }
    }
    Ok(found)
}

/// The ends' vertices, and what stands for them: of an opening its rim, as its centre is raised.
fn ends(surface: &Surface, graph: &ReebGraph, branching: &Branching) -> Vec<(u32, Vec<u32>)> {
    let rims: FxHashMap<u32, &Vec<u32>> =
        surface.openings.iter().map(|opening| (opening.centre, &opening.rim)).collect();
    let vertices = branching.end_nodes().into_iter().map(|node| graph.nodes[node as usize].vertex);
    vertices.map(|v| (v, rims.get(&v).map_or_else(|| vec![v], |rim| rim.to_vec()))).collect()
}

impl TipView {
    /// Whether one of the `ends` but its `own` lies on it or near its base: then the tube is that end's vessel, and the
    /// tip a second leaf of it.
    fn has_end_but(&self, own: Option<u32>, ends: &[(u32, Vec<u32>)]) -> bool {
        /// How far from the base another end lies at least, in radii.
        const APART: f64 = 1.5;
        let far = self.stump.base + APART * self.stump.radius;
        let is_near = |v: &u32| self.near.distance(*v).is_some_and(|d| d < far);
        ends.iter().any(|(end, places)| Some(*end) != own && places.iter().any(is_near))
    }

    /// Whether it is a tube and no pocket of a vessel's wall, as a bend has in front of a throat: those are wider than the
    /// vessel and shorter than their radius.
    fn is_tube(&self, beside: f64) -> bool {
        /// Most that a tube of any length is wider than the vessel, and radii that a wider one is long.
        const WIDE: f64 = 1.1;
        const LONG: f64 = 1.0;
        self.stump.radius <= WIDE * beside || self.slenderness() >= LONG
    }

    /// How far it stands out, in the input's unit.
    fn height(&self) -> f64 {
        self.stump.base + CAP * self.stump.radius
    }

    /// How far it must, to be a branch.
    fn least_height(&self, tip: &ShortTip, tip_height: f64) -> f64 {
        let Stump { radius, .. } = self.stump;
        let narrower = tip.leaf.beside.map_or(radius, |beside| radius.min(beside));
        (tip_height * narrower).max(SAMPLES * tip.sample)
    }

    /// Whether the root's front shows no more than a part of an end that stays.
    fn is_hidden(&self, tip: &ShortTip) -> bool {
        /// Most that a part rises, and least that it falls short of the whole, in radii: more is no corner.
        const PART: (f64, f64) = (3.0, 0.25);
        let Stump { radius, .. } = self.stump;
        tip.height < (PART.0 * radius).min(self.height() - PART.1 * radius)
    }
}
