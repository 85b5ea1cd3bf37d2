//! Branches that were cut close to their joint: their opening says more of them than their level sets.

use nalgebra::Unit;

use crate::mesh::preparation::{Opening, Surface};

use crate::centerline::segmentation::track::{Station, Track};

use super::cross_sections::nearest_ring;

/// Level sets of a branch from which on they show it: over about five radii.
pub const RINGS: usize = 12;
/// Fewer show nothing of it.
const FEWEST: usize = 5;

/// Puts stations inward from the opening that `track` ends in, square to it, in place of those near it. A front comes to a
/// short branch aslant, so that few of its level sets lie before the rim, or its level sets soon take in the joint; from those no
/// plane would be cut across it.
pub fn stations_before(surface: &Surface, track: &mut Track, opening: &Opening) {
    /// How far from the opening they lie, in its radii, and how far others do.
    const DEPTHS: [f64; 3] = [0.9, 0.6, 0.3];
    const FAR: f64 = 1.2;
    let Some(outward) = Unit::try_new(opening.area_vector(&surface.mesh), 0.0) else { return };
    let (centre, radius) =
        (surface.mesh.vertices[opening.centre as usize], opening.area_radius(&surface.mesh));
    let shown = track.rings.len() >= FEWEST;
    track.stations.retain(|station| shown && (centre - station.point).dot(&outward) > FAR * radius);
    let station = |depth: f64| {
        let point = centre - outward.scale(depth * radius);
        Station::rough(point, outward, radius, nearest_ring(&track.rings, &point))
    };
    let inward = DEPTHS.map(station);
    track.stations.extend(inward);
}
