//! Roots put straight.
//!
//! Behind an end that lies a few radii from a joint the level sets of a front from elsewhere take in the joint's wall: they
//! tell a wider end that points aside, and a cap of the vessel's wall, from which every other front would come aslant. A
//! front from the end itself tells what it is.

use crate::mesh::preparation::Surface;

use super::Leaf;
use super::geodesic::EdgeGraph;
use super::root::{Cap, Root};
use super::tip_view::{TipView, best_tip_view};
use crate::centerline::{CancelToken, ExtractError};

/// The root with the cap that a front from it shows, where that is of a narrower tube than the root was taken for.
/// O(wall within some radii, up to 31 times).
///
/// # Errors
/// [`ExtractError::Cancelled`].
pub fn straightened(
    surface: &Surface,
    edges: &EdgeGraph,
    root: Root,
    cancel: &CancelToken,
) -> Result<Root, ExtractError> {
    /// What the radius may have been taken for, in the tube's: within, the root stays.
    const WIDER: f64 = 1.25;
    /// Radii that a tube is long at least: a shorter one shows no direction.
    const LONG: f64 = 0.8;
    let Some(end) = root.end else { return Ok(root) };
    let is_long = |view: &TipView| view.slenderness() >= LONG;
    let is_narrower = |view: &TipView| WIDER * view.stump.radius < end.radius;
    let seen = TipView::from(surface, edges, &end, (end.vertex, end.radius), cancel)?;
    if seen.is_some_and(|seen| is_long(&seen) && !is_narrower(&seen)) {
        return Ok(root);
    }
    let mut best: Option<TipView> = None;
    for radius in [end.radius, 0.5 * end.radius] {
        let Some(view) = best_tip_view(surface, edges, &leaf_of(surface, &end, radius), cancel)? else {
            continue;
        };
        let is_better = best.as_ref().is_none_or(|best| view.slenderness() > best.slenderness());
        if is_better && view.is_one_ring(edges) {
            best = Some(view);
        }
    }
    let best = best.filter(|best| is_long(best) && is_narrower(best));
    let Some(TipView { stump, .. }) = best else { return Ok(root) };
    // An opening's centre is raised: it stays the end.
    let centre = surface.openings.iter().map(|opening| opening.centre).find(|v| stump.cap.contains(v));
    Ok(Root::of(surface, centre.unwrap_or(stump.vertex), &stump.cap))
}

/// An end as the leaf of a vessel of such a radius.
fn leaf_of(surface: &Surface, end: &Cap, radius: f64) -> Leaf {
    let base = surface.mesh.vertices[end.vertex as usize] - end.outward * radius;
    Leaf { vertex: end.vertex, base, radius, beside: Some(radius) }
}
