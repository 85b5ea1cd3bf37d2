//! What the sections of a stretch say of its middle line and of its radii.

use std::ops::{Add, Mul};

use nalgebra::{Point3, Vector3};

use super::suspects::is_clear;
use super::window::{Window, ways};
use super::{AGREED, COARSE, REFUTED};
use crate::centerline::component::ComponentGraph;
use crate::centerline::own_sections::OwnSection;
use crate::centerline::triangle_grid::TriangleGrid;

/// Distance of the line from the middles of the sections, in their radii, up to which it stays, as it knows the wall on either
/// side as well; from twice that on it moves all the way.
const CENTRED: f64 = 0.15;

/// What is told anew at the points of a [`Window`].
pub struct Profile {
    /// From each point to its place in the middle.
    aside: Vec<Vector3<f64>>,
    /// Each radius over the told one.
    ratios: Vec<f64>,
    /// How much of that is believed, 0 to 1.
    pub share: f64,
    /// The smallest radius of a section.
    pub least: f64,
}

impl Profile {
    /// `sections` are those in the window's planes, and maybe others; `noise` is the ratio that they differ by without any reason.
    pub fn of(
        window: &Window,
        sections: &[OwnSection],
        graph: &ComponentGraph,
        (grid, noise): (&TriangleGrid<'_>, f64),
    ) -> Self {
        let branch = &graph.branches[window.branch];
        let ways = ways(branch);
        let is_here = |s: &&OwnSection| s.branch == window.branch && window.places.contains(&s.place);
        let here = sections.iter().filter(is_here);
        let own: Vec<&OwnSection> = here.filter(|section| is_clear(graph, section, &ways)).collect();
        let count = window.places.len();
        if own.is_empty() {
            let (aside, ratios) = (vec![Vector3::zeros(); count], vec![1.0; count]);
            return Self { aside, ratios, share: 0.0, least: f64::INFINITY };
        }
        let place = |section: &OwnSection| section.place - window.places.start;
        let middle = |&section: &&OwnSection| (place(section), section.middle - branch.points[section.place]);
        let radius = |&section: &&OwnSection| (place(section), section.inscribed.ln());
        let mut aside = smoothed(between(&own.iter().map(middle).collect::<Vec<_>>(), count));
        let radii = smoothed(between(&own.iter().map(radius).collect::<Vec<_>>(), count));
        let radii: Vec<f64> = radii.into_iter().map(f64::exp).collect();
        let (points, told) = (&branch.points[window.places.clone()], &branch.radii[window.places.clone()]);
        let mut ratios = spheres(points, &radii, told, |point| noise * grid.wall_distance(point));

        let most = ratios.iter().map(|ratio| ratio.max(1.0 / ratio)).fold(1.0, f64::max);
        let showing = own.iter().filter(|section| section.near.is_finite()).count();
        let usual = if 2 * showing < own.len() { COARSE * noise } else { noise };
        let share = ((most / usual - AGREED) / (REFUTED - AGREED)).clamp(0.0, 1.0);
        let off = aside.iter().zip(&radii).map(|(aside, radius)| aside.norm() / radius).fold(0.0, f64::max);
        let moved = share * ((off - CENTRED) / CENTRED).clamp(0.0, 1.0);
        for (i, fade) in window.fade.iter().enumerate() {
            aside[i] *= fade * moved;
            ratios[i] = ratios[i].powf(fade * share);
        }
        Self { aside, ratios, share, least: radii.into_iter().fold(f64::INFINITY, f64::min) }
    }

    pub fn move_points(&self, window: &Window, graph: &mut ComponentGraph) {
        let points = &mut graph.branches[window.branch].points[window.places.clone()];
        points.iter_mut().zip(&self.aside).for_each(|(point, aside)| *point += aside);
    }

    pub fn set_radii(&self, window: &Window, graph: &mut ComponentGraph) {
        let told = &mut graph.branches[window.branch].radii[window.places.clone()];
        told.iter_mut().zip(&self.ratios).for_each(|(radius, ratio)| *radius *= ratio);
    }
}

/// The radii of the spheres around `points` that no section's wall enters, over the told ones. One that is larger than what was
/// told also stays off the wall between and beyond the sections, as a dome is, which has none.
fn spheres(
    points: &[Point3<f64>],
    radii: &[f64],
    told: &[f64],
    wall: impl Fn(&Point3<f64>) -> f64,
) -> Vec<f64> {
    let one = |(point, told): (&Point3<f64>, &f64)| {
        let square = |(other, radius): (&Point3<f64>, &f64)| radius * radius + (other - point).norm_squared();
        let fits = points.iter().zip(radii).map(square).fold(f64::INFINITY, f64::min).sqrt();
        if fits > *told { fits.min(wall(point)).max(*told) / told } else { fits / told }
    };
    points.iter().zip(told).map(one).collect()
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
        let ratios = spheres(&points, &[5.0, 4.0, 1.0], &[5.0, 5.0, 1.0], |_| f64::INFINITY);
        assert_eq!(ratios, [17.0_f64.sqrt() / 5.0, 2.0_f64.sqrt() / 5.0, 1.0]);
        let at_a_dome = spheres(&points[..1], &[5.0], &[2.0], |_| 3.0);
        assert_eq!(at_a_dome, [1.5], "wider than told, but no wider than the wall");
    }
}
