//! Re-centering of a branch by all of its wall's vertices (IV.D): the wall is taken for a tube whose centre and shape
//! change smoothly.
//!
//! A section hears only the triangles that it cuts, and its neighbour the same ones again. Here each vertex is heard
//! once, by the station next to it, and what the stations hear is smoothed along the branch, as stiffly as generalised
//! cross-validation asks for. So noise, stairs and coarse triangles average out over the whole branch. Centre and shape
//! are fitted in turns, each as a smooth curve in three dimensions
//! (see [`crate::centerline::laplacian_smoothing::curve_fit`]).

use std::ops::Range;

use nalgebra::Point3;
use rayon::prelude::*;
use rustc_hash::FxHashSet;

use crate::mesh::preparation::Surface;

use crate::centerline::connection::network::Network;
use crate::centerline::connection::subsampling::{Anchor, settle_radii};
use crate::centerline::cut_plane::wall_shape::FLAT;
use crate::centerline::laplacian_smoothing::branch::{observe, smooth};
use crate::centerline::recentering::ends::reach_ends;
use crate::centerline::recentering::lobes::lobes;
use crate::centerline::recentering::swept_fit::{Fitted, Search, fit_centre, fit_shape};
use crate::centerline::recentering::swept_tube::SweptTube;
use crate::centerline::recentering::swept_wall::{WallVertex, doubt_unusual, hear, wall_beside};
use crate::centerline::segmentation::track::{Sight, Station, Track, update_tangents};
use crate::centerline::triangle_grid::TriangleGrid;
use crate::centerline::{Control, ExtractError};

/// Rounds of fitting shape and centre. The first choose how stiff they are; the others keep to that and hear unusual
/// vertices less.
const CHOOSING: usize = 3;
const ROUNDS: usize = 5;
/// Stations of the shortest run, and vertices for each unknown that even the stiffest tube has.
const STATIONS: usize = 8;
const VERTICES: usize = 24;
/// Stations that would move farther than this (radii) are not on this wall.
const MOVED: f64 = 0.5;
/// Farthest from the middle of its own section (radii) that a station lies where nothing draws it aside.
const DRAWN: f64 = 0.05;
/// Radius over radius of bend above which the wall inside the bend says nothing of the line.
const TIGHT: f64 = 0.6;

/// Re-centers every branch but sacs, and sets its radii; those of its ends too. One that shows no tube is freed toward its
/// tip, whose place is found anew.
///
/// # Errors
/// [`ExtractError::Cancelled`].
pub fn recenter_branches(
    grid: &TriangleGrid<'_>,
    network: &mut Network,
    control: &Control<'_>,
) -> Result<(), ExtractError> {
    /// Of the first and of the last station's side.
    type Ends<T> = [Option<T>; 2];
    let surface = grid.surface();
    let tip = |node: usize| network.anchor(node).filter(|_| network.is_end(node)).map(|anchor| anchor.point);
    let tips: Vec<Ends<Point3<f64>>> =
        network.tracks.iter().map(|track| [tip(track.from), tip(track.to)]).collect();
    let joint = |node: usize| network.anchor(node).filter(|_| !network.is_end(node));
    let joints: Vec<Ends<Anchor>> =
        network.tracks.iter().map(|track| [joint(track.from), joint(track.to)]).collect();
    let one = |((track, tips), [from, to]): ((&mut Track, Ends<Point3<f64>>), Ends<Anchor>)| {
        control.cancel.check()?;
        // A ring has no ends that a smooth curve could be free at.
        let is_line = track.bulge.is_none() && track.from != track.to;
        if is_line && recenter(surface, track, tips) {
            update_tangents(&mut track.stations);
            settle_radii(&mut track.stations);
            track.process = observe(&track.stations);
            return Ok(true);
        }
        // Its end was found before its sections were cut anew: where it is off, it draws the line away from them.
        let is_off = |s: &Station| (s.point - s.target).norm() > DRAWN * s.section_radius;
        let mut clean = track.stations.iter().filter(|s| s.sight == Sight::Clean);
        let is_drawn = is_line && tips.iter().any(Option::is_some) && clean.any(is_off);
        if is_drawn {
            smooth(track, from, to);
        }
        Ok(is_drawn)
    };
    let work = network.tracks.par_iter_mut().zip(tips).zip(joints);
    let moved = work.map(one).collect::<Result<Vec<bool>, ExtractError>>()?;
    let moved: FxHashSet<usize> =
        network.tracks.iter().zip(moved).filter(|(_, moved)| *moved).map(|(track, _)| track.chain).collect();
    reach_ends(grid, network, &|track: &Track| moved.contains(&track.chain), control)
}

/// Returns whether any run of it was a tube. `tips`: where the track ends before its first and after its last station;
/// `None` at joints.
fn recenter(surface: &Surface, track: &mut Track, tips: [Option<Point3<f64>>; 2]) -> bool {
    let runs = runs(&track.stations);
    let count = track.stations.len();
    let mut moved = false;
    for (number, run) in runs.iter().enumerate() {
        // Toward a tip no other branch takes part: its wall is heard up to the cap.
        let first = tips[0].filter(|_| number == 0);
        let last = tips[1].filter(|_| number + 1 == runs.len());
        let longer = first.map_or(run.start, |_| 0)..last.map_or(run.end, |_| count);
        let away = |tip: Point3<f64>, station: usize| (track.stations[station].point - tip).norm();
        let beyond = [
            first.map_or(0.0, |tip| away(tip, longer.start)),
            last.map_or(0.0, |tip| away(tip, longer.end - 1)),
        ];
        let mut swept = sweep(surface, &mut track.stations[longer], beyond);
        if swept.is_none() {
            swept = sweep(surface, &mut track.stations[run.clone()], [0.0; 2]);
        }
        moved |= swept.is_some();
    }
    moved
}

/// From clean station to clean station without long gaps.
fn runs(stations: &[Station]) -> Vec<Range<usize>> {
    /// Distance of clean stations, in radii, between which other branches may take part.
    const GAP: f64 = 3.0;
    let mut found: Vec<Range<usize>> = Vec::new();
    for (i, station) in stations.iter().enumerate().filter(|(_, s)| s.sight == Sight::Clean) {
        let follows = |run: &&mut Range<usize>| {
            let before = &stations[run.end - 1];
            (station.point - before.point).norm() < GAP * before.section_radius
        };
        match found.last_mut().filter(follows) {
            Some(run) => run.end = i + 1,
            None => found.push(i..i + 1),
        }
    }
    found
}

/// Moves a run of stations to the middle of the tube through its wall; `None` where the wall is no such tube.
fn sweep(surface: &Surface, stations: &mut [Station], beyond: [f64; 2]) -> Option<()> {
    if stations.len() < STATIONS {
        return None;
    }
    let mut tube = SweptTube::of(stations, beyond);
    if !(tube.is_sound() && tube.tightest_bend() <= TIGHT && tube.flatness() <= FLAT) {
        return None;
    }
    let wall = wall_beside(surface, stations, &tube);
    if wall.len() < VERTICES {
        return None;
    }
    let (shape, centre) = fit_tube(&mut tube, &wall)?;
    let near = |(i, s): (usize, &Station)| (s.point - tube.points[i]).norm() <= MOVED * tube.shapes[i].x;
    // Told so that what is no number is refused as well.
    if !(tube.flatness() <= FLAT && stations.iter().enumerate().all(near)) {
        return None;
    }
    let trust = trust(stations, &tube, &centre);
    let lobes = lobes(&tube, &hear(&tube, &wall), shape.rung);
    for (i, station) in stations.iter_mut().enumerate() {
        place(station, &tube, i, trust, (shape.haze, lobes[i]));
    }
    Some(())
}

/// Fits shape and centre of a tube to its wall in turns, a few rounds; `None` where it becomes none.
fn fit_tube(tube: &mut SweptTube, wall: &[WallVertex]) -> Option<(Fitted, Fitted)> {
    let mut fitted: Option<(Fitted, Fitted)> = None;
    for round in 0..ROUNDS {
        let mut heard = hear(tube, wall);
        if round >= CHOOSING {
            doubt_unusual(tube, &mut heard);
        }
        let search = |before: Option<&Fitted>| match before {
            None => Search::Whole,
            Some(before) if round < CHOOSING => Search::From(before.rung),
            Some(before) => Search::Keep(before.rung),
        };
        let before = fitted.as_ref();
        let was_flat = before.is_some_and(|(shape, _)| shape.flat);
        let shape = fit_shape(tube, &heard, search(before.map(|(shape, _)| shape)), was_flat)?;
        tube.set_shapes(shape.curve.iter().map(|p| p.coords).collect());
        let centre = fit_centre(tube, &heard, search(before.map(|(_, centre)| centre)))?;
        tube.points.clone_from(&centre.curve);
        tube.settle();
        if !tube.is_sound() {
            return None;
        }
        fitted = Some((shape, centre));
    }
    fitted
}

/// Puts a station where the tube has it.
fn place(station: &mut Station, tube: &SweptTube, i: usize, trust: f64, (haze, lobes): (f64, f64)) {
    /// Short over mean half axis of the flattest wall: one station's ellipse may be no ellipse.
    const THIN: f64 = 0.05;
    station.point += (tube.points[i] - station.point) * trust;
    station.target = station.point;
    station.shape.mean = tube.shapes[i].x;
    station.shape.ellipse = tube.ellipse(i, &station.frame);
    let [x, y] = station.shape.ellipse;
    station.shape.nearest = (station.shape.mean - x.hypot(y)).max(THIN * station.shape.mean);
    station.shape.haze = haze;
    station.shape.lobes = lobes;
    station.shape.slope = tube.slope(i);
}

/// How far the middle of the tube is to be trusted against the middles of the sections, 0 to 1: by the variance that
/// either has left, over as much of the branch. Where the wall is no tube of ellipses, sections know better.
fn trust(stations: &[Station], tube: &SweptTube, centre: &Fitted) -> f64 {
    let clean = || stations.iter().filter(|s| s.sight == Sight::Clean);
    let count = clean().count().max(1) as f64;
    let across = |s: &Station| {
        let off = s.target - s.point;
        off - *s.tangent * s.tangent.dot(&off)
    };
    let squares: f64 = clean().map(|s| across(s).norm_squared()).sum();
    // Sections closer than the triangles are long cut the same ones, and err alike.
    let grain = clean().map(|s| s.shape.grain).sum::<f64>() / count;
    let apart = (tube.along[tube.along.len() - 1] / grain.max(f64::MIN_POSITIVE)).clamp(1.0, count);
    let sections = squares / (2.0 * count) / apart;
    let vertices = 2.0 * centre.left / (centre.count * (centre.count - centre.freedom).max(1.0));
    if sections > 0.0 { sections / (sections + vertices) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix3, Unit, Vector3};

    use super::*;
    use crate::centerline::connection::network::NetworkNode;
    use crate::centerline::laplacian_smoothing::branch::FIRM;
    use crate::centerline::laplacian_smoothing::continuation::Process;
    use crate::centerline::test_surfaces::{capsule, closed_surface};

    #[test]
    fn an_end_that_was_off_is_found_anew_where_the_branch_is_too_short_for_a_tube() {
        let surface = closed_surface(&capsule(1.0, 4.0, 40));
        let off = |z: f64| Point3::new(0.02 * z * z, 0.0, z);
        let station = |k: u32| {
            let z = 1.0 + 0.5 * f64::from(k);
            let mut station = Station::rough(off(z), Unit::new_normalize(Vector3::z()), 1.0, 0);
            // Its section says where the axis is.
            (station.target, station.weight, station.sight) =
                (Point3::new(0.0, 0.0, z), Matrix3::identity(), Sight::Clean);
            station
        };
        let node =
            |point: Point3<f64>| NetworkNode { vertex: 0, anchor: Some(Anchor { point, radius: 1.0 }) };
        let track = Track {
            chain: 0,
            from: 0,
            to: 1,
            rings: Vec::new(),
            stations: (0..STATIONS as u32 - 2).map(station).collect(),
            bulge: None,
            stiffness: FIRM,
            process: Process::default(),
        };
        let nodes = vec![node(off(-1.0)), node(Point3::new(0.8, 0.0, 4.6))];
        let mut network = Network { nodes, tracks: vec![track] };
        recenter_branches(&TriangleGrid::new(&surface), &mut network, &Control::silent()).unwrap();
        for (node, z) in [(0, -1.0), (1, 5.0)] {
            let end = network.nodes[node].anchor.unwrap().point;
            assert!((end - Point3::new(0.0, 0.0, z)).norm() < 0.02, "the end is at {end}");
        }
    }
}
