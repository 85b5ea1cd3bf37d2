//! The end of the surface that geodesic distances are best taken from: the widest one, all of its cap.
//!
//! A front that starts at one vertex of a wide end's rim, or enters a wide vessel from a thin side
//! branch, runs aslant there and hides short trunks; one that starts from a whole cap does not.

use nalgebra::{Matrix3, Vector3};
use rustc_hash::FxHashSet;

use crate::mesh::preparation::Surface;

use crate::centerline::segmentation::level_sets::{LevelSet, level_set};
use crate::centerline::tips::reeb::ReebGraph;
use crate::centerline::tips::{Branching, Chain, Leaf};

/// Where to take distances from.
#[derive(Debug, Clone, PartialEq)]
pub struct Root {
    pub vertex: u32,
    /// Marks the vertices of the cap around it.
    pub cap: Vec<bool>,
    /// What it was taken for, where that is not known for sure.
    pub end: Option<Cap>,
}

/// Which ends may be the root.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Among {
    /// Short and removed ones too: what a front has passed aslant. Where that was no end but the place where two
    /// fronts met, its cap takes in the wall for many radii and distances on it vanish.
    AllEnds,
    /// Only those longer than they are wide, as long as there is one: for who reads the distances themselves.
    LongEnds,
}

/// Where a vessel ends, seen from the tip inward.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cap {
    pub vertex: u32,
    /// Radius of the vessel, in the input's unit.
    pub radius: f64,
    /// Unit direction out of the lumen.
    pub outward: Vector3<f64>,
}

/// An end of a chain.
#[derive(Debug, Clone, Copy, PartialEq)]
struct End {
    cap: Cap,
    /// Shorter than it is wide: a sac, a stump, or an end that a front has passed aslant.
    short: bool,
    /// Whether it is short, or the level sets behind it widen as they do into a joint: then they may tell too much.
    near_joint: bool,
}

/// The ends that distances may be taken from, the best first: wide and long ones before short ones, of
/// those only what is nearly as wide as the widest of all. None when no chain has an end.
pub fn roots(surface: &Surface, graph: &ReebGraph, branching: &Branching, among: Among) -> Vec<Root> {
    /// Least radius against the widest.
    const WIDE: f64 = 0.6;
    /// A long end is better than a short one up to so many times as wide: that may be a sac.
    const LONG: f64 = 2.0;
    /// Least rise of a leaf that was removed, in radii of its base: from less no cap is told.
    const HIGH: f64 = 0.4;
    /// Each costs a geodesic and a Reeb graph.
    const MOST: usize = 3;
    let mut ends = chain_ends(surface, graph, &branching.chains);
    let high = branching.doubtful.iter().filter(|tip| tip.height > HIGH * tip.leaf.radius);
    let caps = high.filter_map(|tip| cap_at(surface, &tip.leaf));
    ends.extend(caps.map(|cap| End { cap, short: true, near_joint: true }));
    if among == Among::LongEnds && ends.iter().any(|end| !end.short) {
        ends.retain(|end| !end.short);
    }
    let widest = ends.iter().map(|end| end.cap.radius).fold(0.0, f64::max);
    let worth = |end: &End| if end.short { end.cap.radius } else { LONG * end.cap.radius };
    ends.sort_by(|a, b| worth(b).total_cmp(&worth(a)));
    let first = ends.first().map(|end| end.cap.vertex);
    let candidates =
        ends.iter().filter(|end| Some(end.cap.vertex) == first || end.cap.radius >= WIDE * widest);
    // Past a wide and long end only short ones that are wider still may have hidden something.
    let sure = ends.first().is_some_and(|end| !end.short && end.cap.radius >= 0.95 * widest);
    let most = if sure { 1 } else { MOST };
    candidates.take(most).map(|end| Root::at(surface, end)).collect()
}

/// Vertex and radius of the ends of chains.
pub fn ends_of(surface: &Surface, graph: &ReebGraph, chains: &[Chain]) -> Vec<(u32, f64)> {
    chain_ends(surface, graph, chains).iter().map(|end| (end.cap.vertex, end.cap.radius)).collect()
}

impl Root {
    /// A root that is known for sure, with the vertices of its cap.
    pub fn of(surface: &Surface, vertex: u32, cap: &FxHashSet<u32>) -> Self {
        let mut marks = vec![false; surface.mesh.vertices.len()];
        cap.iter().for_each(|&v| marks[v as usize] = true);
        Self { vertex, cap: marks, end: None }
    }

    /// The root at an end, which is to be looked at again where it may lie near a joint.
    fn at(surface: &Surface, end: &End) -> Self {
        let End { cap, near_joint, .. } = end;
        Self { end: near_joint.then_some(*cap), ..Self::of(surface, cap.vertex, &cap_of(surface, cap)) }
    }

    /// The end nearest to a vertex; `None` where there is none.
    pub fn nearest(surface: &Surface, graph: &ReebGraph, branching: &Branching, vertex: u32) -> Option<Self> {
        let away = |end: &End| {
            (surface.mesh.vertices[end.cap.vertex as usize] - surface.mesh.vertices[vertex as usize]).norm()
        };
        let ends = chain_ends(surface, graph, &branching.chains);
        let nearest = ends.iter().min_by(|a, b| away(a).total_cmp(&away(b)))?;
        Some(Self::at(surface, nearest))
    }
}

/// The ends of all chains.
fn chain_ends(surface: &Surface, graph: &ReebGraph, chains: &[Chain]) -> Vec<End> {
    let mut degree = vec![0usize; graph.nodes.len()];
    for chain in chains {
        degree[chain.from as usize] += 1;
        degree[chain.to as usize] += 1;
    }
    let both = chains.iter().flat_map(|chain| [(chain, chain.from, true), (chain, chain.to, false)]);
    let free = both.filter(|&(_, node, _)| degree[node as usize] == 1);
    free.filter_map(|(chain, _, at_start)| end_of(surface, graph, chain, at_start)).collect()
}

/// The cap at a leaf's vertex.
pub fn cap_at(surface: &Surface, leaf: &Leaf) -> Option<Cap> {
    let &Leaf { vertex, base, radius, .. } = leaf;
    let outward = (surface.mesh.vertices[vertex as usize] - base).try_normalize(0.0)?;
    Some(Cap { vertex, radius, outward: along_vessel(surface, vertex, radius, outward) })
}

/// `outward` turned along the vessel that the wall around the end is of: the direction that its normals leave free
/// (eq. 9). A front that came aslant ends at the far side of a cap, and `outward` leans that way. Where no direction
/// is the vessel's, it stays.
fn along_vessel(surface: &Surface, vertex: u32, radius: f64, outward: Vector3<f64>) -> Vector3<f64> {
    /// How far the wall is looked at, in radii.
    const NEAR: f64 = 2.0;
    /// Most of the normals that may lie along the vessel against across it: a cap's do.
    const FREE: f64 = 0.7;
    /// Cosine of the most that `outward` may be turned.
    const TURN: f64 = 0.35;
    let around = wall_around(surface, vertex, NEAR * radius).into_iter();
    let axis = free_direction(surface, around, FREE).map(|axis| toward(axis, &outward));
    axis.filter(|axis| axis.dot(&outward) > TURN).unwrap_or(outward)
}

/// The triangles that hang together with a vertex within a distance of it.
pub fn wall_around(surface: &Surface, vertex: u32, near: f64) -> Vec<u32> {
    let place = |v: u32| surface.mesh.vertices[v as usize];
    let is_near = |&v: &u32| (place(v) - place(vertex)).norm() < near;
    connected(surface, vertex, |t| surface.mesh.triangles[t as usize].iter().any(is_near))
}

/// The direction that the normals of triangles leave free (eq. 9); `None` where as much of them lies along it as the
/// share `free` of what lies across it.
pub fn free_direction(
    surface: &Surface,
    triangles: impl Iterator<Item = u32>,
    free: f64,
) -> Option<Vector3<f64>> {
    let eigen = normals_covariance(surface, triangles).symmetric_eigen();
    let least = eigen.eigenvalues.imin();
    let others = (0..3).filter(|&i| i != least).map(|i| eigen.eigenvalues[i]);
    let is_free = eigen.eigenvalues[least] < free * others.fold(f64::INFINITY, f64::min);
    is_free.then(|| eigen.eigenvectors.column(least).into())
}

/// Of the normals of triangles, weighed by their areas (eq. 9).
pub fn normals_covariance(surface: &Surface, triangles: impl Iterator<Item = u32>) -> Matrix3<f64> {
    let areas = triangles.map(|t| surface.mesh.area_vector(t));
    areas.map(|area| area * area.transpose() / area.norm().max(f64::MIN_POSITIVE)).sum()
}

/// The axis, turned around where it points away from a direction.
pub fn toward(axis: Vector3<f64>, direction: &Vector3<f64>) -> Vector3<f64> {
    if axis.dot(direction) < 0.0 { -axis } else { axis }
}

/// The triangles that hang together with a vertex as far as they belong.
pub fn connected(surface: &Surface, vertex: u32, belongs: impl Fn(u32) -> bool) -> Vec<u32> {
    let corners = &surface.corners;
    let mut seen = FxHashSet::default();
    let mut found: Vec<u32> = Vec::new();
    let mut queue: Vec<u32> = corners.star(vertex).map(|h| h / 3).collect();
    while let Some(t) = queue.pop() {
        if seen.insert(t) && belongs(t) {
            found.push(t);
            queue.extend([3 * t, 3 * t + 1, 3 * t + 2].map(|h| corners.opposite(h) / 3));
        }
    }
    found
}

/// Width and direction of a chain's end, from the rings a few radii inward of its tip.
fn end_of(surface: &Surface, graph: &ReebGraph, chain: &Chain, at_start: bool) -> Option<End> {
    // Where a cap has no more influence, and how far the direction is looked for, in radii.
    const NEAR: f64 = 1.5;
    const FAR: f64 = 3.0;
    // A ring so near shows the vessel where one past it is wider by so much: a joint begins there.
    const CLOSE: f64 = 0.9;
    const WIDENED: std::ops::Range<f64> = 1.2..2.0;
    let node = if at_start { chain.from } else { chain.to };
    let vertex = graph.nodes[node as usize].vertex;
    let tip = surface.mesh.vertices[vertex as usize];
    let away = |ring: &LevelSet| (ring.centroid - tip).norm() / ring.radius();
    let rings = rings_inward(surface, graph, chain, at_start, |ring| away(ring) > FAR);
    let near = rings.iter().find(|ring| away(ring) > NEAR);
    let (short, ring) = (near.is_none(), near.or(rings.last())?);
    let base = rings.last().map_or(ring.centroid, |ring| ring.centroid);
    let inward = (ring.centroid - base).try_normalize(1e-6 * ring.radius());
    let first = rings.iter().find(|ring| away(ring) > CLOSE);
    let widening = |ring: &LevelSet| first.map_or(1.0, |first| ring.radius() / first.radius());
    let near_joint = short || rings.iter().any(|ring| widening(ring) > WIDENED.start);
    let narrow = first.filter(|_| !short && WIDENED.contains(&widening(ring)));
    let straight = |ring: &LevelSet| (tip - ring.centroid).try_normalize(0.0);
    // On a cap that a front came to aslant all rings but the last are small ones around its far side.
    let widest = || rings.iter().map(LevelSet::radius).fold(0.0, f64::max);
    let (radius, outward) = match narrow {
        Some(first) => (first.radius(), straight(first)?),
        None => (if short { widest() } else { ring.radius() }, inward.or_else(|| straight(ring))?),
    };
    // Rings of a long one are square to the vessel where they are looked at.
    let is_square = !short && narrow.is_none();
    let outward = if is_square { outward } else { along_vessel(surface, vertex, radius, outward) };
    Some(End { cap: Cap { vertex, radius, outward }, short, near_joint })
}

/// Level sets from a chain's tip inward, up to and with the first that is `enough`.
fn rings_inward(
    surface: &Surface,
    graph: &ReebGraph,
    chain: &Chain,
    at_start: bool,
    enough: impl Fn(&LevelSet) -> bool,
) -> Vec<LevelSet> {
    /// Distance between the rings, in their radii, and in shares of the chain's rise where they vanish.
    const STEP: (f64, f64) = (0.4, 0.005);
    let level = |node: u32| graph.nodes[node as usize].level;
    let span = |arc: u32| {
        let arc = &graph.arcs[arc as usize];
        (level(arc.lower), level(arc.upper))
    };
    let total: f64 = chain.arcs.iter().map(|&(arc, _)| span(arc).1 - span(arc).0).sum();
    let mut arcs = chain.arcs.clone();
    if !at_start {
        arcs.reverse();
        arcs.iter_mut().for_each(|(_, upward)| *upward = !*upward);
    }
    let mut rings = Vec::new();
    let mut due = STEP.1 * total;
    for (arc, upward) in arcs {
        let (low, high) = span(arc);
        while due < high - low {
            let at = if upward { low + due } else { high - due };
            let ring = level_set(&surface.mesh.vertices, &surface.corners, graph, arc as usize, at);
            due += (STEP.0 * ring.radius()).max(STEP.1 * total);
            rings.push(ring);
            if rings.last().is_some_and(&enough) {
                return rings;
            }
        }
        due -= high - low;
    }
    rings
}

/// The vertices of the end: what lies around its cap down to half a radius below the tip, and
/// triangles that face outward beside it, connected to its vertex.
///
/// A front that starts there leaves it as one ring square to the vessel, however rough the cap is.
pub fn cap_of(surface: &Surface, cap: &Cap) -> FxHashSet<u32> {
    /// Cosine of the widest angle between a cap's normal and the vessel's direction.
    const FACING: f64 = 0.7;
    /// Depth of the end, and how far from the tip it may reach, in radii.
    const DEPTH: f64 = 0.5;
    const NEAR: f64 = 2.5;
    let tip = surface.mesh.vertices[cap.vertex as usize];
    let belongs = |t: u32| {
        let [a, b, c] = surface.mesh.triangles[t as usize].map(|v| surface.mesh.vertices[v as usize]);
        let normal = (b - a).cross(&(c - a));
        let near = (a - tip).norm() < NEAR * cap.radius;
        let high = [a, b, c].iter().all(|p| (tip - p).dot(&cap.outward) < DEPTH * cap.radius);
        near && (high || normal.dot(&cap.outward) > FACING * normal.norm())
    };
    let triangles = connected(surface, cap.vertex, belongs).into_iter();
    let corners = triangles.flat_map(|t| surface.mesh.triangles[t as usize]);
    corners.chain([cap.vertex]).collect()
}
