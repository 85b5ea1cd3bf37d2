//! Smoothing of a whole branch: as stiff as the noise of its own sections asks for, no stiffer.

use nalgebra::{Matrix3, Point3};

use crate::centerline::connection::subsampling::Anchor;
use crate::centerline::segmentation::track::{SPACING, Sight, Station, Track, tangents, update_tangents};

use super::continuation::Process;
use super::curve_fit::{CurveFit, fit_curve};

/// Stiffness where no section is clean: waves shorter than about six radii are noise of the wall.
pub const FIRM: f64 = 150.0;
/// Weight of the squared second differences: keeps unsupported stretches from swinging out.
const SECOND: f64 = 0.02;
/// Weight of a point that does not move.
const FIXED: f64 = 1e7;

/// The weight of the third differences that predicts the branch's clean sections best from their
/// neighbours: generalised cross-validation (Craven and Wahba 1979) over a ladder.
///
/// The trace of the hat matrix is that of even spacing.
pub fn choose_stiffness(stations: &[Station]) -> f64 {
    const LADDER: [f64; 6] = [0.5, 2.0, 8.0, 30.0, FIRM, 600.0];
    /// Fewer sections say nothing of their noise.
    const LEAST: usize = 12;
    let clean: Vec<&Station> = stations.iter().filter(|s| s.sight == Sight::Clean).collect();
    let n = clean.len();
    if n < LEAST {
        return FIRM;
    }
    let targets: Vec<Point3<f64>> = clean.iter().map(|s| s.target).collect();
    let along = abscissa(&targets);
    let spacing = along[n - 1] / (n - 1) as f64;
    let grain = clean.iter().map(|s| s.shape.grain).sum::<f64>() / n as f64;
    let weights = vec![Matrix3::identity(); n];
    let fit = CurveFit::new(&targets, &weights, &along);
    let score = |stiffness: f64| {
        let fitted = fit.curve(|_| stiffness, 0.0);
        let left: f64 = fitted.iter().zip(&targets).map(|(p, q)| (p - q).norm_squared()).sum();
        let gain = |k: usize| {
            let wave = 2.0 - 2.0 * (std::f64::consts::PI * k as f64 / n as f64).cos();
            1.0 / (1.0 + stiffness * wave.powi(3))
        };
        let trace: f64 = (0..n).map(gain).sum();
        left / (1.0 - trace / n as f64).powi(2)
    };
    let scored = LADDER.map(|stiffness| (stiffness, score(stiffness)));
    let best = scored.into_iter().min_by(|a, b| a.1.total_cmp(&b.1)).map_or(FIRM, |(stiffness, _)| stiffness);
    best.max(least_stiffness(grain / spacing))
}

/// How the branch bends and how noisy its clean sections are. Sections that cut the same triangles err alike:
/// of those only one is heard.
pub fn observe(stations: &[Station]) -> Process {
    let mut heard: Vec<&Station> = Vec::new();
    for station in stations.iter().filter(|s| s.sight == Sight::Clean) {
        let far = |last: &&Station| (station.target - last.target).norm() > station.shape.grain;
        if heard.last().is_none_or(far) {
            heard.push(station);
        }
    }
    Process::of(&heard.iter().map(|s| (s.target, s.section_radius)).collect::<Vec<_>>())
}

/// The stiffness that halves waves of [`WAVE`] triangles, `grain` stations each: sections that cut the
/// same triangles err alike, which cross-validation takes for shape.
fn least_stiffness(grain: f64) -> f64 {
    /// Length of the shortest wave that triangles can show.
    const WAVE: f64 = 6.0;
    let angle = (std::f64::consts::PI / (WAVE * grain).max(2.0)).sin();
    (2.0 * angle).powi(-6).min(FIRM)
}

/// Per third difference: the branch's own stiffness among clean sections, firm where others take part.
///
/// `skip`: how many points stand before the first station.
fn stiffness_along(track: &Track, skip: usize) -> impl Fn(usize) -> f64 {
    let own = track.stiffness;
    let clean: Vec<bool> = track.stations.iter().map(|s| s.sight == Sight::Clean).collect();
    move |first: usize| {
        let touched = (first..first + 4).map(|i| i.checked_sub(skip).and_then(|i| clean.get(i)));
        if touched.flatten().all(|&clean| clean) { own } else { own.max(FIRM) }
    }
}

/// Moves the stations onto a smooth curve between the anchors (either may be missing).
pub fn smooth(track: &mut Track, from: Option<Anchor>, to: Option<Anchor>) {
    thin_out(&mut track.stations, from, to);
    let mut targets: Vec<Point3<f64>> = Vec::with_capacity(track.stations.len() + 2);
    let mut weights = Vec::with_capacity(targets.capacity());
    let mut push = |point: Point3<f64>, weight: Matrix3<f64>| {
        targets.push(point);
        weights.push(weight);
    };
    if let Some(anchor) = from {
        push(anchor.point, Matrix3::identity() * FIXED);
    }
    for station in &track.stations {
        push(station.target, station.weight);
    }
    if let Some(anchor) = to {
        push(anchor.point, Matrix3::identity() * FIXED);
    }
    let path = track.stations.iter().map(|s| s.point);
    let path: Vec<Point3<f64>> =
        from.map(|a| a.point).into_iter().chain(path).chain(to.map(|a| a.point)).collect();
    let third = stiffness_along(track, usize::from(from.is_some()));
    let fitted = fit_curve(&targets, &weights, &abscissa(&path), third, SECOND);
    let skip = usize::from(from.is_some());
    for (station, point) in track.stations.iter_mut().zip(&fitted[skip..]) {
        station.point = *point;
    }
    update_tangents(&mut track.stations);
}

/// Smooths a ring without junctions: its two ends are the same place.
pub fn smooth_ring(track: &mut Track) {
    let n = track.stations.len();
    if n < 8 {
        return;
    }
    let overlap = n.min(12);
    let places: Vec<usize> = (n - overlap..n).chain(0..n).chain(0..overlap).collect();
    let targets: Vec<_> = places.iter().map(|&i| track.stations[i].target).collect();
    let weights: Vec<_> = places.iter().map(|&i| track.stations[i].weight).collect();
    let path: Vec<_> = places.iter().map(|&i| track.stations[i].point).collect();
    let fitted = fit_curve(&targets, &weights, &abscissa(&path), |_| track.stiffness, SECOND);
    for (station, point) in track.stations.iter_mut().zip(&fitted[overlap..]) {
        station.point = *point;
    }
    let closed: Vec<Point3<f64>> =
        [n - 1].into_iter().chain(0..n).chain([0]).map(|i| track.stations[i].point).collect();
    for (station, tangent) in track.stations.iter_mut().zip(&tangents(&closed)[1..]) {
        station.tangent = *tangent;
    }
}

/// Drops stations that crowd their predecessor or an anchor: divided differences need distance.
fn thin_out(stations: &mut Vec<Station>, from: Option<Anchor>, to: Option<Anchor>) {
    const CROWD: f64 = 0.3 * SPACING;
    let mut previous = from.map(|anchor| anchor.point);
    stations.retain(|station| {
        let far = previous.is_none_or(|p| (station.point - p).norm() > CROWD * station.section_radius);
        if far {
            previous = Some(station.point);
        }
        far
    });
    if let Some(anchor) = to {
        while stations.len() > 1
            && stations.last().is_some_and(|s| (s.point - anchor.point).norm() < CROWD * s.section_radius)
        {
            stations.pop();
        }
    }
}

/// Length along a path at each of its points, strictly ascending.
fn abscissa(path: &[Point3<f64>]) -> Vec<f64> {
    let total: f64 = path.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum();
    let least = 1e-6 * total.max(f64::MIN_POSITIVE);
    let mut s = 0.0;
    let mut along = vec![0.0];
    for pair in path.windows(2) {
        s += (pair[1] - pair[0]).norm().max(least);
        along.push(s);
    }
    along
}
