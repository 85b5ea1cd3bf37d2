//! What the sections of a stretch say of its middle line and of its radii.

use std::ops::{Add, Mul};

use nalgebra::{Point3, Vector3};

use super::suspects::is_clear;
use super::window::Window;
use super::{AGREED, COARSE, REFUTED};
use crate::centerline::component::ComponentGraph;
use crate::centerline::own_sections::OwnSection;
use crate::centerline::triangle_grid::TriangleGrid;

/// Distance of the line from the middles of the sections, in their radii, up to which it stays, as it knows the wall on either
/// side as well; from twice that on it moves all the way.
pub const CENTRED: f64 = 0.15;
/// How far a place takes the worst that is seen, in radii.
const AROUND: f64 = 1.0;
/// How much more than the distance of the wall, which noise brings near, a sphere may have that is wider than told.
const PAST_WALL: f64 = 1.15;

/// What is told anew at the points of a [`Window`].
pub struct Profile {
    /// From each point to its place in the middle.
    aside: Vec<Vector3<f64>>,
    /// The radius of the sphere around each point that no section's wall enters.
    spheres: Vec<f64>,
    /// How much of that is believed at each, 0 to 1.
    shares: Vec<f64>,
    /// The most of it.
    pub share: f64,
    /// The smallest radius of a section.
    pub least: f64,
}

impl Profile {
    /// `seen` are the sections in the window's planes; `noise` is the ratio that they differ by without any reason.
    pub fn of(window: &Window, seen: &[OwnSection], graph: &ComponentGraph, noise: f64) -> Self {
        let branch = &graph.branches[window.branch];
        let ways = branch.ways();
        let own: Vec<&OwnSection> = seen.iter().filter(|section| is_clear(graph, section, &ways)).collect();
        let (points, told) = (&branch.points[window.places.clone()], &branch.radii[window.places.clone()]);
        if own.is_empty() {
            let (aside, shares) = (vec![Vector3::zeros(); points.len()], vec![0.0; points.len()]);
            return Self { aside, spheres: told.to_vec(), shares, share: 0.0, least: f64::INFINITY };
        }
        let place = |section: &OwnSection| section.place - window.places.start;
        let middle = |&section: &&OwnSection| (place(section), section.middle - branch.points[section.place]);
        let radius = |&section: &&OwnSection| (place(section), section.inscribed.ln());
        let mut aside = smoothed(between(&own.iter().map(middle).collect::<Vec<_>>(), points.len()));
        let radii = smoothed(between(&own.iter().map(radius).collect::<Vec<_>>(), points.len()));
        let radii: Vec<f64> = radii.into_iter().map(f64::exp).collect();
        let spheres = spheres(points, &radii);

        let showing = own.iter().filter(|section| section.near.is_finite()).count() as f64 / own.len() as f64;
        let usual = noise * COARSE.powf((2.0 * (1.0 - showing)).min(1.0));
        // Only where there is a section: beyond the last, nothing is known.
        let ratio =
            |i: usize| if told[i] > 0.0 { (spheres[i] / told[i]).max(told[i] / spheres[i]) } else { 1.0 };
        let places: Vec<usize> = own.iter().map(|section| place(section)).collect();
        let worst = around(points, &radii, &places, ratio);
        let off = around(points, &radii, &places, |i| aside[i].norm() / radii[i]);
        let share = |i: usize| ((worst[i] / usual - AGREED) / (REFUTED - AGREED)).clamp(0.0, 1.0);
        let shares: Vec<f64> = (0..points.len()).map(|i| window.fade[i] * share(i)).collect();
        for i in 0..points.len() {
            aside[i] *= shares[i] * ((off[i] - CENTRED) / CENTRED).clamp(0.0, 1.0);
        }
        let share = shares.iter().copied().fold(0.0, f64::max);
        Self { aside, spheres, shares, share, least: radii.into_iter().fold(f64::INFINITY, f64::min) }
    }

    pub fn move_points(&self, window: &Window, graph: &mut ComponentGraph) {
        let points = &mut graph.branches[window.branch].points[window.places.clone()];
        points.iter_mut().zip(&self.aside).for_each(|(point, aside)| *point += aside);
    }

    /// No sphere reaches past the wall between and beyond the sections, where that is aslant or a dome; one that shrinks stays as large
    /// as the wall is far, for that fits for sure.
    pub fn set_radii(
        &self,
        window: &Window,
        grid: &TriangleGrid<'_>,
        noise: f64,
        graph: &mut ComponentGraph,
    ) {
        let branch = &mut graph.branches[window.branch];
        for (i, place) in window.places.clone().enumerate() {
            let (told, sphere) = (branch.radii[place], self.spheres[i]);
            if told <= 0.0 || self.shares[i] <= 0.0 {
                continue;
            }
            let wall = grid.wall_distance(&branch.points[place]);
            let past = noise.min(PAST_WALL) * wall;
            let least = if sphere > told { told } else { wall.min(told) };
            let fits = sphere.min(past).max(least);
            branch.radii[place] = told * (fits / told).powf(self.shares[i]);
        }
    }
}

/// The radii of the spheres around `points` that no section's wall enters; `radii` are those of the sections.
fn spheres(points: &[Point3<f64>], radii: &[f64]) -> Vec<f64> {
    let one = |point: &Point3<f64>| {
        let square = |(other, radius): (&Point3<f64>, &f64)| radius * radius + (other - point).norm_squared();
        points.iter().zip(radii).map(square).fold(f64::INFINITY, f64::min).sqrt()
    };
    points.iter().map(one).collect()
}

/// At each point the greatest of some values within a radius; 0 where there is none. Those values are of `places`.
fn around(points: &[Point3<f64>], radii: &[f64], places: &[usize], value: impl Fn(usize) -> f64) -> Vec<f64> {
    let values: Vec<(usize, f64)> = places.iter().map(|&place| (place, value(place))).collect();
    let one = |i: usize| {
        let is_near = |&&(place, _): &&(usize, f64)| {
            (points[place] - points[i]).norm() <= AROUND * radii[i].max(radii[place])
        };
        values.iter().filter(is_near).map(|&(_, value)| value).fold(0.0, f64::max)
    };
    (0..points.len()).map(one).collect()
}

/// Values at all of `count` places from those at a few: between two by the number of the place, beyond the last as that.
fn between<T: Copy + Add<Output = T> + Mul<f64, Output = T>>(known: &[(usize, T)], count: usize) -> Vec<T> {
    let one = |place: usize| {
        let after = known.partition_point(|&(other, _)| other < place);
        let (low, high) = (known[after.saturating_sub(1)], known[after.min(known.len() - 1)]);
        if high.0 <= low.0 {
            return high.1;
        }
        let share = (place.clamp(low.0, high.0) - low.0) as f64 / (high.0 - low.0) as f64;
        low.1 * (1.0 - share) + high.1 * share
    };
    (0..count).map(one).collect()
}

/// Two passes of a quarter of each neighbour.
fn smoothed<T: Copy + Add<Output = T> + Mul<f64, Output = T>>(mut values: Vec<T>) -> Vec<T> {
    const PASSES: usize = 2;
    for _ in 0..PASSES {
        let at = |i: usize| values[i.min(values.len() - 1)];
        let one = |i: usize| at(i.saturating_sub(1)) * 0.25 + at(i) * 0.5 + at(i + 1) * 0.25;
        values = (0..values.len()).map(one).collect();
    }
    values
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_between_and_beyond_those_that_are_known() {
        assert_eq!(between(&[(1, 2.0), (3, 4.0)], 6), [2.0, 2.0, 3.0, 4.0, 4.0, 4.0]);
        assert_eq!(between(&[(0, 7.0)], 2), [7.0, 7.0]);
        assert_eq!(smoothed(vec![0.0, 0.0, 16.0, 0.0, 0.0]), [1.0, 4.0, 6.0, 4.0, 1.0]);
    }

    #[test]
    fn a_sphere_is_no_larger_than_a_throat_beside_it_lets_it_be() {
        let points = [0.0, 3.0, 4.0].map(|z| Point3::new(0.0, 0.0, z));
        assert_eq!(spheres(&points, &[5.0, 4.0, 1.0]), [17.0_f64.sqrt(), 2.0_f64.sqrt(), 1.0]);
    }

    #[test]
    fn the_worst_that_is_seen_counts_within_a_radius_of_it() {
        let points = [0.0, 0.9, 2.0, 5.0].map(|z| Point3::new(0.0, 0.0, z));
        assert_eq!(around(&points, &[1.0; 4], &[1, 2], |place| place as f64), [1.0, 1.0, 2.0, 0.0]);
    }
}
