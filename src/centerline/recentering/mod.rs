//! Re-centering of the branches' centerline points, and the collapse of a joint's to its centre (IV.D, eq. 10).

pub mod approach;
pub mod displaced;
pub mod ends;
pub mod hidden_radii;
pub mod joint_collapse;
pub mod joint_fit;
pub mod joints;
pub mod limb;
pub mod lobes;
pub mod meeting;
pub mod sweep;
pub mod swept_fit;
pub mod swept_tube;
pub mod swept_wall;
pub mod union_fit;

use nalgebra::Point3;
use rayon::prelude::*;

use crate::centerline::ExtractError;
use crate::centerline::control::{Control, Stage};
use crate::centerline::cut_plane::normal_lines::NormalLines;
use crate::centerline::thinning::point_cloud::PointCloud;

/// Each point as eq. 10 puts it over all vertices on the cut planes of the points of `cloud` closer than its
/// entry of `reach` (in the input's unit).
///
/// `lines[i]` are the normal lines of the cut plane of the cloud's point `i`. A vertex on several planes counts
/// on each. A point moves across its line only as far as `reach`: near a cap, where lines run along the axis,
/// the solution may lie anywhere on it. Parallel over points.
///
/// # Errors
/// [`ExtractError::Cancelled`].
pub fn recenter(
    points: &[Point3<f64>],
    cloud: &PointCloud,
    lines: &[NormalLines],
    reach: &[f64],
    control: &Control<'_>,
) -> Result<Vec<Point3<f64>>, ExtractError> {
    control.report(Stage::Recentering, 0.0)?;
    let sums = cloud.gather(|sum: &mut NormalLines, i| sum.extend(&lines[i]));
    let one = |i: usize| {
        control.cancel.check()?;
        let mut around = NormalLines::default();
        cloud.for_each_within(&points[i], reach[i], |id, _| around.extend(&sums[id.level][id.index]));
        let found = around.nearest_point().unwrap_or(points[i]);
        Ok(points[i] + (found - points[i]).cap_magnitude(reach[i]))
    };
    let recentered = (0..points.len()).into_par_iter().map(one).collect::<Result<Vec<_>, ExtractError>>()?;
    control.report(Stage::Recentering, 1.0)?;
    Ok(recentered)
}

/// The one centre of a joint: eq. 10 over all vertices on any cut plane of its points. `None` for no lines.
pub fn joint_centre<'a>(lines: impl IntoIterator<Item = &'a NormalLines>) -> Option<Point3<f64>> {
    let mut all = NormalLines::default();
    lines.into_iter().for_each(|set| all.extend(set));
    all.nearest_point()
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use nalgebra::Vector3;

    use super::*;

    /// The normal lines of a ring of a tube of radius 1 around `centre`, perpendicular to `axis`.
    fn ring(centre: Point3<f64>, axis: Vector3<f64>) -> NormalLines {
        let u = axis.cross(&Vector3::new(0.3, 0.5, 0.9)).normalize();
        let w = axis.cross(&u);
        let mut lines = NormalLines::default();
        for k in 0..24 {
            let normal = u * (TAU * f64::from(k) / 24.0).cos() + w * (TAU * f64::from(k) / 24.0).sin();
            lines.add(centre + normal, normal);
        }
        lines
    }

    #[test]
    fn points_that_smoothing_pushed_aside_come_back_to_the_axis() {
        let axis: Vec<_> = (0..100).map(|k| Point3::new(f64::from(k) * 0.1, 2.0, 3.0)).collect();
        let lines: Vec<_> = axis.iter().map(|centre| ring(*centre, Vector3::x())).collect();
        let pushed: Vec<_> = axis.iter().map(|p| p + Vector3::new(0.0, 0.15, -0.1)).collect();
        let cloud = PointCloud::new(&pushed, &[0.5]);
        let back = recenter(&pushed, &cloud, &lines, &[0.5; 100], &Control::silent()).unwrap();
        for (after, before) in back.iter().zip(&axis) {
            assert!((after.y - 2.0).hypot(after.z - 3.0) < 1e-9, "{after}");
            assert!((after.x - before.x).abs() < 0.35);
        }
    }

    #[test]
    fn the_lines_of_three_tubes_meet_in_the_centre_of_their_joint() {
        let centre = Point3::new(1.0, -2.0, 0.5);
        let arms = [0.0, 120.0, 240.0f64].map(|angle| {
            let (sin, cos) = angle.to_radians().sin_cos();
            Vector3::new(cos, sin, 0.0)
        });
        let lines: Vec<_> =
            arms.iter().flat_map(|arm| [1.0, 1.5].map(|along| ring(centre + arm * along, *arm))).collect();
        assert!((joint_centre(&lines).unwrap() - centre).norm() < 1e-9);
        assert_eq!(joint_centre(&[]), None);
    }
}
