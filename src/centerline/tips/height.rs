//! How high a leaf of the Reeb graph stands over the vessel that it leaves.

use std::f64::consts::TAU;

use nalgebra::Point3;

use crate::mesh::preparation::Opening;

use crate::centerline::segment::from_segment;
use crate::centerline::segmentation::level_sets::{LevelSet, level_set};

use super::geodesic::RISE;
use super::stumps::EDGES;
use super::{Leaf, Pruning, ShortTip};

/// Least height in sample distances: what fewer samples show is no shape yet.
pub const SAMPLES: f64 = 3.0;

impl Pruning<'_> {
    /// How far the function rises along an arc.
    pub fn span(&self, arc: u32) -> f64 {
        let arc = &self.graph.arcs[arc as usize];
        self.graph.nodes[arc.upper as usize].level - self.graph.nodes[arc.lower as usize].level
    }

    /// How far the function rises along a leaf.
    pub fn rise(&self, leaf: &[u32]) -> f64 {
        leaf.iter().map(|&arc| self.span(arc)).sum()
    }

    /// The arc that a leaf begins with, and its radius there: of a circle as long as its level set.
    pub fn base_of(&self, leaf: &[u32]) -> Option<(u32, f64)> {
        leaf.last().map(|&first| (first, self.graph.arcs[first as usize].base_length / TAU))
    }

    /// Radius of the widest branch that goes on upward beside a leaf, where it begins.
    fn sibling_radius(&self, base: u32, leaf: &[u32]) -> f64 {
        let arc = self.widest_beside(leaf, base, true);
        arc.map_or(f64::INFINITY, |arc| self.graph.arcs[arc as usize].base_length / TAU)
    }

    /// The same over some of a leaf's own radii, where it begins narrower: it may be a throat, in front of which the front
    /// leaves a pocket of the wall for later, and behind which the vessel is as wide as before.
    fn behind_throat(&self, base: u32, leaf: &[u32], (sibling, radius): (f64, f64)) -> f64 {
        /// Where to look, in radii of the leaf.
        const BEHIND: [f64; 4] = [1.0, 2.0, 3.0, 4.0];
        let Some(arc) = self.widest_beside(leaf, base, true).filter(|_| sibling < radius) else {
            return sibling;
        };
        let level = self.graph.nodes[base as usize].level;
        let behind = BEHIND.iter().filter_map(|far| self.beyond(arc, level, far * radius));
        behind.map(|ring| ring.area_radius()).fold(sibling, f64::max)
    }

    /// Whether a leaf is high enough over its base to be a branch; `height` is its rise of distance.
    pub fn stands_out(&self, arcs: &[u32], base: u32, leaf: u32, height: f64, tip_height: f64) -> bool {
        /// Largest hole in a wall, in radii of the vessel.
        const HOLE: f64 = 0.25;
        let Some((first, radius)) = self.base_of(arcs) else { return false };
        let sibling = self.sibling_radius(base, arcs);
        let open = self.opening_at(leaf).filter(|opening| !opening.was_closed);
        // The vessel was cut here, however shortly; a small opening straight in the wall is a hole.
        if open.is_some_and(|opening| !sibling.is_finite() || opening.radius >= HOLE * sibling) {
            return true;
        }
        let beside = self.behind_throat(base, arcs, (sibling, radius));
        let height = height - self.rise_of_cap(leaf);
        let sample = self.sample(first, leaf);
        if self.is_needle(first, (radius, sibling), height) {
            return false;
        }
        let least = (tip_height * radius.min(beside)).max(SAMPLES * sample);
        if let Some(met) = self.met_below(base, arcs, radius.min(beside)) {
            return height >= least && self.over_fronts(met, leaf) >= least;
        }
        // No straight distance is longer than the geodesic beside it but by the base's width: a cheap look first.
        if height < 0.5 * least {
            return false;
        }
        // Where the base is as wide as the vessel beside it, a front has climbed there while it passed.
        let climbed = radius >= beside || height >= least;
        let over = || self.over_vessel(arcs, base, leaf, radius);
        // Of a wider base a flat piece of wall reaches as far.
        let is_narrow = radius <= beside || height >= least;
        is_narrow && self.reaches(arcs, leaf, least)
            || climbed
                && over().is_some_and(|(over, radius)| over >= (tip_height * radius).max(SAMPLES * sample))
    }

    /// Whether a leaf is a fold of a few slivers of the mesh: of no size beside its vessel, and higher than wide, so that its
    /// height in its own radii says nothing.
    fn is_needle(&self, first: u32, (radius, sibling): (f64, f64), height: f64) -> bool {
        /// Its greatest radius and height in radii of the vessel beside it.
        const WIDE: f64 = 0.05;
        const HIGH: f64 = 0.25;
        let edges = self.graph.arcs[first as usize].base_edges;
        edges < EDGES && sibling.is_finite() && radius < WIDE * sibling && height < HIGH * sibling
    }

    /// The opening whose centre a node is.
    pub fn opening_at(&self, node: u32) -> Option<&Opening> {
        let vertex = self.graph.nodes[node as usize].vertex;
        self.surface.opening_at(vertex)
    }

    /// The cut whose flat cap's middle a node is.
    fn closed_at(&self, node: u32) -> Option<&Opening> {
        self.opening_at(node).filter(|opening| opening.was_closed)
    }

    /// How much of a leaf's height is the rise that made the middle of a flat cap its tip: a flat bump ends in a plane
    /// too, and counts by what is left.
    pub fn rise_of_cap(&self, leaf: u32) -> f64 {
        self.closed_at(leaf).map_or(0.0, |closed| RISE * closed.radius)
    }

    /// The same of any opening: how far its branch rises to it is what is left.
    pub fn rise_of_opening(&self, leaf: u32) -> f64 {
        self.opening_at(leaf).map_or(0.0, |opening| RISE * opening.radius)
    }

    /// Length of a short edge at a node: not the shortest, which noise makes. In an opening the mean of its rim's: those
    /// of a fan are as long as the opening is wide.
    fn edge_at(&self, node: u32) -> f64 {
        if let Some(opening) = self.opening_at(node) {
            return TAU * opening.radius / opening.rim.len() as f64;
        }
        let vertex = self.graph.nodes[node as usize].vertex;
        let (mesh, corners) = (&self.surface.mesh, &self.surface.corners);
        let place = mesh.vertices[vertex as usize];
        let lengths = corners.neighbours(vertex).map(|u| (mesh.vertices[u as usize] - place).norm());
        let (mut shortest, mut second) = (f64::INFINITY, f64::INFINITY);
        for length in lengths {
            second = second.min(length.max(shortest));
            shortest = shortest.min(length);
        }
        if second.is_finite() { second } else { 0.0 }
    }

    /// Distance between samples at the base of the leaf whose lowest arc is `first`, and at its tip, whichever is longer.
    fn sample(&self, first: u32, leaf: u32) -> f64 {
        let first = &self.graph.arcs[first as usize];
        (first.base_length / f64::from(first.base_edges.max(1))).max(self.edge_at(leaf))
    }

    /// How far a tip lies outside the vessel that passes its base, from the vessel's wall, and the smaller of its base's
    /// `radius` and the vessel's. The vessel's is that of its level sets' areas, which noise does not lengthen; its way
    /// that between the nearest narrow ones on both sides, as it may bend.
    ///
    /// A front climbs a wide sac while it passes it along the vessel, so that the leaf begins in the
    /// middle of the sac: its reach says little of its height, and its rise too.
    pub fn over_vessel(&self, leaf: &[u32], base: u32, tip: u32, radius: f64) -> Option<(f64, f64)> {
        /// Most that a narrow one may be longer than the narrowest.
        const NARROW: f64 = 1.1;
        let narrow = |upward: bool| {
            let rings = self.rings_beyond(base, self.widest_beside(leaf, base, upward)?, upward);
            let least = rings.iter().map(|ring| ring.length).fold(f64::INFINITY, f64::min);
            rings.into_iter().find(|ring| ring.length <= NARROW * least)
        };
        let rings: Vec<LevelSet> = [false, true].iter().filter_map(|&upward| narrow(upward)).collect();
        let (a, b) = (rings.first()?, rings.last()?);
        let vessel = a.area_radius().max(b.area_radius());
        let over = from_segment(&self.position(tip), &a.centroid, &b.centroid) - vessel;
        Some((over, radius.min(vessel)))
    }

    /// The widest arc that comes up to a leaf's base, or goes up from it, beside the leaf.
    fn widest_beside(&self, leaf: &[u32], base: u32, upward: bool) -> Option<u32> {
        let beside = self.alive_at(base).filter(|arc| !leaf.contains(arc));
        let way = beside.filter(|&arc| (self.graph.arcs[arc as usize].lower == base) == upward);
        let length = |&arc: &u32| self.graph.arcs[arc as usize].base_length;
        way.max_by(|a, b| length(a).total_cmp(&length(b)))
    }

    /// Radius of the vessel that passes a leaf's base: of its wider side, and of the narrower where that goes on as a
    /// branch so thin that no front runs along both. Where the leaf `stays` it may be a sac, which the vessel's level sets
    /// climb as they pass: there the narrowest counts, but for a cap's.
    pub fn radius_beside(&self, leaf: &[u32], base: u32, stays: bool) -> Option<f64> {
        /// Least radius of the narrower side against the wider, and of a level set that is no cap's against the usual.
        const THIN: f64 = 0.5;
        let side = |upward: bool| {
            let rings = self.rings_beyond(base, self.widest_beside(leaf, base, upward)?, upward);
            let mut radii: Vec<f64> = rings.iter().map(LevelSet::area_radius).collect();
            radii.sort_unstable_by(f64::total_cmp);
            let usual = *radii.get(radii.len() / 2)?;
            // One much narrower than most lies on the cap where the vessel ends.
            let narrowest = radii.into_iter().find(|radius| *radius >= THIN * usual);
            narrowest.filter(|_| stays).or(Some(usual))
        };
        let sides = [side(false), side(true)];
        let [narrow, wide] = [f64::min, f64::max].map(|of| sides.into_iter().flatten().reduce(of));
        if narrow? < THIN * wide? { narrow } else { wide }
    }

    /// What is known of a leaf that rises by `height`, the rise of a cap's middle left out.
    pub fn short_tip(
        &self,
        arcs: &[u32],
        base: u32,
        leaf: u32,
        (height, stays): (f64, bool),
    ) -> Option<ShortTip> {
        let (first, radius) = self.base_of(arcs)?;
        let edges = self.graph.arcs[first as usize].base_edges;
        let ring = self.rings(first).next()?;
        // Of what few edges show nobody asks.
        let beside = if edges < EDGES { None } else { self.radius_beside(arcs, base, stays) };
        let (vertex, sample) = (self.graph.nodes[leaf as usize].vertex, self.sample(first, leaf));
        Some(ShortTip { leaf: Leaf { vertex, base: ring.centroid, radius, beside }, height, sample })
    }

    /// The node, at or within `near` below `base`, where two fronts met, and the two arcs below it; `leaf` is not looked
    /// at. `None` where one front came alone.
    pub fn met_below(&self, base: u32, leaf: &[u32], near: f64) -> Option<(u32, [u32; 2])> {
        let level = |node: u32| self.graph.nodes[node as usize].level;
        let mut node = base;
        while level(base) - level(node) <= near {
            let below = |arc: &u32| self.graph.arcs[*arc as usize].upper == node && !leaf.contains(arc);
            match self.alive_at(node).filter(below).collect::<Vec<u32>>()[..] {
                [alone] => node = self.graph.arcs[alone as usize].lower,
                [a, b] => return Some((node, [a, b])),
                _ => return None,
            }
        }
        None
    }

    /// How far a tip lies outside the vessel along which two fronts met, from its wall: what both leave between them
    /// until the last is a leaf, however long it is around the vessel.
    pub fn over_fronts(&self, (met, fronts): (u32, [u32; 2]), tip: u32) -> f64 {
        let [mut line, other] = fronts.map(|arc| self.rings_beyond(met, arc, false));
        line.reverse();
        line.extend(other);
        let radius = line.iter().map(LevelSet::radius).fold(f64::INFINITY, f64::min);
        let tip = self.position(tip);
        let away = line.windows(2).map(|pair| from_segment(&tip, &pair[0].centroid, &pair[1].centroid));
        away.fold(f64::INFINITY, f64::min) - radius
    }

    /// A few level sets beyond `base` along `arc` and what goes on from it, the nearest first.
    fn rings_beyond(&self, base: u32, arc: u32, upward: bool) -> Vec<LevelSet> {
        /// Where to look, in radii of the first.
        const OFFSETS: [f64; 5] = [0.5, 1.5, 2.5, 3.5, 4.5];
        let level = self.graph.nodes[base as usize].level;
        let at = |offset: f64| self.beyond(arc, level, if upward { offset } else { -offset });
        let Some(radius) = at(0.0).map(|ring| ring.radius()) else { return Vec::new() };
        OFFSETS.iter().filter_map(|offset| at(offset * radius)).collect()
    }

    /// The level set at `level + rise` on `arc`, or on the widest arcs that continue it.
    fn beyond(&self, mut arc: u32, level: f64, rise: f64) -> Option<LevelSet> {
        const LIMIT: usize = 256;
        let (mesh, corners) = (&self.surface.mesh, &self.surface.corners);
        for _ in 0..LIMIT {
            let data = &self.graph.arcs[arc as usize];
            let (low, high) = (data.lower, data.upper);
            let far = if rise >= 0.0 { high } else { low };
            let reached = (self.graph.nodes[far as usize].level - level).abs() >= rise.abs();
            if reached {
                return Some(level_set(&mesh.vertices, corners, self.graph, arc as usize, level + rise));
            }
            let onward = self.alive_at(far).filter(|&next| {
                let next = &self.graph.arcs[next as usize];
                if rise >= 0.0 { next.lower == far } else { next.upper == far }
            });
            let length = |&arc: &u32| self.graph.arcs[arc as usize].base_length;
            arc = onward.max_by(|a, b| length(a).total_cmp(&length(b)))?;
        }
        None
    }

    /// The level sets along an arc, upward from its lower node.
    pub fn rings(&self, arc: u32) -> impl Iterator<Item = LevelSet> + '_ {
        const LEVELS: usize = 4;
        let low = self.graph.nodes[self.graph.arcs[arc as usize].lower as usize].level;
        (0..LEVELS).map(move |i| {
            let level = low + self.span(arc) * i as f64 / LEVELS as f64;
            let (mesh, corners) = (&self.surface.mesh, &self.surface.corners);
            level_set(&mesh.vertices, corners, self.graph, arc as usize, level)
        })
    }

    pub fn position(&self, node: u32) -> Point3<f64> {
        self.surface.mesh.vertices[self.graph.nodes[node as usize].vertex as usize]
    }

    /// Whether the tip or a level set's centre lies as far as `least` from the centre of the base.
    fn reaches(&self, arcs: &[u32], tip: u32, least: f64) -> bool {
        let mut rings = arcs.iter().rev().flat_map(|&arc| self.rings(arc));
        let Some(base) = rings.next() else { return false };
        // The tip, which most often does, costs nothing.
        let mut centres = std::iter::once(self.position(tip)).chain(rings.map(|ring| ring.centroid));
        centres.any(|centre| (centre - base.centroid).norm() >= least)
    }
}
