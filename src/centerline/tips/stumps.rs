//! Short wide branches that a front from elsewhere hides.
//!
//! The front from the root comes to a branch as wide as its vessel aslant: it climbs the near side while it goes round
//! the far one, and where both meet, a corner is all that is left of the branch. Seen from its own tip the branch is a
//! tube up to its base, whichever way the root's front comes.

use std::ops::Range;

use nalgebra::Vector3;
use rustc_hash::{FxHashMap, FxHashSet};

use crate::mesh::preparation::Surface;

use super::front_lengths::{FrontLengths, Tube};
use super::geodesic::{EdgeGraph, Near, geodesic_near};
use super::reeb::ReebGraph;
use super::root::{End, cap_of, free_direction, short_end, toward};
use super::{Branching, ShortTip};
use crate::centerline::{CancelToken, ExtractError};

/// Radii that such a branch may have, in those of the vessel beside it: a thinner one no front hides, a wider one is a
/// sac.
const WIDTHS: Range<f64> = 0.4..1.3;
/// Fewest edges that a leaf's base crosses: fewer are a stair or noise.
pub const EDGES: u32 = 12;
/// How far below a tip the tube begins, in radii: what [`cap_of`] takes.
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
/// it left out, and those of which it shows only a part. O(wall within some radii of each leaf that is looked at, a dozen
/// times).
///
/// # Errors
/// [`ExtractError::Cancelled`].
pub fn stumps(
    surface: &Surface,
    edges: &EdgeGraph,
    (graph, branching): (&ReebGraph, &Branching),
    tip_height: f64,
    cancel: &CancelToken,
) -> Result<Vec<Stump>, ExtractError> {
    let ends = ends(surface, graph, branching);
    let kept = branching.low.iter().map(|tip| (tip, true));
    let mut found: Vec<Stump> = Vec::new();
    // Two leaves of one branch are one.
    let mut taken: FxHashSet<u32> = FxHashSet::default();
    for (tip, stays) in kept.chain(branching.doubtful.iter().map(|tip| (tip, false))) {
        cancel.check()?;
        let leaf = graph.nodes[tip.leaf as usize].vertex;
        if taken.contains(&leaf) {
            continue;
        }
        let Some(view) = best_tip_view(surface, edges, leaf, tip, cancel)? else { continue };
        if !view.has_end_but(leaf, &ends)
            && view.is_one_ring(edges)
            && view.is_hidden(tip, stays, tip_height)
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

/// What a front from a tip shows.
struct TipView {
    stump: Stump,
    near: Near,
}

/// What the front shows that shows the longest tube, for it is square to it. The root's front leaves the far corner of
/// an end for the last, so each tube that is found says where the end rather is.
fn best_tip_view(
    surface: &Surface,
    edges: &EdgeGraph,
    leaf: u32,
    tip: &ShortTip,
    cancel: &CancelToken,
) -> Result<Option<TipView>, ExtractError> {
    /// How often at most the end is put straight.
    const STRAIGHTENED: usize = 4;
    let Some(beside) = tip.beside.filter(|beside| tip.radius >= 0.5 * WIDTHS.start * beside) else {
        return Ok(None);
    };
    let view = |(vertex, radius, outward)| {
        let end = End { vertex, radius, outward, short: true };
        TipView::from(surface, edges, &end, (leaf, beside), cancel)
    };
    let first = first_directions(surface, leaf, tip).into_iter();
    let Some(mut best) = longest(first.map(|outward| view((leaf, tip.radius, outward))))? else {
        return Ok(None);
    };
    for _ in 0..STRAIGHTENED {
        let directions = best.directions(surface).into_iter();
        let end = |outward| Some((best.highest(surface, &outward)?, best.stump.radius, outward));
        let next = longest(directions.filter_map(end).map(view))?;
        match next.filter(|next| next.stump.base > best.stump.base) {
            Some(next) => best = next,
            None => break,
        }
    }
    Ok(Some(best))
}

/// Where a leaf may point, told by it alone: away from its base, along the vessel around it, along its normal, and
/// between the first and the last.
fn first_directions(surface: &Surface, leaf: u32, tip: &ShortTip) -> Vec<Vector3<f64>> {
    /// Cosine of the angle within which one is enough.
    const ALIKE: f64 = 0.98;
    let away = (surface.mesh.vertices[leaf as usize] - tip.base).try_normalize(0.0);
    let normal: Vector3<f64> = surface.corners.star(leaf).map(|h| surface.mesh.area_vector(h / 3)).sum();
    let normal = normal.try_normalize(0.0);
    let between = away.zip(normal).and_then(|(away, normal)| (away + normal).try_normalize(0.0));
    let along = short_end(surface, leaf, tip).map(|end| end.outward);
    let mut directions: Vec<Vector3<f64>> = Vec::new();
    for direction in [away, along, normal, between].into_iter().flatten() {
        if directions.iter().all(|other| other.dot(&direction) < ALIKE) {
            directions.push(direction);
        }
    }
    directions
}

fn longest(
    views: impl Iterator<Item = Result<Option<TipView>, ExtractError>>,
) -> Result<Option<TipView>, ExtractError> {
    let views = views.filter_map(Result::transpose).collect::<Result<Vec<_>, ExtractError>>()?;
    Ok(views.into_iter().max_by(|a, b| a.stump.base.total_cmp(&b.stump.base)))
}

impl TipView {
    /// `None` where the front shows no tube, or one that is no stump's beside a vessel of such a radius.
    fn from(
        surface: &Surface,
        edges: &EdgeGraph,
        end: &End,
        (leaf, beside): (u32, f64),
        cancel: &CancelToken,
    ) -> Result<Option<Self>, ExtractError> {
        /// How far it is looked at, in radii of the vessel.
        const FAR: f64 = 8.0;
        let cap = cap_of(surface, end);
        let near = geodesic_near(edges, (end.vertex, &cap), |_, d| d < FAR * beside, cancel)?;
        let tube = FrontLengths::of(surface, &near, beside).and_then(|lengths| lengths.tube(beside));
        let Some(Tube { base, mouth, radius }) = tube else { return Ok(None) };
        let stump = Stump { vertex: end.vertex, cap, base, radius, leaf };
        Ok(WIDTHS.contains(&(mouth / beside)).then_some(Self { stump, near }))
    }

    /// Vertices whose distance from the cap lies in a range, in the order of that.
    fn between(&self, range: Range<f64>) -> impl Iterator<Item = u32> + '_ {
        self.near.reached().filter(move |(_, d)| range.contains(d)).map(|(v, _)| v)
    }

    /// Where the tube may point: from its middle to its cap, and along the direction that its normals leave free.
    fn directions(&self, surface: &Surface) -> Vec<Vector3<f64>> {
        /// Most of the normals that may lie along it, against across it.
        const FREE: f64 = 0.5;
        let Stump { cap, base, radius, .. } = &self.stump;
        let mean = |of: &mut dyn Iterator<Item = u32>| {
            let sum = |(count, sum): (usize, Vector3<f64>), v: u32| {
                (count + 1, sum + surface.mesh.vertices[v as usize].coords)
            };
            let (count, sum) = of.fold((0, Vector3::zeros()), sum);
            (count > 0).then(|| sum / count as f64)
        };
        let top = mean(&mut self.between(0.0..f64::INFINITY).filter(|v| cap.contains(v)));
        let middle = mean(&mut self.between(0.3 * base..0.8 * base));
        let Some(away) = top.zip(middle).and_then(|(top, middle)| (top - middle).try_normalize(0.0)) else {
            return Vec::new();
        };
        let far = base.max(*radius);
        let wall = self.between(0.05 * far..far).flat_map(|v| surface.corners.star(v)).map(|h| h / 3);
        let axis = free_direction(surface, wall, FREE).map(|axis| toward(axis, &away));
        std::iter::once(away).chain(axis).collect()
    }

    /// The vertex of the stump that lies farthest in a direction.
    fn highest(&self, surface: &Surface, outward: &Vector3<f64>) -> Option<u32> {
        let high = |v: &u32| surface.mesh.vertices[*v as usize].coords.dot(outward);
        self.between(0.0..self.stump.base).max_by(|a, b| high(a).total_cmp(&high(b)))
    }

    /// Whether one of the `ends` but its `own` lies on it or near its base: then the tube is that end's vessel, and the
    /// tip a second leaf of it.
    fn has_end_but(&self, own: u32, ends: &[(u32, Vec<u32>)]) -> bool {
        /// How far from the base another end lies at least, in radii.
        const APART: f64 = 2.5;
        let far = self.stump.base + APART * self.stump.radius;
        let is_near = |v: &u32| self.near.distance(*v).is_some_and(|d| d < far);
        ends.iter().any(|(end, places)| *end != own && places.iter().any(is_near))
    }

    /// Whether the wall above its base hangs together: a front on a vessel's side goes round it and comes apart.
    fn is_one_ring(&self, edges: &EdgeGraph) -> bool {
        /// Width of the ring, in radii, and the least share of its vertices that hang together: noise leaves some aside.
        const RING: (f64, f64) = (0.8, 0.9);
        let Stump { base, radius, .. } = self.stump;
        let ring: FxHashSet<u32> = self.between((base - RING.0 * radius).max(0.0)..base).collect();
        let Some(first) = self.between(0.0..base).find(|v| ring.contains(v)) else { return false };
        let mut seen = FxHashSet::from_iter([first]);
        let mut queue = vec![first];
        while let Some(v) = queue.pop() {
            let around = edges.neighbours(v).iter().map(|&(u, _)| u);
            queue.extend(around.filter(|&u| ring.contains(&u) && seen.insert(u)));
        }
        seen.len() as f64 > RING.1 * ring.len() as f64
    }

    /// Whether it is high enough to be a branch, and the root's front shows less of it: nothing, or a part where it
    /// `stays`.
    fn is_hidden(&self, tip: &ShortTip, stays: bool, tip_height: f64) -> bool {
        /// Most that a part rises, and least that it falls short of the whole, in radii: more is no corner.
        const PART: (f64, f64) = (3.0, 0.25);
        /// Least of that height that it lies outside the vessel: the pocket of a wall in front of a throat lies within.
        const OVER: f64 = 0.7;
        let Stump { base, radius, .. } = self.stump;
        let height = base + CAP * radius;
        let least = tip_height * tip.beside.map_or(radius, |beside| radius.min(beside));
        let is_outside = tip.over.is_none_or(|over| over >= OVER * least);
        height >= least
            && is_outside
            && (!stays || tip.height < (PART.0 * radius).min(height - PART.1 * radius))
    }
}
