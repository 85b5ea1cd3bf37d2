//! Tips of the branches (section IV.A; ref. 30: critical points of a geodesic distance).
//!
//! Every leaf of the Reeb graph of a geodesic distance is a candidate. A tip counts by its height
//! over the base of its branch (`tip_height`), measured against the radius of that base or of the
//! vessel that it stands on, whichever is smaller: a blunt bump, a stair of a voxel surface or noise
//! is no branch, a sac is one. Handles are never touched: loops stay.

mod counter_fronts;
pub mod critical_points;
mod front_lengths;
pub mod geodesic;
mod height;
mod missed;
pub mod picks;
pub mod reeb;
pub mod root;
pub mod skeleton;
mod straight_roots;
mod stumps;
mod tip_view;
pub mod xie_beni;

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use nalgebra::Point3;

use crate::mesh::preparation::Surface;

use crate::centerline::tips::missed::Missed;
use crate::centerline::tips::picks::Pick;
use crate::centerline::tips::reeb::ReebGraph;
use crate::centerline::{CancelToken, ExtractError, Warning};

const NONE: u32 = u32::MAX;
/// The Reeb node that distances are taken from: the first that a sweep meets.
const ROOT: u32 = 0;

/// A branch of the segmented surface: a chain of Reeb arcs without a junction on the way.
#[derive(Debug, Clone, PartialEq)]
pub struct Chain {
    /// Reeb node that it starts at; an end or a junction.
    pub from: u32,
    /// Reeb node that it ends at.
    pub to: u32,
    /// Arcs in order, with `true` where they are passed upward.
    pub arcs: Vec<(u32, bool)>,
}

/// What is left of the Reeb graph when the leaves that are no tips were removed.
#[derive(Debug, Clone, Default)]
pub struct Branching {
    pub chains: Vec<Chain>,
    /// Leaves that were removed although they rise a part of their base's radius: a front that passed them aslant may
    /// have hidden an end.
    pub doubtful: Vec<ShortTip>,
    /// Leaves that stay and rise only a few radii: of a wide branch a front that came aslant may have left no more than
    /// a corner.
    pub low: Vec<ShortTip>,
    /// Leaves that went and may be short branches all the same.
    missed: Vec<Missed>,
    /// Reeb arcs of the ends that were excluded.
    pub excluded: Vec<u32>,
    /// Numbers of the excluded points that no end is near to.
    pub idle: Vec<usize>,
    /// Vertices of the ends that a peak was raised for.
    pub raised: Vec<u32>,
}

/// Which leaves are tips.
#[derive(Debug, Clone, Copy)]
pub struct Choice<'a> {
    /// Least height, in radii of the base.
    pub tip_height: f64,
    /// Vertices of leaves that stay whatever their height.
    pub kept: &'a [u32],
    pub excluded: &'a [Pick],
    /// Whether the root stays an end on a surface without other ends.
    pub keeps_root: bool,
}

impl Choice<'_> {
    /// By height alone.
    pub fn by_height(tip_height: f64) -> Self {
        Self { tip_height, kept: &[], excluded: &[], keeps_root: false }
    }
}

impl Branching {
    /// A warning where an excluded point is near no end.
    pub fn warning(&self) -> Option<Warning> {
        let numbers: Vec<String> = self.idle.iter().map(usize::to_string).collect();
        (!numbers.is_empty()).then(|| Warning {
            code: "nothing-excluded",
            detail: format!(
                "no end that could go lies within 3 of its radii of point {} of exclude",
                numbers.join(", ")
            ),
        })
    }

    /// How many ends the chains have.
    pub fn ends(&self) -> usize {
        self.end_nodes().len()
    }

    /// The Reeb nodes that are ends, by number.
    fn end_nodes(&self) -> Vec<u32> {
        let mut nodes: Vec<u32> = self.nodes().collect();
        nodes.sort_unstable();
        nodes.chunk_by(|a, b| a == b).filter(|same| same.len() == 1).map(|same| same[0]).collect()
    }

    /// Whether a Reeb node is an end.
    fn ends_at(&self, node: u32) -> bool {
        self.nodes().filter(|&other| other == node).count() == 1
    }

    /// The Reeb nodes of the chains, each as often as a chain begins or ends there.
    fn nodes(&self) -> impl Iterator<Item = u32> + '_ {
        self.chains.iter().flat_map(|chain| [chain.from, chain.to])
    }
}

/// Where a leaf of the Reeb graph stands. Lengths in the input's unit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Leaf {
    /// Vertex of its tip.
    pub vertex: u32,
    /// Centre and radius of the level set at its base.
    pub base: Point3<f64>,
    pub radius: f64,
    /// Radius of the vessel that passes its base; `None` where nothing shows it or too few edges the base.
    pub beside: Option<f64>,
}

/// A leaf that rises no more than a few radii.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ShortTip {
    pub leaf: Leaf,
    /// Its rise over its base, that of a flat cap's middle left out.
    pub height: f64,
    /// Distance between samples at its base and at its tip, whichever is longer.
    pub sample: f64,
}

/// Which Reeb arcs remain after the leaves that are no tips were removed.
struct Pruning<'a> {
    surface: &'a Surface,
    graph: &'a ReebGraph,
    alive: Vec<bool>,
    doubtful: Vec<ShortTip>,
    missed: Vec<Missed>,
    /// Arcs at each node, dead ones included.
    at_node: Vec<Vec<u32>>,
}

/// Removes the leaves lower than `tip_height` times their base radius, lowest first, and what is excluded; what
/// remains are chains between ends and junctions. O(leaves log leaves + level sets measured).
///
/// # Errors
/// [`ExtractError::Cancelled`].
pub fn chains(
    surface: &Surface,
    graph: &ReebGraph,
    choice: &Choice<'_>,
    cancel: &CancelToken,
) -> Result<Branching, ExtractError> {
    let mut at_node = vec![Vec::new(); graph.nodes.len()];
    for (index, arc) in graph.arcs.iter().enumerate() {
        at_node[arc.lower as usize].push(index as u32);
        at_node[arc.upper as usize].push(index as u32);
    }
    let alive = vec![true; graph.arcs.len()];
    let mut pruning = Pruning { surface, graph, alive, doubtful: Vec::new(), missed: Vec::new(), at_node };
    pruning.prune_leaves(choice, cancel)?;
    if !choice.keeps_root && !choice.kept.contains(&graph.nodes[0].vertex) {
        pruning.prune_root(choice.tip_height);
    }
    let (excluded, idle) = pruning.exclude(choice.excluded);
    let (chains, low) = (pruning.chains(), pruning.low());
    let Pruning { doubtful, missed, .. } = pruning;
    Ok(Branching { chains, low, doubtful, missed, excluded, idle, raised: Vec::new() })
}

impl Pruning<'_> {
    fn alive_at(&self, node: u32) -> impl Iterator<Item = u32> + '_ {
        self.at_node[node as usize].iter().copied().filter(|&arc| self.alive[arc as usize])
    }

    fn degree(&self, node: u32) -> usize {
        self.alive_at(node).count()
    }

    /// The arcs from leaf node `leaf` down to the next node that is not a mere passage.
    fn leaf_chain(&self, leaf: u32) -> Option<(Vec<u32>, u32)> {
        let mut arcs = Vec::new();
        let mut node = leaf;
        let mut arc = self.alive_at(leaf).next()?;
        loop {
            arcs.push(arc);
            node = if self.graph.arcs[arc as usize].upper == node {
                self.graph.arcs[arc as usize].lower
            } else {
                self.graph.arcs[arc as usize].upper
            };
            if self.degree(node) != 2 {
                return Some((arcs, node));
            }
            arc = self.alive_at(node).find(|&other| other != arc)?;
        }
    }

    fn prune_leaves(&mut self, choice: &Choice<'_>, cancel: &CancelToken) -> Result<(), ExtractError> {
        let mut queue = BinaryHeap::new();
        for (index, arc) in self.graph.arcs.iter().enumerate() {
            let is_leaf = self.at_node[arc.upper as usize].len() == 1;
            if is_leaf && self.at_node[arc.lower as usize].len() > 1 {
                let height = self.span(index as u32);
                queue.push(Reverse((height.to_bits(), index as u32)));
            }
        }
        let mut steps = 0usize;
        while let Some(Reverse((bits, index))) = queue.pop() {
            steps += 1;
            if steps.is_multiple_of(256) {
                cancel.check()?;
            }
            let leaf = self.graph.arcs[index as usize].upper;
            let Some((arcs, base)) = self.leaf_chain(leaf) else { continue };
            if self.degree(base) < 3 {
                continue;
            }
            let height = self.rise(&arcs);
            if height > f64::from_bits(bits) {
                // Its base moved down when a neighbour went: it is judged in its new turn.
                queue.push(Reverse((height.to_bits(), index)));
                continue;
            }
            let kept = choice.kept.contains(&self.graph.nodes[leaf as usize].vertex);
            if !kept && !self.stands_out(&arcs, base, leaf, height, choice.tip_height) {
                let height = height - self.rise_of_cap(leaf);
                if let Some(tip) = self.doubtful_tip(&arcs, base, leaf, height) {
                    let missed = self.missed(&arcs, (base, leaf), &tip, choice);
                    self.missed.extend(missed);
                    self.doubtful.push(tip);
                }
                arcs.iter().for_each(|&arc| self.alive[arc as usize] = false);
            }
        }
        Ok(())
    }

    /// A leaf that is no tip, where it is high enough to be looked at once more.
    fn doubtful_tip(&self, arcs: &[u32], base: u32, leaf: u32, height: f64) -> Option<ShortTip> {
        /// Least height, in radii of the base.
        const DOUBT: f64 = 0.2;
        let (_, radius) = self.base_of(arcs)?;
        if height > DOUBT * radius { self.short_tip(arcs, base, leaf, (height, false)) } else { None }
    }

    /// The leaves that stay although they are low.
    fn low(&self) -> Vec<ShortTip> {
        /// Greatest height, in radii of the base.
        const LOW: f64 = 3.0;
        let nodes = 0..self.graph.nodes.len() as u32;
        let leaves = nodes.filter(|&node| node != ROOT && self.degree(node) == 1);
        let low = leaves.filter_map(|leaf| {
            let (arcs, base) = self.leaf_chain(leaf)?;
            let height = self.rise(&arcs) - self.rise_of_opening(leaf);
            let (_, radius) = self.base_of(&arcs)?;
            let is_low = self.degree(base) > 2 && height < LOW * radius;
            if is_low { self.short_tip(&arcs, base, leaf, (height, true)) } else { None }
        });
        low.collect()
    }

    /// On a surface without ends the root is no tip either: its leaf goes by the same measure.
    fn prune_root(&mut self, tip_height: f64) {
        if self.degree(ROOT) != 1 {
            return;
        }
        let Some((arcs, base)) = self.leaf_chain(ROOT) else { return };
        if self.degree(base) < 3 {
            return;
        }
        if self.opening_at(ROOT).is_some_and(|opening| !opening.was_closed) {
            return;
        }
        let Some(top) = arcs.last().and_then(|&arc| self.rings(arc).last()) else { return };
        let rings = arcs.iter().flat_map(|&arc| self.rings(arc));
        let mut centres = std::iter::once(self.position(ROOT)).chain(rings.map(|ring| ring.centroid));
        let least = tip_height * top.radius();
        let low = centres.all(|centre| (centre - top.centroid).norm() < least);
        drop(centres);
        if low {
            arcs.iter().for_each(|&arc| self.alive[arc as usize] = false);
        }
    }

    /// What is alive, as chains between nodes of a degree other than two; a bare ring starts anywhere.
    fn chains(&self) -> Vec<Chain> {
        let mut used = vec![false; self.graph.arcs.len()];
        let mut chains = Vec::new();
        let degrees: Vec<usize> = (0..self.graph.nodes.len() as u32).map(|n| self.degree(n)).collect();
        for only_rings in [false, true] {
            for node in 0..self.graph.nodes.len() as u32 {
                let wanted = if only_rings {
                    degrees[node as usize] == 2
                } else {
                    !matches!(degrees[node as usize], 0 | 2)
                };
                if !wanted {
                    continue;
                }
                for arc in self.at_node[node as usize].clone() {
                    if self.alive[arc as usize] && !used[arc as usize] {
                        chains.push(self.follow(node, arc, &degrees, &mut used));
                    }
                }
            }
        }
        chains
    }

    fn follow(&self, from: u32, first: u32, degrees: &[usize], used: &mut [bool]) -> Chain {
        let mut arcs = Vec::new();
        let mut node = from;
        let mut arc = first;
        loop {
            used[arc as usize] = true;
            let data = &self.graph.arcs[arc as usize];
            let upward = data.lower == node;
            arcs.push((arc, upward));
            node = if upward { data.upper } else { data.lower };
            let onward = self.alive_at(node).find(|&other| !used[other as usize]);
            match onward {
                Some(next) if degrees[node as usize] == 2 && node != from => arc = next,
                _ => return Chain { from, to: node, arcs },
            }
        }
    }
}

/// The vertex farthest from the source; taken twice, an end of the surface.
pub fn farthest(distance: &[f64]) -> u32 {
    let mut best = NONE;
    let mut reach = f64::NEG_INFINITY;
    for (v, &d) in distance.iter().enumerate() {
        if d.is_finite() && d > reach {
            (best, reach) = (v as u32, d);
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::centerline::shapes::{open_tube, sphere, torus};
    use crate::centerline::tips::geodesic::{EdgeGraph, geodesic};
    use crate::centerline::tips::reeb::reeb_graph;
    use crate::mesh::TriangleMesh;
    use crate::mesh::preparation::prepare;

    /// Chains, Reeb loops of the first component.
    fn segmented(mesh: &TriangleMesh) -> (Vec<Chain>, i64) {
        let prepared = prepare(mesh).unwrap();
        let surface = &prepared.components[0];
        let cancel = CancelToken::new();
        let edges = EdgeGraph::new(&surface.mesh.vertices, &surface.corners);
        let root = farthest(&geodesic(&edges, &[0], &cancel).unwrap().distance);
        let graph = reeb_graph(surface, &edges, &[root], &cancel).unwrap();
        let loops = graph.arcs.len() as i64 - graph.nodes.len() as i64 + 1;
        assert_eq!(loops, surface.genus() as i64);
        (chains(surface, &graph, &Choice::by_height(1.0), &cancel).unwrap().chains, loops)
    }

    #[test]
    fn a_tube_is_one_chain_between_two_ends() {
        let (chains, loops) = segmented(&open_tube(20.0, 60, 24));
        assert_eq!((chains.len(), loops), (1, 0));
        assert_ne!(chains[0].from, chains[0].to);
    }

    #[test]
    fn a_torus_is_one_ring() {
        let (chains, loops) = segmented(&torus(10.0, 1.5, 120, 24));
        assert_eq!((chains.len(), loops), (1, 1));
        assert_eq!(chains[0].from, chains[0].to);
    }

    #[test]
    fn a_sphere_is_one_chain() {
        assert_eq!(segmented(&sphere(40, 60)).0.len(), 1);
    }
}
