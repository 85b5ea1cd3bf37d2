//! Ends: the line reaches the middle of the cap, of the opening or of a dome's far wall.

use nalgebra::{Matrix3, Point3, Unit, Vector3};
use rayon::prelude::*;

use crate::mesh::preparation::{Opening, Surface};

use crate::centerline::connection::network::Network;
use crate::centerline::connection::subsampling::{Anchor, settle_radii};
use crate::centerline::laplacian_smoothing::curve_fit::CurveEnd;
use crate::centerline::segmentation::track::{Bulge, SPACING, Sight, Station, Track, update_tangents};
use crate::centerline::triangle_grid::TriangleGrid;
use crate::centerline::{Control, ExtractError};

/// Where the line of a track, continued past its last station, meets the surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EndPoint {
    pub point: Point3<f64>,
    /// Radius to report there, continued from the last sections.
    pub radius: f64,
}

/// Puts the end nodes of all branches that are `wanted` at the wall ahead of them.
///
/// # Errors
/// [`ExtractError::Cancelled`].
pub fn reach_ends(
    grid: &TriangleGrid<'_>,
    network: &mut Network,
    wanted: &(impl Fn(&Track) -> bool + Sync),
    control: &Control<'_>,
) -> Result<(), ExtractError> {
    let tip = |node: usize| network.is_end(node).then_some(network.nodes[node].vertex);
    let tips: Vec<[Option<u32>; 2]> =
        network.tracks.iter().map(|track| [tip(track.from), tip(track.to)]).collect();
    let reach = |(track, tips): (&mut Track, [Option<u32>; 2])| {
        control.cancel.check()?;
        let mut ends = [None; 2];
        for at_end in [false, true] {
            let Some(tip) = tips[usize::from(at_end)].filter(|_| wanted(track)) else { continue };
            let EndPoint { point, radius } = track.oriented(at_end, |track| {
                stay_inside(grid.surface(), track, tip);
                follow_rings(grid, track, tip);
                settle_radii(&mut track.stations);
                end_point(grid, track, tip)
            });
            ends[usize::from(at_end)] = Some(Anchor { point, radius });
        }
        Ok(ends)
    };
    let found: Vec<[Option<Anchor>; 2]> =
        network.tracks.par_iter_mut().zip(tips).map(reach).collect::<Result<_, ExtractError>>()?;
    for (track, [from, to]) in network.tracks.iter().zip(found) {
        for (node, anchor) in [(track.from, from), (track.to, to)] {
            network.nodes[node].anchor = anchor.or(network.nodes[node].anchor);
        }
    }
    Ok(())
}

/// The end point of `track` past its last station; `tip` is the Reeb leaf's vertex: the centre of an
/// opening, or what is used where the continued line meets no wall nearby.
///
/// O(stations + triangles beside the line).
pub fn end_point(grid: &TriangleGrid<'_>, track: &Track, tip: u32) -> EndPoint {
    let surface = grid.surface();
    let tip_point = surface.mesh.vertices[tip as usize];
    let opening = surface.opening_at(tip);
    let Some(last) = track.stations.last() else {
        let radius = opening.map_or(0.0, |opening| opening.area_radius(&surface.mesh));
        return EndPoint { point: tip_point, radius };
    };
    let points: Vec<Point3<f64>> = track.stations.iter().map(|s| s.point).collect();
    let reach = 3.0 * last.section_radius;
    let line = CurveEnd::of(&points, reach);
    let line =
        line.unwrap_or(CurveEnd { point: last.point, tangent: *last.tangent, curvature: nalgebra::zero() });
    if let Some(opening) = opening {
        let square = rim_normal(surface, opening);
        let point = in_opening(&line, &tip_point, square, last.section_radius);
        let point = on_cap(grid, &last.point, point, opening.radius);
        return EndPoint { point, radius: continued_radius(track, (point - last.point).norm()) };
    }
    let hit = grid.way_out(&last.point, &line.tangent);
    let near = hit.filter(|distance| *distance < 4.0 * last.section_radius);
    let to_tip = (tip_point - last.point).dot(&line.tangent).max(0.1 * last.section_radius);
    let distance = near.unwrap_or(to_tip);
    EndPoint { point: last.point + line.tangent * distance, radius: continued_radius(track, distance) }
}

/// Takes back what lies past the opening that a track ends in, or hardly before it: of a branch that was cut close to its joint
/// no level set but those of the opening's cap may be left, which shrink toward its raised centre.
fn stay_inside(surface: &Surface, track: &mut Track, tip: u32) {
    /// Least distance from the opening's plane, in its radii.
    const BEFORE: f64 = 0.01;
    /// How far from its middle, in its radii, a bend may come back past that plane.
    const NEAR: f64 = 2.0;
    let Some(opening) = surface.opening_at(tip) else { return };
    let Some(square) = opening.area_vector(&surface.mesh).try_normalize(0.0) else { return };
    let centre = surface.mesh.vertices[tip as usize];
    let is_inside = |station: &Station| {
        let away = centre - station.point;
        away.norm() > NEAR * opening.radius || away.dot(&square) > BEFORE * opening.radius
    };
    let inside = track.stations.iter().rposition(is_inside).map_or(0, |last| last + 1);
    track.stations.truncate(inside);
}

/// Where a line ends in an opening, on its plane: beside the centre of the rim, which a jagged cut moves off the axis;
/// at that centre where the line does not lead there.
fn in_opening(line: &CurveEnd, centre: &Point3<f64>, square: Vector3<f64>, radius: f64) -> Point3<f64> {
    /// How far a cut moves the centre, in radii.
    const JAGGED: f64 = 0.25;
    /// Cosine between the line and the direction square to the opening, below which the line runs along it.
    const ALONG: f64 = 0.3;
    let mut s = (centre - line.point).dot(&line.tangent);
    let mut aslant = 1.0;
    for _ in 0..3 {
        let (point, direction) = line.at(s);
        aslant = direction.dot(&square);
        s += if aslant > ALONG {
            (centre - point).dot(&square) / aslant
        } else {
            (centre - point).dot(&direction)
        };
    }
    let (point, _) = line.at(s);
    let near = s > 0.0 && (point - centre).norm() < JAGGED * radius / aslant.max(ALONG);
    if near { point } else { *centre }
}

/// An end beside the middle of an opening, on its cap where that lies a little before its plane: a jagged rim is not plane.
fn on_cap(grid: &TriangleGrid<'_>, from: &Point3<f64>, end: Point3<f64>, radius: f64) -> Point3<f64> {
    /// Most that a cap lies before its plane, in its radii.
    const BEFORE: f64 = 0.25;
    let way = end - from;
    let reached = grid.way_out(from, &way).filter(|&share| share < 1.0);
    let cap = reached.map(|share| from + way * share);
    cap.filter(|cap| (end - cap).norm() < BEFORE * radius).unwrap_or(end)
}

/// The direction out of the vessel and square to an opening, unit; zero where the rim encloses nothing.
fn rim_normal(surface: &Surface, opening: &Opening) -> Vector3<f64> {
    opening.area_vector(&surface.mesh).try_normalize(0.0).unwrap_or_default()
}

/// Goes on along the middles of the level sets where a line that runs straight on would leave the lumen through
/// its side, well before the tip: in a thin vessel of few triangles no section may be clean for long.
///
/// O(rings + triangles beside the line).
fn follow_rings(grid: &TriangleGrid<'_>, track: &mut Track, tip: u32) {
    /// How much farther than the wall ahead the tip lies, in radii.
    const SHORT: f64 = 0.8;
    /// A way to the tip that is longer than this, in radii, is no mere cap's.
    const LONG: f64 = 2.5;
    /// Level sets this near to a tip lie aslant, in radii.
    const ASLANT: f64 = 1.2;
    /// How firmly a level set's middle holds the line, against a section's.
    const LOOSE: f64 = 0.3;
    let tip = grid.surface().mesh.vertices[tip as usize];
    let Some(last) = track.stations.last().cloned() else { return };
    let radius = last.section_radius;
    let ahead = grid.way_out(&last.point, &last.tangent).unwrap_or(0.0);
    let away = (tip - last.point).dot(&last.tangent);
    if away < ahead + SHORT * radius && away < LONG * radius {
        return;
    }
    let mut before = last;
    for (number, ring) in track.rings.iter().enumerate().skip(before.ring + 1) {
        let step = ring.centroid - before.point;
        let forward = step.dot(&before.tangent) > 0.5 * SPACING * radius;
        if (tip - ring.centroid).norm() < ASLANT * radius {
            break;
        }
        let (true, Some(tangent)) = (forward, Unit::try_new(step, 0.0)) else { continue };
        let mut station = Station::rough(ring.centroid, tangent, radius, number);
        station.sight = Sight::Partial;
        station.weight = Matrix3::identity() * LOOSE;
        track.stations.push(station.clone());
        before = station;
    }
    update_tangents(&mut track.stations);
}

/// The far wall of a bulge, seen from its joint through its middle.
pub fn far_wall(grid: &TriangleGrid<'_>, bulge: &Bulge, joint: &Point3<f64>) -> Option<EndPoint> {
    let direction = (bulge.centre - joint).try_normalize(0.0)?;
    let distance = grid.way_out(&bulge.centre, &direction)?;
    let distance = distance.min(2.0 * bulge.radius);
    Some(EndPoint { point: bulge.centre + direction * distance, radius: 0.05 * bulge.radius })
}

/// Radius continued by `distance` from the slope over the last two radii of length, never below a
/// twentieth of the last.
pub fn continued_radius(track: &Track, distance: f64) -> f64 {
    let Some(last) = track.stations.last() else { return 0.0 };
    let far = |s: &&Station| (s.point - last.point).norm() > 2.0 * last.section_radius;
    let before = track.stations.iter().rev().find(far);
    let slope = before.map_or(0.0, |s| (last.radius - s.radius) / (last.point - s.point).norm());
    let radius = last.radius.max(0.0);
    (radius + slope * distance).clamp(0.05 * radius, 1.5 * radius)
}
