//! Smooth random curves: three arcs of equal length that run into each other.

use nalgebra::{Point3, Rotation3, Unit, Vector3};

use super::random::Random;

/// Distance between the points of a known line, in mm.
pub(super) const STEP: f64 = 0.1;

const ARCS: usize = 3;

/// A point to start from and the direction there.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pose {
    pub point: Point3<f64>,
    pub direction: Unit<Vector3<f64>>,
}

/// A curve of `length` from `start`, its points at equal distances of at most [`STEP`].
///
/// Each arc turns by at most `turn` radians about a random axis.
pub(super) fn wander(start: Pose, length: f64, turn: f64, random: &mut Random) -> Vec<Point3<f64>> {
    let per_arc = (length / STEP / ARCS as f64).ceil().max(1.0) as usize;
    let arc = length / ARCS as f64;
    let mut points = vec![start.point];
    let mut pose = start;
    for _ in 0..ARCS {
        let axis = random.perpendicular(&pose.direction);
        let angle = random.range(0.15 * turn, turn);
        let along = |share: f64| advance(pose, axis, angle / arc, share * arc);
        points.extend((1..=per_arc).map(|place| along(place as f64 / per_arc as f64).point));
        pose = along(1.0);
    }
    points
}

/// The pose after `distance` along an arc of `curvature` about `axis`, perpendicular to the direction.
fn advance(pose: Pose, axis: Unit<Vector3<f64>>, curvature: f64, distance: f64) -> Pose {
    let angle = curvature * distance;
    let ahead = pose.direction.into_inner();
    let aside = axis.cross(&ahead);
    let point = pose.point + ahead * (angle.sin() / curvature) + aside * ((1.0 - angle.cos()) / curvature);
    Pose { point, direction: turned(pose.direction, axis, angle) }
}

/// `direction` turned by `angle` about `axis`.
pub(super) fn turned(
    direction: Unit<Vector3<f64>>,
    axis: Unit<Vector3<f64>>,
    angle: f64,
) -> Unit<Vector3<f64>> {
    Unit::new_normalize(Rotation3::from_axis_angle(&axis, angle) * direction.into_inner())
}

/// The direction of a polyline at one of its points; of `points` at least two differ.
pub(super) fn direction(points: &[Point3<f64>], place: usize) -> Unit<Vector3<f64>> {
    let before = place.saturating_sub(1);
    let after = (place + 1).min(points.len() - 1);
    Unit::new_normalize(points[after] - points[before])
}

/// `function` sampled at equal parameters, finely enough for [`STEP`], from 0 to 1.
pub(super) fn sampled(length: f64, function: impl Fn(f64) -> Point3<f64>) -> Vec<Point3<f64>> {
    let count = (length / STEP).ceil().max(1.0) as usize;
    (0..=count).map(|place| function(place as f64 / count as f64)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_curve_has_its_length_its_start_and_even_steps() {
        let mut random = Random::new(3);
        let start = Pose { point: Point3::new(1.0, 2.0, 3.0), direction: Vector3::y_axis() };
        let points = wander(start, 25.0, 0.6, &mut random);
        assert_eq!(points[0], start.point);
        let steps: Vec<_> = points.windows(2).map(|pair| (pair[1] - pair[0]).norm()).collect();
        assert!(steps.iter().all(|step| (0.099..=STEP).contains(step)));
        assert!((steps.iter().sum::<f64>() - 25.0).abs() < 0.01);
        assert!(direction(&points, 0).angle(&Vector3::y_axis()) < 0.01);
    }

    #[test]
    fn a_curve_has_no_kink() {
        let start = Pose { point: Point3::origin(), direction: Vector3::x_axis() };
        for seed in 0..20 {
            let points = wander(start, 20.0, 0.8, &mut Random::new(seed));
            // An arc of 6.67 that turns by 0.8 turns by 0.012 in a step of 0.1.
            let bent = |triple: &[Point3<f64>]| (triple[1] - triple[0]).angle(&(triple[2] - triple[1]));
            assert!(points.windows(3).all(|triple| bent(triple) < 0.0125));
        }
    }
}
