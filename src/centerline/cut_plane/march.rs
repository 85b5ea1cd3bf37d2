//! From section to section along a branch: on to its cap, into a joint, and through gaps in between.

use nalgebra::{Point2, Point3, Unit};

use crate::centerline::laplacian_smoothing::curve_fit::CurveEnd;
use crate::centerline::segmentation::track::{
    SPACING, Sight, Station, Track, section_from_rings, section_from_seeds, update_tangents,
};

use super::cross_sections::{MOSTLY_WALL, is_one_vessel, is_own, nearest_ring, rings_near};
use super::ownership::Wall;
use super::section::{Frame, Profile};
use super::wall_fit::{judge, judge_end};

/// Share of a section's length that must be wall toward a cap: it would tilt the line as soon as
/// sections take it in.
const ALL_BUT_WALL: f64 = 0.9;

/// Where a march leads.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Toward {
    /// The branch ends there.
    Cap,
    /// Other branches take part there.
    Joint,
    /// The next station of the same branch.
    Station(Point3<f64>),
    /// The centre of a joint that is known by now.
    Centre(Point3<f64>),
}

/// Walks on from the last station while sections stay clean. O(sections x triangles cut).
pub fn march(wall: Wall<'_>, track: &mut Track, toward: Toward) {
    const LIMIT: usize = 400;
    /// Shortest step, in radii.
    const LEAST: f64 = 0.15;
    /// How far from the continued line a section's middle may lie, in radii; toward a cap, a section through a part of
    /// its layer lies as far aside.
    const ASIDE: f64 = 0.5;
    const ASIDE_AT_CAP: f64 = 0.25;
    let mut step = SPACING;
    for _ in 0..LIMIT {
        let Some(last) = track.stations.last() else { return };
        let radius = last.section_radius;
        let (point, tangent) = continued(&track.stations, last, step * radius);
        if is_past(track, &toward, last, &point, &tangent) {
            break;
        }
        let station = look(wall, track, last, point, tangent, &toward);
        let aside = if toward == Toward::Cap { ASIDE_AT_CAP } else { ASIDE };
        if station.sight == Sight::Clean && (station.target - point).norm() < aside * radius {
            track.stations.push(Station { point: station.target, ..station });
        } else if step > LEAST {
            step *= 0.5;
        } else {
            break;
        }
    }
    update_tangents(&mut track.stations);
}

/// The line of the stations continued by `step`, with its direction.
fn continued(stations: &[Station], last: &Station, step: f64) -> (Point3<f64>, Unit<nalgebra::Vector3<f64>>) {
    /// So many stations reach back three radii, whatever their steps were.
    const BACK: usize = 24;
    let points: Vec<_> =
        stations[stations.len().saturating_sub(BACK)..].iter().map(|station| station.point).collect();
    let end = CurveEnd::of(&points, 3.0 * last.section_radius);
    let straight = CurveEnd { point: last.point, tangent: *last.tangent, curvature: nalgebra::zero() };
    let (point, direction) = end.unwrap_or(straight).at(step);
    (point, Unit::new_normalize(direction))
}

/// Whether a step reaches farther than the march may.
fn is_past(
    track: &Track,
    toward: &Toward,
    last: &Station,
    point: &Point3<f64>,
    tangent: &nalgebra::Vector3<f64>,
) -> bool {
    /// How far past its last ring a branch may enter a joint, in radii: the vessel beyond may look like
    /// its own.
    const PAST: f64 = 1.5;
    let radius = last.section_radius;
    match toward {
        Toward::Cap => false,
        Toward::Joint => {
            let past = track.rings.last().map_or(0.0, |ring| (point - ring.centroid).dot(tangent));
            past > PAST * radius
        }
        Toward::Station(next) | Toward::Centre(next) => {
            let away = (next - point).norm() >= (next - last.point).norm();
            away || (next - point).dot(tangent) < 0.5 * SPACING * radius
        }
    }
}

/// A station at `point`, judged by its section.
fn look(
    wall: Wall<'_>,
    track: &Track,
    last: &Station,
    point: Point3<f64>,
    tangent: Unit<nalgebra::Vector3<f64>>,
    toward: &Toward,
) -> Station {
    let surface = wall.surface;
    let ring = nearest_ring(&track.rings, &point);
    let mut station = Station::rough(point, tangent, last.section_radius, ring);
    station.frame = Frame::new(point, tangent, last.frame.u);
    let near = last.seeds.and_then(|seeds| section_from_seeds(surface, station.frame, &seeds));
    let from_rings = || section_from_rings(surface, station.frame, rings_near(&track.rings, ring));
    let cut = near.or_else(from_rings);
    let Some(cut) = cut.filter(|cut| cut.encloses(&Point2::origin())) else { return station };
    if *toward == Toward::Cap {
        judge_end(surface, &mut station, &cut, &last.profile, ALL_BUT_WALL);
        return station;
    }
    judge(surface, &mut station, &cut, &last.profile);
    let inner = matches!(toward, Toward::Station(_));
    if inner && station.sight != Sight::Clean && is_own(wall, &cut) {
        let own = Profile::circle(cut.measure().radius());
        judge_end(surface, &mut station, &cut, &own, MOSTLY_WALL);
    } else if inner && station.sight != Sight::Clean && is_one_vessel(&cut, &last.profile) {
        judge_end(surface, &mut station, &cut, &last.profile, MOSTLY_WALL);
    }
    station
}

/// Marches into every gap between stations, from both sides. What saw no wall is a gap.
pub fn fill_gaps(wall: Wall<'_>, track: &mut Track) {
    /// Distance between neighbours that is a gap, in radii.
    const GAP: f64 = 2.0 * SPACING;
    /// Stations of a branch from which on gaps stay: a needle is any number of its radii long.
    const MOST: usize = 4000;
    track.stations.retain(|station| station.sight != Sight::Lost);
    let mut at = 0;
    while at + 1 < track.stations.len() && track.stations.len() < MOST {
        let (here, next) = (&track.stations[at], &track.stations[at + 1]);
        let radius = here.section_radius.min(next.section_radius);
        let clean = here.sight == Sight::Clean && next.sight == Sight::Clean;
        if !clean || (next.point - here.point).norm() < GAP * radius {
            at += 1;
            continue;
        }
        let behind = track.stations.split_off(at + 1);
        let after = behind.len();
        march(wall, track, Toward::Station(behind[0].point));
        let reached = track.stations[track.stations.len() - 1].point;
        let rings = std::mem::take(&mut track.rings);
        let mut rest = Track { rings, stations: behind, ..track.clone() };
        rest.reverse();
        march(wall, &mut rest, Toward::Station(reached));
        rest.reverse();
        track.rings = std::mem::take(&mut rest.rings);
        track.stations.append(&mut rest.stations);
        at = track.stations.len() - after;
    }
    update_tangents(&mut track.stations);
}

/// Marches from the last station of a ring without junctions to its first, and back where sections end.
pub fn close_ring(wall: Wall<'_>, track: &mut Track) {
    for _ in 0..2 {
        let Some(first) = track.stations.first().map(|station| station.point) else { return };
        march(wall, track, Toward::Station(first));
        track.reverse();
    }
}
