//! Sub-sampling of a branch into the points of the result (section IV.D), and its radii.

use nalgebra::{Point3, Vector3};

use crate::centerline::cut_plane::wall_shape::WallShape;
use crate::centerline::segmentation::track::{Sight, Station};

/// A fixed end of a branch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Anchor {
    pub point: Point3<f64>,
    pub radius: f64,
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
