//! Branch or joint: the linearity of the centerline points around each (IV.C, eq. 5).

use nalgebra::Point3;
use rayon::prelude::*;

use crate::centerline::ExtractError;
use crate::centerline::control::{Control, Stage};
use crate::centerline::thinning::covariance::{Moments, PrincipalAxes};
use crate::centerline::thinning::point_cloud::PointCloud;

/// Eq. 5: `beta = l1 / (l1 + l2 + l3)` of the eigenvalues of the points' covariance: 1 on a line, 1/2 for an
/// even spread in a plane, 1/3 in space. One for points that all coincide.
pub fn linearity(axes: &PrincipalAxes) -> f64 {
    let sum: f64 = axes.values.iter().sum();
    if sum > 0.0 { axes.values[0] / sum } else { 1.0 }
}

/// The linearity at each point over the points of `cloud` closer than `radius(i)`, in the input's unit.
///
/// # Errors
/// [`ExtractError::Cancelled`].
pub fn linearities(
    points: &[Point3<f64>],
    cloud: &PointCloud,
    radius: impl Fn(usize) -> f64 + Sync,
    control: &Control<'_>,
) -> Result<Vec<f64>, ExtractError> {
    control.report(Stage::Thinning, 0.0)?;
    let one = |i: usize| {
        control.cancel.check()?;
        let mut around = Moments::default();
        cloud.for_each_within(&points[i], radius(i), |cell, _| around.extend(&cloud.cell(cell).moments));
        Ok(linearity(&around.principal_axes()))
    };
    (0..points.len()).into_par_iter().map(one).collect()
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;

    fn cloud_of(points: &[Point3<f64>], radius: f64) -> (PointCloud, Vec<f64>) {
        let cloud = PointCloud::new(points, &vec![radius; points.len()]);
        let values = linearities(points, &cloud, |_| radius, &Control::silent()).unwrap();
        (cloud, values)
    }

    #[test]
    fn a_line_is_one_a_disc_a_half_a_ball_a_third() {
        let line: Vec<_> =
            (0..200).map(|k| Point3::from(Vector3::new(1.0, 2.0, 2.0) * f64::from(k) * 0.01)).collect();
        assert!(cloud_of(&line, 1.0).1.iter().all(|beta| (beta - 1.0).abs() < 1e-9));
        let lattice = |depth: i32| -> Vec<Point3<f64>> {
            let cell = |x: i32, y: i32, z: i32| Point3::new(f64::from(x), f64::from(y), f64::from(z)) * 0.05;
            (-30..=30)
                .flat_map(|x| (-30..=30).flat_map(move |y| (-depth..=depth).map(move |z| cell(x, y, z))))
                .collect()
        };
        for (depth, expected) in [(0, 0.5), (12, 1.0 / 3.0)] {
            let points = lattice(depth);
            let middle = points.iter().position(|p| p.coords.norm() < 1e-9).unwrap();
            let cloud = PointCloud::new(&points, &vec![0.6; points.len()]);
            let beta = linearities(&points[middle..=middle], &cloud, |_| 0.6, &Control::silent()).unwrap()[0];
            assert!((beta - expected).abs() < 0.02, "{beta}, not {expected}");
        }
    }

    #[test]
    fn only_the_crossing_of_two_lines_is_a_joint() {
        let arm = |direction: Vector3<f64>| {
            (-200..=200).map(move |k| Point3::from(direction * f64::from(k) * 0.02))
        };
        let points: Vec<_> = arm(Vector3::x()).chain(arm(Vector3::new(0.2, 1.0, 0.0).normalize())).collect();
        let (_, values) = cloud_of(&points, 1.0);
        for (point, beta) in points.iter().zip(values) {
            match point.coords.norm() {
                far if far > 1.1 => assert!(beta > 0.95, "{beta} at {point}"),
                near if near < 0.3 => assert!(beta < 0.75, "{beta} at {point}"),
                _ => {}
            }
        }
    }
}
