//! How long the fronts are that run from a cap: those of a tube stay as long as they are.

use std::f64::consts::TAU;

use crate::mesh::preparation::Surface;

use super::geodesic::Near;

/// The wall's area by its distance from a cap. Its slope is the fronts' length, which noise does not lengthen much.
#[derive(Debug, Clone)]
pub struct FrontLengths {
    step: f64,
    /// Area within each multiple of the step, from the first on; at least two.
    within: Vec<f64>,
}

/// The part of a wall along which fronts stay as long as they are. Lengths in the input's unit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tube {
    /// How far from the cap it ends.
    pub base: f64,
    /// Radius at the cap.
    pub mouth: f64,
    /// Radius where it is narrowest.
    pub radius: f64,
}

impl FrontLengths {
    /// Of the wall that was reached; `None` where that is no more than a cap. O(its triangles).
    ///
    /// `scale` is a radius of the vessel, in the input's unit.
    pub fn of(surface: &Surface, near: &Near, scale: f64) -> Option<Self> {
        /// Steps in a radius.
        const STEPS: f64 = 10.0;
        /// More than any stump takes.
        const MOST: f64 = 1e4;
        let step = scale / STEPS;
        let farthest = near.reached().map(|(_, d)| d).fold(0.0, f64::max);
        let is_few = farthest / step < MOST;
        if !is_few {
            return None;
        }
        let mut bins = vec![0.0; (farthest / step) as usize + 2];
        for (v, _) in near.reached() {
            for t in surface.corners.star(v).map(|h| h / 3) {
                let corners = surface.mesh.triangles[t as usize];
                // Each triangle once, at its least vertex.
                if corners.iter().any(|&u| u < v) {
                    continue;
                }
                let [Some(a), Some(b), Some(c)] = corners.map(|u| near.distance(u)) else { continue };
                let [first, last] = [a.min(b).min(c), a.max(b).max(c)].map(|d| (d / step) as usize);
                let share = 0.5 * surface.mesh.area_vector(t).norm() / (last - first + 1) as f64;
                bins[first..=last].iter_mut().for_each(|bin| *bin += share);
            }
        }
        let mut sum = 0.0;
        let within = bins.iter().map(|bin| {
            sum += bin;
            sum
        });
        Some(Self { step, within: within.collect() })
    }

    /// Area within a distance, that of the cap and a step below it at least.
    fn area(&self, within: f64) -> f64 {
        let last = self.within.len() - 1;
        let at = (within / self.step - 1.0).clamp(0.0, last as f64);
        let below = (at as usize).min(last - 1);
        let share = at - below as f64;
        self.within[below] * (1.0 - share) + self.within[below + 1] * share
    }

    /// Mean length of the fronts less than `half` from a distance.
    fn length(&self, at: f64, half: f64) -> f64 {
        let low = (at - half).max(self.step);
        (self.area(at + half) - self.area(low)) / (at + half - low)
    }

    /// As much of the wall as is a tube. `None` where its fronts grow from the cap on, as they do around a bump.
    ///
    /// `scale` as in [`FrontLengths::of`].
    pub fn tube(&self, scale: f64) -> Option<Tube> {
        /// Most that a tube's fronts grow within half a radius: around a bump they grow by half.
        const GROWTH: f64 = 1.25;
        /// Most that they may be against the shortest of them.
        const LONGEST: f64 = 1.15;
        /// How far from the cap they grow no more, in radii of the vessel: around a bump they do until they have gone round.
        const SETTLED: f64 = 0.5;
        let half = 0.25 * scale;
        let length = |at: f64| self.length(at, half);
        let is_steady = |at: f64| length(at + 0.5 * length(at) / TAU) <= GROWTH * length(at);
        // What was reached last is no front any more.
        let end = (self.within.len() - 1) as f64 * self.step - scale;
        let places = (1..).map(|k| f64::from(k) * self.step).take_while(|&at| at < end);
        let mut tube = places.skip_while(|&at| at < SETTLED * scale && !is_steady(at)).peekable();
        let mouth = length(*tube.peek()?) / TAU;
        let mut shortest = f64::INFINITY;
        let tube = tube.take_while(|&at| {
            shortest = shortest.min(length(at));
            is_steady(at) && length(at) <= LONGEST * shortest
        });
        let base = tube.last()?;
        Some(Tube { base, mouth, radius: shortest / TAU })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::centerline::CancelToken;
    use crate::centerline::shapes::{open_tube, sphere};
    use crate::centerline::test_surfaces::closed_surface;
    use crate::centerline::tips::geodesic::{EdgeGraph, geodesic_near};

    fn tube_from(
        surface: &Surface,
        vertex: u32,
        cap: impl Fn(&nalgebra::Point3<f64>) -> bool,
    ) -> Option<Tube> {
        let edges = EdgeGraph::new(&surface.mesh.vertices, &surface.corners);
        let places = surface.mesh.vertices.iter().enumerate();
        let cap = places.filter(|(_, place)| cap(place)).map(|(v, _)| v as u32).collect();
        let near = geodesic_near(&edges, (vertex, &cap), |_, d| d < 8.0, &CancelToken::new()).unwrap();
        FrontLengths::of(surface, &near, 1.0)?.tube(1.0)
    }

    #[test]
    fn a_tube_is_one_as_far_as_it_is_looked_at() {
        let surface = closed_surface(&open_tube(20.0, 101, 48));
        let foot = surface.mesh.vertices.iter().position(|place| place.z < 0.1).unwrap();
        let Tube { base, mouth, radius } = tube_from(&surface, foot as u32, |place| place.z < 0.3).unwrap();
        // Ways along edges are longer than the shortest ones: area a distance is less.
        assert!(base > 6.5, "{base}");
        assert!((mouth - 1.0).abs() < 0.08 && (radius - 1.0).abs() < 0.08, "{mouth} {radius}");
    }

    #[test]
    fn a_front_on_the_side_of_a_tube_grows_at_once() {
        let surface = closed_surface(&open_tube(20.0, 101, 48));
        let is_middle = |p: &nalgebra::Point3<f64>| (p.z - 10.0).abs() < 0.3 && p.x > 0.9;
        let middle = surface.mesh.vertices.iter().position(is_middle).unwrap();
        let found = tube_from(&surface, middle as u32, is_middle);
        assert!(found.is_none_or(|tube| tube.base < 0.5), "{found:?}");
    }

    #[test]
    fn a_sphere_ends_where_its_fronts_close_in() {
        let surface = closed_surface(&sphere(80, 120));
        let top = (0..surface.mesh.vertices.len())
            .max_by(|&a, &b| surface.mesh.vertices[a].z.total_cmp(&surface.mesh.vertices[b].z));
        // From 60 degrees off the pole on: 2.1 to the other one, less the last radius, which is not looked at.
        let found = tube_from(&surface, top.unwrap() as u32, |place| place.z > 0.5);
        assert!(found.is_none_or(|tube| tube.base < 1.2), "{found:?}");
    }
}
