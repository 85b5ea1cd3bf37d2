//! The Reeb graph that the line hangs on, and which of its arcs are branches.

use rayon::prelude::*;
use rustc_hash::FxHashSet;

use crate::mesh::preparation::Surface;

use super::counter_fronts::{countered, with_peaks};
use super::geodesic::{EdgeGraph, geodesic};
use super::picks::{Kept, Picks, keep, root_near};
use super::reeb::{ReebGraph, reeb_graph, reeb_graph_of};
use super::root::{Among, Root, roots};
use super::straight_roots::straightened;
use super::stumps::{Stump, stumps};
use super::{Branching, Choice, ROOT, chains, farthest};
use crate::centerline::{CancelToken, Control, ExtractError, Stage};

/// A tip that stands so many times as high as it must is an end from wherever it was seen.
const HIGH: f64 = 1.5;

/// The Reeb graph as seen from one root.
struct View {
    graph: ReebGraph,
    branching: Branching,
    /// The edges that distances were measured along.
    edges: EdgeGraph,
    source: u32,
}

/// The Reeb graph of the geodesic distance from the widest end's cap, and its chains. Where several ends
/// might be that, the one from which most ends are seen; `among` says which ends are looked at. What the user picked
/// goes before all that. A few Dijkstra runs and sweeps: O(n log n).
///
/// # Errors
/// [`ExtractError::Cancelled`].
pub fn skeleton(
    surface: &Surface,
    tip_height: f64,
    picks: &Picks,
    among: Among,
    control: &Control<'_>,
) -> Result<(ReebGraph, Branching), ExtractError> {
    let cancel = &control.cancel;
    let choice = Choice { keeps_root: picks.root.is_some(), ..Choice::by_height(tip_height) };
    let mut edges = EdgeGraph::new(&surface.mesh.vertices, &surface.corners);
    edges.raise(&surface.openings);
    let anywhere = geodesic(&edges, &[0], cancel)?;
    control.report(Stage::Tips, 0.2)?;
    let source = farthest(&anywhere.distance);
    let graph = reeb_graph(surface, &edges, &[source], cancel)?;
    let first = chains(surface, &graph, &choice, cancel)?;
    control.report(Stage::Segmentation, 0.0)?;
    let first = View { graph, branching: first, edges, source };
    let best = seen_from_an_end(surface, &first, picks, among, &choice, control)?;
    let (view, other) = match best {
        Some(best) => (best, Some(first)),
        None => (first, None),
    };
    let (view, stumps) = match among {
        Among::AllEnds => with_stumps(surface, view, other.as_ref(), &choice, cancel)?,
        Among::LongEnds => (view, Vec::new()),
    };
    let View { graph, branching, mut edges, source } = view;
    if picks.include.is_empty() && picks.exclude.is_empty() {
        return Ok((graph, branching));
    }
    let Kept { mut leaves, raised } = keep(surface, &graph, &branching, &picks.include);
    leaves.extend(stumps.iter().map(|stump| stump.vertex));
    let choice = Choice { kept: &leaves, excluded: &picks.exclude, ..choice };
    let graph = if raised.is_empty() {
        graph
    } else if stumps.is_empty() {
        edges.raise_vertices(&raised);
        reeb_graph(surface, &edges, &[source], cancel)?
    } else {
        reeb_graph_of(surface, with_peaks(&edges, (source, &graph.function), &raised, cancel)?, cancel)?
    };
    let branching = chains(surface, &graph, &choice, cancel)?;
    Ok((graph, Branching { raised, ..branching }))
}

/// The view with the short wide branches that it hides, and these. They were judged from their own tips, and stay where all
/// of them are ends then and no other is lost. The leaves that
/// went from the `first` view, where it is another, are looked at too.
fn with_stumps(
    surface: &Surface,
    view: View,
    first: Option<&View>,
    choice: &Choice<'_>,
    cancel: &CancelToken,
) -> Result<(View, Vec<Stump>), ExtractError> {
    let elsewhere = first.map_or(&[][..], |first| &first.branching.doubtful);
    // Not those of a view whose root's cap has no extent.
    let edges = first.map_or(&view.edges, |first| &first.edges);
    let seen = (&view.graph, &view.branching);
    let stumps = stumps(surface, edges, seen, elsewhere, choice.tip_height, cancel)?;
    if stumps.is_empty() {
        return Ok((view, stumps));
    }
    let function = countered(edges, (view.source, &view.graph.function), &stumps, cancel)?;
    let graph = reeb_graph_of(surface, function, cancel)?;
    let kept: Vec<u32> = stumps.iter().map(|stump| stump.vertex).collect();
    let branching = chains(surface, &graph, &Choice { kept: &kept, ..*choice }, cancel)?;
    let ends = |graph: &ReebGraph, branching: &Branching| -> FxHashSet<u32> {
        branching.end_nodes().into_iter().map(|node| graph.nodes[node as usize].vertex).collect()
    };
    let (before, after) = (ends(&view.graph, &view.branching), ends(&graph, &branching));
    let added = stumps.iter().filter(|stump| !before.contains(&stump.leaf)).count();
    let stay = after.len() == before.len() + added && kept.iter().all(|v| after.contains(v));
    if !stay {
        return Ok((view, Vec::new()));
    }
    Ok((View { graph, branching, ..view }, stumps))
}

/// What is seen from the end that distances are best taken from; `None` where that is no better than what was seen `first`.
fn seen_from_an_end(
    surface: &Surface,
    first: &View,
    picks: &Picks,
    among: Among,
    choice: &Choice<'_>,
    control: &Control<'_>,
) -> Result<Option<View>, ExtractError> {
    let View { graph, branching, edges, .. } = first;
    let seen = match picks.root {
        Some(pick) => vec![root_near(surface, graph, branching, pick.vertex)],
        None => roots(surface, graph, branching, among),
    };
    let mut best = best_view(surface, edges, seen, choice, control)?;
    // Where the root is no end, fronts started on a vessel's side: what they leave for the last may be none either.
    if picks.root.is_none() && best.as_ref().is_some_and(|best| !best.branching.ends_at(ROOT)) {
        let sure = Branching { doubtful: Vec::new(), ..branching.clone() };
        let seen = best_view(surface, edges, roots(surface, graph, &sure, among), choice, control)?;
        best = seen.filter(|seen| seen.branching.ends_at(ROOT)).or(best);
    }
    // A front square to the vessel climbs a wide sac on its side while it passes; one that came aslant may not have.
    let sees_fewer = |best: &View| best.branching.ends() < branching.ends();
    if picks.root.is_none() && branching.ends_at(ROOT) && best.as_ref().is_some_and(sees_fewer) {
        let high = Choice { tip_height: HIGH * choice.tip_height, ..*choice };
        let high = chains(surface, graph, &high, &control.cancel)?;
        best = best.filter(|best| best.branching.ends() >= high.ends());
    }
    Ok(best)
}

/// What is seen from the best of some roots: one that stays an end, and then the one that sees most ends.
fn best_view(
    surface: &Surface,
    edges: &EdgeGraph,
    roots: Vec<Root>,
    choice: &Choice<'_>,
    control: &Control<'_>,
) -> Result<Option<View>, ExtractError> {
    let view = |root: Root| {
        let root = straightened(surface, edges, root, &control.cancel)?;
        let mut edges = edges.clone();
        edges.shrink(&root.cap);
        let graph = reeb_graph(surface, &edges, &[root.vertex], &control.cancel)?;
        let branching = chains(surface, &graph, choice, &control.cancel)?;
        Ok(View { graph, branching, edges, source: root.vertex })
    };
    let views = roots.into_par_iter().map(view).collect::<Result<Vec<_>, ExtractError>>()?;
    control.report(Stage::Segmentation, 0.4)?;
    let rank = |branching: &Branching| (branching.ends_at(ROOT), branching.ends());
    let mut best: Option<View> = None;
    for view in views {
        if best.as_ref().is_none_or(|best| rank(&view.branching) > rank(&best.branching)) {
            best = Some(view);
        }
    }
    Ok(best)
}
