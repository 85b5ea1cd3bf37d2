//! Smoothing of a whole branch, and its sub-sampling into the points of the result (section IV.D).

use nalgebra::{Matrix3, Point3, Vector3};

use crate::centerline::cut_plane::wall_shape::WallShape;
use crate::centerline::laplacian_smoothing::curve_fit::{Stiffness, fit_curve};
use crate::centerline::segmentation::track::{SPACING, Sight, Station, Track, update_tangents};

/// Stiffness of a branch: waves shorter than about six radii are noise of the wall.
const STIFFNESS: Stiffness = Stiffness { third: 150.0, second: 0.02 };
/// Weight of a point that does not move.
const FIXED: f64 = 1e7;

/// A fixed end of a branch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Anchor {
    pub point: Point3<f64>,
    pub radius: f64,
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
    let fitted = fit_curve(&targets, &weights, &abscissa(&path), STIFFNESS);
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
    let fitted = fit_curve(&targets, &weights, &abscissa(&path), STIFFNESS);
    for (station, point) in track.stations.iter_mut().zip(&fitted[overlap..]) {
        station.point = *point;
    }
    let closed: Vec<Point3<f64>> =
        [n - 1].into_iter().chain(0..n).chain([0]).map(|i| track.stations[i].point).collect();
    for (station, tangent) in
        track.stations.iter_mut().zip(&crate::centerline::segmentation::track::tangents(&closed)[1..])
    {
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

/// The result's points and inscribed sphere radii: the stations and one point between each two, on a
/// cubic through them.
pub fn subsample(points: &[Point3<f64>], radii: &[f64]) -> (Vec<Point3<f64>>, Vec<f64>) {
    let n = points.len();
    let mut fine = (Vec::with_capacity(2 * n), Vec::with_capacity(2 * n));
    let slope = |i: usize| -> Vector3<f64> {
        let (a, b) = (i.saturating_sub(1), (i + 1).min(n - 1));
        let length = (points[i] - points[a]).norm() + (points[b] - points[i]).norm();
        (points[b] - points[a]) / length.max(f64::MIN_POSITIVE)
    };
    for i in 0..n {
        fine.0.push(points[i]);
        fine.1.push(radii[i]);
        if i + 1 < n {
            let chord = (points[i + 1] - points[i]).norm();
            // Cubic Hermite at the middle.
            let middle = nalgebra::center(&points[i], &points[i + 1]);
            // The end slopes of a polyline are chords: there the curve stays on the chord.
            let bend = if i == 0 || i + 2 == n { Vector3::zeros() } else { slope(i) - slope(i + 1) };
            fine.0.push(middle + bend * (chord / 8.0));
            fine.1.push(0.5 * (radii[i] + radii[i + 1]));
        }
    }
    fine
}

/// Inscribed sphere radii of a branch's stations: clean sections averaged over their neighbours, what
/// lies between them interpolated.
pub fn settle_radii(stations: &mut [Station]) {
    const WEIGHTS: [f64; 2] = [3.0, 1.0];
    let n = stations.len();
    let clean: Vec<bool> = stations.iter().map(|s| s.sight == Sight::Clean).collect();
    let radii: Vec<Option<f64>> = (0..n)
        .map(|i| {
            let near = (i.saturating_sub(1)..(i + 2).min(n)).filter(|&j| clean[j]);
            let shapes = near.map(|j| (WEIGHTS[i.abs_diff(j)], &stations[j].shape));
            clean[i].then(|| WallShape::average(shapes).inscribed())
        })
        .collect();
    for (i, station) in stations.iter_mut().enumerate() {
        let before = (0..=i).rev().find_map(|j| radii[j].map(|r| (i - j, r)));
        let after = (i..n).find_map(|j| radii[j].map(|r| (j - i, r)));
        station.radius = match (before, after) {
            (Some((0, r)), _) => r,
            (Some((a, r)), Some((b, q))) => (r * b as f64 + q * a as f64) / (a + b) as f64,
            (Some((_, r)), None) | (None, Some((_, r))) => r,
            (None, None) => station.radius,
        };
    }
}
