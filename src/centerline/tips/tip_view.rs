//! What a front from a tip shows of the vessel that ends there.
//!
//! A front that starts from a whole cap runs square to its vessel as far as that is a tube, whichever way a front from
//! elsewhere comes.

use std::ops::Range;

use nalgebra::Vector3;
use rustc_hash::FxHashSet;

use crate::mesh::preparation::{Opening, Surface};

use super::Leaf;
use super::front_lengths::{FrontLengths, Tube};
use super::geodesic::{EdgeGraph, Near, geodesic_near};
use super::root::{Cap, cap_at, cap_of, free_direction, normals_covariance, toward, wall_around};
use super::stumps::Stump;
use crate::centerline::{CancelToken, ExtractError};

/// Radii that a tube may have, in those of the vessel beside it: a thinner one no front hides, a wider one is a sac.
const WIDTHS: Range<f64> = 0.4..1.3;

/// What a front from a tip shows.
pub struct TipView {
    pub stump: Stump,
    /// Distances from its cap.
    pub near: Near,
}

/// What the front shows that shows the most slender tube, for it is square to it. The root's front leaves the far corner of
/// an end for the last, so each tube that is found says where the end rather is.
pub fn best_tip_view(
    surface: &Surface,
    edges: &EdgeGraph,
    leaf: &Leaf,
    cancel: &CancelToken,
) -> Result<Option<TipView>, ExtractError> {
    /// How often at most the end is put straight.
    const STRAIGHTENED: usize = 4;
    let Some(beside) = leaf.beside.filter(|beside| leaf.radius >= 0.5 * WIDTHS.start * beside) else {
        return Ok(None);
    };
    let view = |(vertex, radius, outward)| {
        let cap = Cap { vertex, radius, outward };
        TipView::from(surface, edges, &cap, (leaf.vertex, beside), cancel)
    };
    let first = first_directions(surface, leaf).into_iter();
    let Some(mut best) = most_slender(first.map(|outward| view((leaf.vertex, leaf.radius, outward))))? else {
        return Ok(None);
    };
    for _ in 0..STRAIGHTENED {
        let directions = best.directions(surface).into_iter();
        let end = |outward| Some((best.highest(surface, &outward)?, best.stump.radius, outward));
        let next = most_slender(directions.filter_map(end).map(view))?;
        match next.filter(|next| next.slenderness() > best.slenderness()) {
            Some(next) => best = next,
            None => break,
        }
    }
    Ok(Some(best))
}

/// Where a leaf may point, told by it alone: away from its base, along the vessel around it, along its normal, between
/// the first and the last, and along the axes of the normals around it: at the edge of a flat cap one of them is the cap's.
fn first_directions(surface: &Surface, leaf: &Leaf) -> Vec<Vector3<f64>> {
    /// Cosine of the angle within which one is enough.
    const ALIKE: f64 = 0.98;
    let away = (surface.mesh.vertices[leaf.vertex as usize] - leaf.base).try_normalize(0.0);
    let normal: Vector3<f64> =
        surface.corners.star(leaf.vertex).map(|h| surface.mesh.area_vector(h / 3)).sum();
    let normal = normal.try_normalize(0.0);
    let between = away.zip(normal).and_then(|(away, normal)| (away + normal).try_normalize(0.0));
    let along = cap_at(surface, leaf).map(|cap| cap.outward);
    let mut directions: Vec<Vector3<f64>> = Vec::new();
    let told = [away, along, normal, between].into_iter().flatten();
    for direction in told.chain(normals_axes(surface, leaf)) {
        if directions.iter().all(|other| other.dot(&direction) < ALIKE) {
            directions.push(direction);
        }
    }
    directions
}

/// The principal axes of the normals around a leaf, turned to where most of these point.
fn normals_axes(surface: &Surface, leaf: &Leaf) -> [Vector3<f64>; 3] {
    /// How far the wall is looked at, in radii.
    const NEAR: f64 = 1.5;
    let around = wall_around(surface, leaf.vertex, NEAR * leaf.radius);
    let mean: Vector3<f64> = around.iter().map(|&t| surface.mesh.area_vector(t)).sum();
    let axes = normals_covariance(surface, around.into_iter()).symmetric_eigen().eigenvectors;
    [0, 1, 2].map(|i| toward(axes.column(i).into(), &mean))
}

fn most_slender(
    views: impl Iterator<Item = Result<Option<TipView>, ExtractError>>,
) -> Result<Option<TipView>, ExtractError> {
    let views = views.filter_map(Result::transpose).collect::<Result<Vec<_>, ExtractError>>()?;
    Ok(views.into_iter().max_by(|a, b| a.slenderness().total_cmp(&b.slenderness())))
}

impl TipView {
    /// What a front from an opening shows: where its branch was cut and which way it points is known. `None` as for
    /// [`from`](Self::from).
    pub fn of_opening(
        surface: &Surface,
        edges: &EdgeGraph,
        opening: &Opening,
        cancel: &CancelToken,
    ) -> Result<Option<Self>, ExtractError> {
        let (vertex, radius) = (opening.centre, opening.area_radius(&surface.mesh));
        let Some(outward) = opening.area_vector(&surface.mesh).try_normalize(0.0) else { return Ok(None) };
        Self::from(surface, edges, &Cap { vertex, radius, outward }, (vertex, radius), cancel)
    }

    /// `None` where the front shows no tube, or one that is no stump's beside a vessel of such a radius.
    pub fn from(
        surface: &Surface,
        edges: &EdgeGraph,
        end: &Cap,
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
        let is_like_it = WIDTHS.contains(&(mouth / beside)) && radius >= WIDTHS.start * beside;
        Ok(is_like_it.then_some(Self { stump, near }))
    }

    /// How many radii long its tube is.
    pub fn slenderness(&self) -> f64 {
        self.stump.base / self.stump.radius
    }

    /// Vertices whose distance from the cap lies in a range, in the order of that.
    pub fn between(&self, range: Range<f64>) -> impl Iterator<Item = u32> + '_ {
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

    /// Whether the wall above its base hangs together: a front on a vessel's side goes round it and comes apart.
    pub fn is_one_ring(&self, edges: &EdgeGraph) -> bool {
        /// Width of the ring, in radii, and the least share of its vertices that hang together: noise leaves some aside.
        const RING: (f64, f64) = (0.8, 0.9);
        /// Fewer vertices are an edge of a stair or of a cut, and no wall.
        const FEWEST: usize = 20;
        let Stump { base, radius, .. } = self.stump;
        let ring: FxHashSet<u32> = self.between((base - RING.0 * radius).max(0.0)..base).collect();
        let first = self.between(0.0..base).find(|v| ring.contains(v));
        let Some(first) = first.filter(|_| ring.len() >= FEWEST) else { return false };
        let mut seen = FxHashSet::from_iter([first]);
        let mut queue = vec![first];
        while let Some(v) = queue.pop() {
            let around = edges.neighbours(v).iter().map(|&(u, _)| u);
            queue.extend(around.filter(|&u| ring.contains(&u) && seen.insert(u)));
        }
        seen.len() as f64 > RING.1 * ring.len() as f64
    }
}
