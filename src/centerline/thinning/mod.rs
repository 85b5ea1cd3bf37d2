//! Thinning of the branches' centerline points (IV.C, eqs. 6-7, Algorithm 1).

pub mod covariance;
pub mod linearity;
pub mod point_cloud;

use std::f64::consts::PI;

use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

use crate::centerline::ExtractError;
use crate::centerline::control::{Control, Stage};
use crate::centerline::thinning::covariance::{Moments, PrincipalAxes};
use crate::centerline::thinning::point_cloud::PointCloud;

/// The neighbourhood never grows past this many times its first radius: where its points lie evenly to all
/// sides (a sac), Algorithm 1 as printed would not end.
const LARGEST_GROWTH: f64 = 3.0;

/// The constants of section V.A.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Thinning {
    /// `h`: first radius of the neighbourhood, in local radii.
    pub h: f64,
    /// `eps_h`: step of its growth, in local radii.
    pub eps_h: f64,
    /// `delta_h`: the correlation that ends the growth.
    pub delta_h: f64,
}

/// The kernel of eq. 6 over distance in units of the neighbourhood's radius: `sin(pi d) / (pi d)`, which falls
/// from 1 to 0 at the rim. (As printed, over a distance in the mesh's own unit, it is negative past 1.)
pub fn sinc(d: f64) -> f64 {
    let x = PI * d;
    if x >= PI {
        0.0
    } else if x < 1e-4 {
        1.0 - x * x / 6.0
    } else {
        x.sin() / x
    }
}

/// Eq. 7: the correlation of the points projected onto their two largest principal axes, after a turn by 45
/// degrees: `rho = (l1 - l2) / (l1 + l2)`. 1 on a line, 0 for an even spread. (On the axes themselves, as
/// printed, it is 0 by construction; the turn is that of the test's source, Lee 2000.) One where all coincide.
pub fn correlation(axes: &PrincipalAxes) -> f64 {
    let [first, second, _] = axes.values;
    if first + second > 0.0 { (first - second) / (first + second) } else { 1.0 }
}

/// Algorithm 1: each point where the filter of eq. 6 puts it, over the points of `cloud` in a neighbourhood
/// that grows by `eps_h` until it lies along a line. `radii` is the local radius at each point, in the
/// input's unit. Parallel over points.
///
/// # Errors
/// [`ExtractError::Cancelled`].
pub fn thin(
    points: &[Point3<f64>],
    cloud: &PointCloud,
    radii: &[f64],
    thinning: Thinning,
    control: &Control<'_>,
) -> Result<Vec<Point3<f64>>, ExtractError> {
    const BLOCK: usize = 8192;
    let mut thinned = Vec::with_capacity(points.len());
    for block in (0..points.len()).step_by(BLOCK) {
        control.report(Stage::Thinning, block as f64 / points.len() as f64)?;
        let one = |i: usize| {
            control.cancel.check()?;
            Ok(thin_one(&points[i], cloud, radii[i], thinning))
        };
        let range = block..(block + BLOCK).min(points.len());
        let found: Result<Vec<_>, ExtractError> = range.into_par_iter().map(one).collect();
        thinned.extend(found?);
    }
    control.report(Stage::Thinning, 1.0)?;
    Ok(thinned)
}

/// Steps 4 to 13 of Algorithm 1 for one point.
fn thin_one(point: &Point3<f64>, cloud: &PointCloud, radius: f64, thinning: Thinning) -> Point3<f64> {
    let largest = LARGEST_GROWTH * thinning.h;
    let mut h = thinning.h;
    loop {
        let mut around = Moments::default();
        cloud.for_each_within(point, h * radius, |cell, _| around.extend(&cloud.cell(cell).moments));
        if correlation(&around.principal_axes()) > thinning.delta_h || h >= largest {
            return filtered(point, cloud, h * radius);
        }
        h = (h + thinning.eps_h).min(largest);
    }
}

/// Eq. 6.
fn filtered(point: &Point3<f64>, cloud: &PointCloud, h: f64) -> Point3<f64> {
    let (mut sum, mut weight) = (Vector3::zeros(), 0.0);
    cloud.for_each_within(point, h, |id, distance| {
        let moments = &cloud.cell(id).moments;
        let sigma = sinc(distance / h) * moments.count();
        sum += moments.mean() * sigma;
        weight += sigma;
    });
    if weight > 0.0 { Point3::from(sum / weight) } else { *point }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PRINTED: Thinning = Thinning { h: 1.0, eps_h: 0.1, delta_h: 0.6 };

    fn noise(k: usize, scale: f64) -> Vector3<f64> {
        let part = |step: f64| ((k as f64 * step).fract() - 0.5) * scale;
        Vector3::new(0.0, part(0.618_034), part(0.414_214))
    }

    fn noisy_line(count: usize, scale: f64) -> Vec<Point3<f64>> {
        (0..count).map(|k| Point3::new(k as f64 * 0.02, 1.0, -1.0) + noise(k, scale)).collect()
    }

    fn off_axis(points: &[Point3<f64>]) -> f64 {
        let off = |p: &Point3<f64>| (p.y - 1.0).hypot(p.z + 1.0);
        (points.iter().map(|p| off(p).powi(2)).sum::<f64>() / points.len() as f64).sqrt()
    }

    #[test]
    fn the_kernel_is_one_at_the_centre_and_nothing_from_the_rim_on() {
        assert_eq!(sinc(0.0), 1.0);
        assert!((sinc(0.5) - 2.0 / PI).abs() < 1e-12);
        assert!((sinc(1e-5 / PI) - sinc(1.1e-4 / PI)).abs() < 1e-8);
        assert_eq!((sinc(1.0), sinc(1.5)), (0.0, 0.0));
        assert!((0..100).all(|k| sinc(f64::from(k) * 0.01) > sinc(f64::from(k + 1) * 0.01)));
    }

    #[test]
    fn a_noisy_line_becomes_a_thin_one() {
        let points = noisy_line(1000, 0.6);
        let cloud = PointCloud::new(&points, &[1.0]);
        let thinned = thin(&points, &cloud, &vec![1.0; 1000], PRINTED, &Control::silent()).unwrap();
        assert!(
            off_axis(&thinned) < 0.15 * off_axis(&points),
            "{} {}",
            off_axis(&thinned),
            off_axis(&points)
        );
        for (after, before) in thinned.iter().zip(&points).skip(100).take(800) {
            assert!((after.x - before.x).abs() < 0.1);
        }
    }

    #[test]
    fn a_ball_of_points_ends_the_loop() {
        let points: Vec<_> = (0..2000)
            .map(|k| {
                let k = f64::from(k);
                Point3::new((k * 0.755).fract(), (k * 0.5698).fract(), (k * 0.3437).fract())
            })
            .collect();
        let cloud = PointCloud::new(&points, &[0.2]);
        let strict = Thinning { delta_h: 0.999, ..PRINTED };
        let thinned = thin(&points, &cloud, &vec![0.2; 2000], strict, &Control::silent()).unwrap();
        assert!(thinned.iter().all(|p| p.iter().all(|c| (0.0..=1.0).contains(c))));
    }

    #[test]
    fn the_neighbourhood_grows_until_it_is_a_line() {
        // Two rows, 0.6 apart, of points 0.8 apart: within h = 1 a point sees three of its row, one of the other.
        let row = |k: i32| if k % 2 == 0 { 0.3 } else { -0.3 };
        let points: Vec<_> = (0..60).map(|k| Point3::new(f64::from(k / 2) * 0.8, row(k), 0.0)).collect();
        let cloud = PointCloud::new(&points, &[1.0]);
        let grown = thin_one(&points[30], &cloud, 1.0, Thinning { delta_h: 0.9, ..PRINTED });
        let fixed = thin_one(&points[30], &cloud, 1.0, Thinning { delta_h: 0.0, ..PRINTED });
        assert!(grown.y.abs() < fixed.y.abs(), "{} {}", grown.y, fixed.y);
    }

    #[test]
    fn the_unit_does_not_matter() {
        let scaled = |scale: f64| {
            let points: Vec<_> = noisy_line(300, 0.6).iter().map(|p| p * scale).collect();
            let cloud = PointCloud::new(&points, &[scale]);
            thin(&points, &cloud, &vec![scale; 300], PRINTED, &Control::silent()).unwrap()
        };
        for (a, b) in scaled(0.125).iter().zip(scaled(1.0)) {
            assert!((a.coords * 8.0 - b.coords).norm() < 1e-9);
        }
    }
}
