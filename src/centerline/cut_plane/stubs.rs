//! Branches that were cut close to their joint: their opening says more of them than their level sets.

use nalgebra::{Unit, Vector3};

use crate::mesh::preparation::{Opening, Surface};

use crate::centerline::segmentation::track::{Station, Track};
use crate::centerline::tips::root::{connected, free_direction, toward};

use super::cross_sections::nearest_ring;

/// Level sets of a branch from which on they show it: over about five radii.
pub const RINGS: usize = 12;
/// Fewer show nothing of it.
const FEWEST: usize = 5;

/// Puts stations inward from the opening that `track` ends in, square to its vessel, in place of those near it. A front comes
/// to a short branch aslant, so that few of its level sets lie before the rim, or its level sets soon take in the joint; from those
/// no plane would be cut across it. O(wall near the rim).
pub fn stations_before(surface: &Surface, track: &mut Track, opening: &Opening) {
    /// How far from the opening they lie, in the vessel's radii, and how far others do.
    const DEPTHS: [f64; 3] = [0.9, 0.6, 0.3];
    const FAR: f64 = 1.2;
    let Some(square) = Unit::try_new(opening.area_vector(&surface.mesh), 0.0) else { return };
    let outward = axis(surface, opening, &square).unwrap_or(square);
    let cosine = outward.dot(&square);
    // A cut aslant is an ellipse, and wall all around begins behind its nearer side.
    let radius = opening.area_radius(&surface.mesh) * cosine.sqrt();
    let aslant = radius * (1.0 / (cosine * cosine) - 1.0).max(0.0).sqrt();
    let centre = surface.mesh.vertices[opening.centre as usize];
    let shown = track.rings.len() >= FEWEST;
    let is_far = |station: &Station| (centre - station.point).dot(&outward) > aslant + FAR * radius;
    track.stations.retain(|station| shown && is_far(station));
    let station = |depth: f64| {
        let point = centre - outward.scale(aslant + depth * radius);
        Station::rough(point, outward, radius, nearest_ring(&track.rings, &point))
    };
    let inward = DEPTHS.map(station);
    track.stations.extend(inward);
}

/// The direction of the vessel at an opening, out of it: the one that the normals of the wall along the rim leave free (eq. 9).
/// `None` where they leave none, or one along the cut.
fn axis(surface: &Surface, opening: &Opening, square: &Unit<Vector3<f64>>) -> Option<Unit<Vector3<f64>>> {
    /// How far behind the cut the wall is looked at, in the opening's radii.
    const DEPTH: f64 = 0.4;
    /// Most of the normals that may lie along the vessel, against across it.
    const FREE: f64 = 0.5;
    /// Cosines between vessel and cut: past the last it was cut square, as near as such a wall tells; before the first it shows a
    /// wall along the cut.
    const ASLANT: std::ops::Range<f64> = 0.45..0.9;
    let at = |v: u32| surface.mesh.vertices[v as usize] - surface.mesh.vertices[opening.centre as usize];
    let depth = DEPTH * opening.area_radius(&surface.mesh);
    let far = opening.rim.iter().map(|&v| at(v).norm()).fold(0.0, f64::max).hypot(depth);
    let is_near = |&v: &u32| at(v).dot(square) > -depth && at(v).norm() < far;
    let is_wall = |t: u32| !surface.is_cap(t) && surface.mesh.triangles[t as usize].iter().all(is_near);
    let mut wall = connected(surface, opening.centre, |t| opening.cap.contains(&t) || is_wall(t));
    wall.retain(|&t| !surface.is_cap(t));
    // In the order of the mesh: sums depend on it.
    wall.sort_unstable();
    let axis = toward(free_direction(surface, wall.into_iter(), FREE)?, square);
    ASLANT.contains(&axis.dot(square)).then(|| Unit::new_normalize(axis))
}
