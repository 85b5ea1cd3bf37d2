//! Radii on the way into a joint, where no section shows a branch alone.
//!
//! They go on from the last section before. Where that lies in a throat they would go on narrow through a lumen that is wide
//! again: there the branch's usual radius is told as far as a sphere of it fits.

use nalgebra::Point3;
use rayon::prelude::*;

use crate::centerline::connection::network::Network;
use crate::centerline::median::place_at_share;
use crate::centerline::segmentation::track::{Sight, Station};
use crate::centerline::triangle_grid::TriangleGrid;

/// Widens the radii between joints and throats close behind them. O(hidden stations x stations of the branches beside).
pub fn widen_before_throats(grid: &TriangleGrid<'_>, network: &mut Network) {
    let seen = &*network;
    let wider = |number: usize| [false, true].map(|at_end| wider_radii(grid, seen, number, at_end));
    let all: Vec<[Vec<f64>; 2]> = (0..network.tracks.len()).into_par_iter().map(wider).collect();
    for (track, ends) in network.tracks.iter_mut().zip(all) {
        for (at_end, radii) in [false, true].into_iter().zip(ends) {
            let count = track.stations.len();
            for (i, radius) in radii.into_iter().enumerate() {
                let place = if at_end { count - 1 - i } else { i };
                track.stations[place].radius = radius;
            }
        }
    }
}

/// The radii of a branch's stations before its first clean one, from the joint on; none where it ends in no joint or that
/// section lies in no throat.
fn wider_radii(grid: &TriangleGrid<'_>, network: &Network, number: usize, at_end: bool) -> Vec<f64> {
    /// Radius of that section against the usual one, below which it lies in a throat.
    const NARROW: f64 = 0.85;
    /// How far beside another branch a sphere may be, in its radii, that shares its lumen or has parted from it just before.
    const NEAR: f64 = 2.6;
    let own = &network.tracks[number];
    let node = if at_end { own.to } else { own.from };
    if !own.is_line() || network.is_end(node) || network.is_ring(node) {
        return Vec::new();
    }
    let mut from_joint: Vec<&Station> = own.stations.iter().collect();
    if at_end {
        from_joint.reverse();
    }
    let clean = from_joint.iter().position(|station| station.sight == Sight::Clean);
    let (hidden, seen) = from_joint.split_at(clean.unwrap_or(from_joint.len()));
    let is_throat = |usual: &f64| seen.first().is_some_and(|nearest| nearest.radius < NARROW * usual);
    let Some(usual) = usual_radius(seen).filter(is_throat) else { return Vec::new() };
    let beside = beside(network, node, number);
    let radius = |station: &&Station| {
        let fits = grid.clearance(&station.point).min(usual);
        // Far from the other branches a narrow radius may be right.
        let shared = beside.iter().any(|point| (point - station.point).norm() < NEAR * fits);
        if shared { station.radius.max(fits) } else { station.radius }
    };
    hidden.iter().map(radius).collect()
}

/// The stations of the other branches at a joint.
fn beside(network: &Network, node: usize, number: usize) -> Vec<Point3<f64>> {
    let incident = network.incident(node).into_iter().filter(|&(other, _)| other != number);
    incident
        .flat_map(|(other, _)| network.tracks[other].stations.iter().map(|station| station.point))
        .collect()
}

/// Median radius of the clean sections, by length, over the length from the first on that is longer than a throat.
fn usual_radius(seen: &[&Station]) -> Option<f64> {
    /// That length, in radii of the widest section there.
    const RUN: f64 = 8.0;
    let nearest = seen.first()?.point;
    let (mut steps, mut widest, mut before) = (Vec::new(), 0.0_f64, nearest);
    // Stations stand closer together where it is narrow.
    for Station { point, radius, .. } in seen.iter().filter(|station| station.sight == Sight::Clean) {
        widest = widest.max(*radius);
        if (point - nearest).norm() > RUN * widest {
            break;
        }
        steps.push((*radius, (point - std::mem::replace(&mut before, *point)).norm()));
    }
    steps.sort_by(|a, b| a.0.total_cmp(&b.0));
    place_at_share(steps.iter().map(|step| step.1), 0.5).map(|place| steps[place].0)
}
