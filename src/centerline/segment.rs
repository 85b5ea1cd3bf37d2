//! A piece of a straight line.

use nalgebra::Point3;

/// Distance of a point from the segment between `a` and `b`.
pub fn from_segment(point: &Point3<f64>, a: &Point3<f64>, b: &Point3<f64>) -> f64 {
    let along = b - a;
    let share = (point - a).dot(&along) / along.norm_squared().max(f64::MIN_POSITIVE);
    (point - (a + along * share.clamp(0.0, 1.0))).norm()
}
