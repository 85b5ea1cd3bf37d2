//! The Reeb graph that the line hangs on, and which of its arcs are branches.

use rayon::prelude::*;

use crate::mesh::preparation::Surface;

use super::geodesic::{EdgeGraph, geodesic};
use super::picks::{Kept, Picks, keep, root_near};
use super::reeb::{ReebGraph, reeb_graph};
use super::root::{Among, Root, roots};
use super::{Branching, Choice, chains, farthest};
use crate::centerline::{Control, ExtractError, Stage};

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
    let (mesh, corners) = (&surface.mesh, &surface.corners);
    let mut edges = EdgeGraph::new(&mesh.vertices, corners);
    edges.raise(&surface.openings);
    let anywhere = geodesic(&edges, &[0], cancel)?;
    control.report(Stage::Tips, 0.2)?;
    let source = farthest(&anywhere.distance);
    let distance = geodesic(&edges, &[source], cancel)?;
    control.report(Stage::Tips, 0.4)?;
    let graph = reeb_graph(&mesh.vertices, corners, distance, cancel)?;
    let first = chains(surface, &graph, &choice, cancel)?;
    control.report(Stage::Segmentation, 0.0)?;
    let mut best = None;
    let candidates = match picks.root {
        Some(pick) => vec![root_near(surface, &graph, &first, pick.vertex)],
        None => roots(surface, &graph, &first, among),
    };
    let seen_from = |root: &Root| {
        let mut edges = edges.clone();
        edges.shrink(&root.cap);
        let distance = geodesic(&edges, &[root.vertex], cancel)?;
        let graph = reeb_graph(&mesh.vertices, corners, distance, cancel)?;
        let found = chains(surface, &graph, &choice, cancel)?;
        Ok((graph, found, edges, root.vertex))
    };
    let all = candidates.par_iter().map(seen_from).collect::<Result<Vec<_>, ExtractError>>()?;
    control.report(Stage::Segmentation, 0.4)?;
    for seen in all {
        let more = |best: &(ReebGraph, Branching, EdgeGraph, u32)| seen.1.ends() > best.1.ends();
        if best.as_ref().is_none_or(more) {
            best = Some(seen);
        }
    }
    let (graph, branching, mut edges, source) = best.unwrap_or((graph, first, edges, source));
    if picks.include.is_empty() && picks.exclude.is_empty() {
        return Ok((graph, branching));
    }
    let Kept { leaves, raised } = keep(surface, &graph, &branching, &picks.include);
    let choice = Choice { kept: &leaves, excluded: &picks.exclude, ..choice };
    edges.raise_vertices(&raised);
    let distance = geodesic(&edges, &[source], cancel)?;
    let graph = reeb_graph(&mesh.vertices, corners, distance, cancel)?;
    let branching = chains(surface, &graph, &choice, cancel)?;
    Ok((graph, Branching { raised, ..branching }))
}
