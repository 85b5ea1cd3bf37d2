//! Re-centering of a branch by all of its wall's vertices (IV.D): the wall is taken for a tube whose centre and shape
//! change smoothly.
//!
//! A section hears only the triangles that it cuts, and its neighbour the same ones again. Here each vertex is heard
//! once, by the station next to it, and what the stations hear is smoothed along the branch, as stiffly as generalised
//! cross-validation asks for. So noise, stairs and coarse triangles average out over the whole branch. Centre and shape
//! are fitted in turns, each as a smooth curve in three dimensions
//! (see [`crate::centerline::laplacian_smoothing::curve_fit`]).

use std::ops::Range;

use nalgebra::{Matrix3, Point3, Vector3};
use rayon::prelude::*;

use crate::mesh::preparation::Surface;

use crate::centerline::connection::network::Network;
use crate::centerline::connection::subsampling::{Anchor, settle_radii};
use crate::centerline::cut_plane::wall_shape::FLAT;
use crate::centerline::laplacian_smoothing::branch::observe;
use crate::centerline::laplacian_smoothing::curve_fit::CurveFit;
use crate::centerline::recentering::ends::{end_point, follow_rings};
use crate::centerline::recentering::swept_tube::SweptTube;
use crate::centerline::recentering::swept_wall::{
    Heard, doubt_unusual, hear, outside, outside_circle, wall_beside,
};
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
/// Radius over radius of bend above which the wall inside the bend says nothing of the line.
const TIGHT: f64 = 0.6;

/// Re-centers every branch but sacs, and sets its radii; those of its ends too.
///
/// # Errors
/// [`ExtractError::Cancelled`].
pub fn recenter_branches(
    grid: &TriangleGrid<'_>,
    network: &mut Network,
    control: &Control<'_>,
) -> Result<(), ExtractError> {
    let surface = grid.surface();
    let tip = |node: usize| network.anchor(node).filter(|_| network.is_end(node)).map(|anchor| anchor.point);
    let tips: Vec<[Option<Point3<f64>>; 2]> =
        network.tracks.iter().map(|track| [tip(track.from), tip(track.to)]).collect();
    let one = |(track, tips): (&mut Track, [Option<Point3<f64>>; 2])| {
        control.cancel.check()?;
        // A ring has no ends that a smooth curve could be free at.
        let moved = track.bulge.is_none() && track.from != track.to && recenter(surface, track, tips);
        if moved {
            update_tangents(&mut track.stations);
            settle_radii(&mut track.stations);
            track.process = observe(&track.stations);
        }
        Ok(moved)
    };
    let work = network.tracks.par_iter_mut().zip(tips);
    let moved = work.map(one).collect::<Result<Vec<bool>, ExtractError>>()?;
    for node in 0..network.nodes.len() {
        let [(track, at_end)] = network.incident(node)[..] else { continue };
        if !moved[track] {
            continue;
        }
        let vertex = network.nodes[node].vertex;
        let end = network.oriented(track, at_end, |track| {
            follow_rings(grid, track, vertex);
            settle_radii(&mut track.stations);
            end_point(grid, track, vertex)
        });
        network.nodes[node].anchor = Some(Anchor { point: end.point, radius: end.radius });
    }
    Ok(())
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
    let mut fitted: Option<(Fitted, Fitted)> = None;
    for round in 0..ROUNDS {
        let mut heard = hear(&tube, &wall);
        if round >= CHOOSING {
            doubt_unusual(&tube, &mut heard);
        }
        let search = |before: Option<&Fitted>| match before {
            None => Search::Whole,
            Some(before) if round < CHOOSING => Search::From(before.rung),
            Some(before) => Search::Keep(before.rung),
        };
        let before = fitted.as_ref();
        let shape =
            fit_shape(&tube, &heard, search(before.map(|(s, _)| s)), before.is_some_and(|(s, _)| s.flat))?;
        tube.shapes = shape.curve.iter().map(|p| p.coords).collect();
        let centre = fit_centre(&tube, &heard, search(before.map(|(_, centre)| centre)))?;
        tube.points.clone_from(&centre.curve);
        tube.settle();
        if !tube.is_sound() {
            return None;
        }
        fitted = Some((shape, centre));
    }
    let (shape, centre) = fitted?;
    let near = |(i, s): (usize, &Station)| (s.point - tube.points[i]).norm() <= MOVED * tube.shapes[i].x;
    // Told so that what is no number is refused as well.
    if !(tube.flatness() <= FLAT && stations.iter().enumerate().all(near)) {
        return None;
    }
    let trust = trust(stations, &tube, &centre);
    for (i, station) in stations.iter_mut().enumerate() {
        place(station, &tube, i, trust, shape.haze);
    }
    Some(())
}

/// Puts a station where the tube has it.
fn place(station: &mut Station, tube: &SweptTube, i: usize, trust: f64, haze: f64) {
    station.point += (tube.points[i] - station.point) * trust;
    station.target = station.point;
    station.shape.mean = tube.shapes[i].x;
    station.shape.ellipse = tube.ellipse(i, &station.frame);
    let [x, y] = station.shape.ellipse;
    station.shape.nearest = station.shape.mean - x.hypot(y);
    station.shape.haze = haze;
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

/// How stiff a curve may be; the stiffest first: of equal ones it is taken.
const LADDER: [f64; 8] = [2400.0, 300.0, 40.0, 6.0, 1.0, 0.2, 0.03, 0.005];

/// Which rungs of the ladder are tried.
#[derive(Debug, Clone, Copy)]
enum Search {
    Whole,
    /// From one to the better of its neighbours, as long as there is one.
    From(usize),
    Keep(usize),
}

/// A smooth curve through what the stations hear.
struct Fitted {
    curve: Vec<Point3<f64>>,
    /// Its stiffness' place on the ladder.
    rung: usize,
    /// Weighted squares that it leaves.
    left: f64,
    /// Unknowns that it uses up (trace of the hat matrix).
    freedom: f64,
    /// Vertices that were heard, by their weight.
    count: f64,
    /// Square of the second harmonic that noise alone would show.
    haze: f64,
    /// Whether it has an ellipse.
    flat: bool,
}

/// What is fitted: values at the stations, and how a vertex sees them.
struct Problem<'a, Row: Fn(&Heard) -> Vector3<f64>, Hold: Fn(usize) -> Matrix3<f64>> {
    tube: &'a SweptTube,
    heard: &'a [Heard],
    values: Vec<Point3<f64>>,
    /// Distance of a vertex from the tube that has these values.
    outside: fn(&SweptTube, &Heard) -> f64,
    /// Derivative of a vertex's distance by the values of its station.
    row: Row,
    /// What holds the values in directions that no vertex sees.
    hold: Hold,
    /// How many directions vertices see.
    seen: f64,
    /// Differences of this order are penalised: 2 keeps a taper, 3 an even bend.
    order: usize,
}

/// The shape along the tube: with an ellipse where that explains the vertices better than a circle, by the
/// Bayesian information criterion (Schwarz 1978). `was_flat`: what was chosen before, and stays if the stiffness does.
fn fit_shape(tube: &SweptTube, heard: &[Heard], search: Search, was_flat: bool) -> Option<Fitted> {
    let flat = Matrix3::from_diagonal(&Vector3::new(0.0, 1.0, 1.0));
    let circle = || {
        let values = tube.shapes.iter().map(|s| Point3::new(s.x, 0.0, 0.0)).collect();
        let (row, hold) = (|_: &Heard| Vector3::x(), |_| flat);
        let outside = outside_circle;
        Problem { tube, heard, values, outside, row, hold, seen: 1.0, order: 2 }.solve(search)
    };
    let ellipse = || {
        let values = tube.shapes.iter().map(|s| Point3::from(*s)).collect();
        let (row, hold) = (|h: &Heard| h.terms, |_| Matrix3::zeros());
        let fitted =
            Problem { tube, heard, values, outside, row, hold, seen: 3.0, order: 2 }.solve(search)?;
        Some(Fitted { flat: true, ..fitted })
    };
    if let Search::Keep(_) = search {
        return if was_flat { ellipse() } else { circle() };
    }
    let circle = circle()?;
    let Some(ellipse) = ellipse() else { return Some(circle) };
    let count: f64 = heard.iter().map(|h| h.weight).sum();
    let gain = |other: &Fitted| count * (circle.left / other.left.max(f64::MIN_POSITIVE)).ln();
    let price = (ellipse.freedom - circle.freedom) * count.ln();
    if gain(&ellipse) <= price {
        return Some(circle);
    }
    // A circle with a fourth harmonic is no vessel's shape: what it explains with as many unknowns, noise that
    // vertices share explains.
    let square = {
        let values = tube.shapes.iter().map(|s| Point3::new(s.x, 0.0, 0.0)).collect();
        let (row, hold) = (|h: &Heard| h.fourth(), |_| Matrix3::zeros());
        let outside = outside_circle;
        Problem { tube, heard, values, outside, row, hold, seen: 3.0, order: 2 }
            .solve(Search::Keep(ellipse.rung))
    };
    let noise = square.map_or(0.0, |square| gain(&square).max(0.0));
    Some(if gain(&ellipse) > price + noise { ellipse } else { circle })
}

/// The line along the middle of the tube; along itself nothing moves it.
fn fit_centre(tube: &SweptTube, heard: &[Heard], search: Search) -> Option<Fitted> {
    let along = |i: usize| tube.frames[i].t;
    let row = |h: &Heard| h.direction - along(h.station) * along(h.station).dot(&h.direction);
    let hold = |i: usize| along(i) * along(i).transpose();
    let values = tube.points.clone();
    Problem { tube, heard, values, outside, row, hold, seen: 2.0, order: 3 }.solve(search)
}

impl<Row: Fn(&Heard) -> Vector3<f64>, Hold: Fn(usize) -> Matrix3<f64>> Problem<'_, Row, Hold> {
    /// The curve as stiff as generalised cross-validation asks for; `None` where most stations hear no vertex.
    /// O(vertices).
    fn solve(&self, search: Search) -> Option<Fitted> {
        let n = self.values.len();
        let mut weights = vec![Matrix3::zeros(); n];
        let mut pulls = vec![Vector3::zeros(); n];
        let (mut squares, mut count) = (0.0, 0.0);
        for heard in self.heard {
            let (row, outside) = ((self.row)(heard), (self.outside)(self.tube, heard));
            weights[heard.station] += row * row.transpose() * heard.weight;
            pulls[heard.station] += row * (outside * heard.weight);
            squares += outside * outside * heard.weight;
            count += heard.weight;
        }
        let mean = weights.iter().map(Matrix3::trace).sum::<f64>() / (self.seen * n as f64);
        let heard = weights.iter().filter(|weight| weight.trace() > 0.0).count();
        if 2 * heard < n {
            return None;
        }
        let left = |curve: &[Point3<f64>]| {
            let one = |i: usize| {
                let moved = curve[i] - self.values[i];
                moved.dot(&(weights[i] * moved)) - 2.0 * moved.dot(&pulls[i])
            };
            // Where nothing is left, rounding may leave less.
            (squares + (0..n).map(one).sum::<f64>()).max(0.0)
        };
        let targets: Vec<Point3<f64>> =
            (0..n).map(|i| self.values[i] + least_squares(&weights[i], &pulls[i])).collect();
        let scaled: Vec<Matrix3<f64>> = (0..n).map(|i| weights[i] / mean + (self.hold)(i)).collect();
        let fit = CurveFit::new(&targets, &scaled, &self.tube.along);
        let tried = |rung: usize| {
            let stiffness = LADDER[rung];
            let curve = self.curve(&fit, stiffness);
            let (left, freedom) = (left(&curve), self.seen * self.freedom(stiffness));
            let haze = 4.0 * left * freedom / self.seen / (count * count);
            Fitted { curve, rung, left, freedom, count, haze, flat: false }
        };
        match search {
            Search::Keep(rung) => Some(tried(rung)),
            Search::Whole => (0..LADDER.len()).map(tried).min_by(|a, b| a.score().total_cmp(&b.score())),
            Search::From(rung) => Some(better(tried(rung), tried)),
        }
    }

    fn curve(&self, fit: &CurveFit<'_>, stiffness: f64) -> Vec<Point3<f64>> {
        /// Keeps a bend that no vertex supports from swinging out.
        const SECOND: f64 = 1e-3;
        let (third, second) = if self.order == 3 { (stiffness, SECOND) } else { (0.0, stiffness) };
        fit.curve(|_| third, second)
    }

    /// Trace of the hat matrix for one of the seen directions, as on even spacing.
    fn freedom(&self, stiffness: f64) -> f64 {
        let n = self.values.len();
        let gain = |k: usize| {
            let wave = 2.0 - 2.0 * (std::f64::consts::PI * k as f64 / n as f64).cos();
            1.0 / (1.0 + stiffness * wave.powi(self.order as i32))
        };
        self.order as f64 + (self.order..n).map(gain).sum::<f64>()
    }
}

impl Fitted {
    /// Generalised cross-validation (Craven and Wahba 1979). An unknown counts 1.4, which keeps it from taking noise
    /// for shape (Kim and Gu 2004). Without bound where there are hardly more vertices than unknowns.
    fn score(&self) -> f64 {
        const PRICE: f64 = 1.4;
        const MOST: f64 = 0.9;
        let used = PRICE * self.freedom / self.count;
        if used < MOST { self.left / (1.0 - used).powi(2) } else { f64::INFINITY }
    }
}

/// From one rung upward, or where that is no better downward, as long as the next is better.
fn better(mut best: Fitted, tried: impl Fn(usize) -> Fitted) -> Fitted {
    let start = best.rung;
    for stiffer in (0..start).rev().map(&tried) {
        if stiffer.score() > best.score() {
            break;
        }
        best = stiffer;
    }
    for softer in (start + 1..if best.rung < start { 0 } else { LADDER.len() }).map(&tried) {
        if softer.score() >= best.score() {
            break;
        }
        best = softer;
    }
    best
}

/// The shortest step that makes the squares least: directions that nothing tells of stay.
fn least_squares(weight: &Matrix3<f64>, pull: &Vector3<f64>) -> Vector3<f64> {
    let inverse = weight.pseudo_inverse(1e-9 * weight.norm());
    inverse.map_or(Vector3::zeros(), |inverse| inverse * pull)
}
