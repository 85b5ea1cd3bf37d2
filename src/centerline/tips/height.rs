//! How high a leaf of the Reeb graph stands over the vessel that it leaves.

use std::f64::consts::TAU;

use nalgebra::Point3;

use crate::centerline::segmentation::level_sets::{LevelSet, level_set};

use super::Pruning;

impl Pruning<'_> {
    /// How far the function rises along an arc.
    pub fn span(&self, arc: u32) -> f64 {
        let arc = &self.graph.arcs[arc as usize];
        self.graph.nodes[arc.upper as usize].level - self.graph.nodes[arc.lower as usize].level
    }

    /// Radius of the widest branch that goes on upward beside a leaf.
    fn sibling_radius(&self, base: u32, leaf: &[u32]) -> f64 {
        let beside = self.alive_at(base).filter(|arc| !leaf.contains(arc));
        let upward = beside.filter(|&arc| self.graph.arcs[arc as usize].lower == base);
        let lengths = upward.map(|arc| self.graph.arcs[arc as usize].base_length);
        let widest = lengths.fold(0.0, f64::max);
        if widest > 0.0 { widest / TAU } else { f64::INFINITY }
    }

    /// Whether a leaf is high enough over its base to be a branch; `height` is its rise of distance,
    /// `beside` the radius of the vessel that it stands on.
    pub fn stands_out(&self, arcs: &[u32], base: u32, leaf: u32, height: f64, tip_height: f64) -> bool {
        /// Least height in sample distances: what fewer samples show is no shape yet.
        const SAMPLES: f64 = 3.0;
        /// Largest hole in a wall, in radii of the vessel.
        const HOLE: f64 = 0.25;
        let beside = self.sibling_radius(base, arcs);
        let Some(&first) = arcs.last() else { return false };
        let first = &self.graph.arcs[first as usize];
        let radius = first.base_length / TAU;
        let tip = self.graph.nodes[leaf as usize].vertex;
        let opening = self.surface.openings.iter().find(|opening| opening.centre == tip);
        // The vessel was cut here, however shortly; a small opening straight in the wall is a hole.
        if opening.is_some_and(|opening| !beside.is_finite() || opening.radius >= HOLE * beside) {
            return true;
        }
        let sample = (first.base_length / f64::from(first.base_edges.max(1))).max(self.edge_at(tip));
        let least = (tip_height * radius.min(beside)).max(SAMPLES * sample);
        // No straight distance is longer than the geodesic beside it but by the base's width: a cheap look first.
        let far = height >= 0.5 * least && self.reach(arcs, leaf) >= least;
        far || (height >= least && self.over_vessel(arcs, base, leaf) >= least)
    }

    /// Length of a short edge at a vertex: not the shortest, which noise makes.
    fn edge_at(&self, vertex: u32) -> f64 {
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

    /// How far a tip lies outside the vessel that passes its base, from the vessel's wall.
    ///
    /// A front climbs a wide sac while it passes it along the vessel, so that the leaf begins in the
    /// middle of the sac: its reach says little of its height.
    fn over_vessel(&self, leaf: &[u32], base: u32, tip: u32) -> f64 {
        let beside = || self.alive_at(base).filter(|arc| !leaf.contains(arc));
        let length = |&arc: &u32| self.graph.arcs[arc as usize].base_length;
        let widest = |upward: bool| {
            let way = beside().filter(move |&arc| (self.graph.arcs[arc as usize].lower == base) == upward);
            way.max_by(|a, b| length(a).total_cmp(&length(b)))
        };
        let rings: Vec<LevelSet> =
            [false, true].iter().filter_map(|&up| self.narrowest(base, widest(up)?, up)).collect();
        let (Some(a), Some(b)) = (rings.first(), rings.last()) else { return 0.0 };
        let along = b.centroid - a.centroid;
        let tip = self.position(tip);
        let share = (tip - a.centroid).dot(&along) / along.norm_squared().max(f64::MIN_POSITIVE);
        let nearest = a.centroid + along * share.clamp(0.0, 1.0);
        (tip - nearest).norm() - a.radius().max(b.radius())
    }

    /// The narrowest of a few level sets beyond `base` along `arc` and what goes on from it.
    fn narrowest(&self, base: u32, arc: u32, upward: bool) -> Option<LevelSet> {
        /// Where to look, in radii of the first.
        const OFFSETS: [f64; 5] = [0.5, 1.5, 2.5, 3.5, 4.5];
        let level = self.graph.nodes[base as usize].level;
        let at = |offset: f64| self.beyond(arc, level, if upward { offset } else { -offset });
        let radius = at(0.0)?.radius();
        let rings = OFFSETS.iter().filter_map(|offset| at(offset * radius));
        rings.min_by(|a, b| a.length.total_cmp(&b.length))
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

    /// Greatest distance of the tip or a level set's centre from the centre of the base.
    fn reach(&self, arcs: &[u32], tip: u32) -> f64 {
        let mut rings = arcs.iter().rev().flat_map(|&arc| self.rings(arc));
        let Some(base) = rings.next() else { return 0.0 };
        let centres = rings.map(|ring| ring.centroid).chain([self.position(tip)]);
        centres.map(|centre| (centre - base.centroid).norm()).fold(0.0, f64::max)
    }
}
