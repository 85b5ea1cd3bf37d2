//! One branch's way from its last firm section to a joint's centre: a cubic curve with a radius.

use nalgebra::{Point3, Vector3};

/// A cubic Bezier curve whose first two control points stand firm; its radius changes evenly.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limb {
    pub control: [Point3<f64>; 4],
    /// At its start and at the joint.
    pub radii: [f64; 2],
}

/// The place of a limb's wall that is nearest to a point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Foot {
    /// Distance of the point from the wall, positive outside.
    pub outside: f64,
    /// Parameter on the curve, 0 to 1.
    pub t: f64,
    /// How the place moves with each of the control points.
    pub basis: [f64; 4],
    /// Unit direction from the curve to the point.
    pub direction: Vector3<f64>,
}

impl Limb {
    /// Pieces that the curve is taken for straight in.
    const PIECES: usize = 12;

    /// Bernstein polynomials of degree three.
    pub fn basis(t: f64) -> [f64; 4] {
        let u = 1.0 - t;
        [u * u * u, 3.0 * u * u * t, 3.0 * u * t * t, t * t * t]
    }

    pub fn at(&self, t: f64) -> Point3<f64> {
        let sum: Vector3<f64> = Self::basis(t).iter().zip(&self.control).map(|(b, q)| q.coords * *b).sum();
        Point3::from(sum)
    }

    /// Derivative by the parameter.
    pub fn slope(&self, t: f64) -> Vector3<f64> {
        let u = 1.0 - t;
        let q = &self.control;
        (q[1] - q[0]) * (3.0 * u * u) + (q[2] - q[1]) * (6.0 * u * t) + (q[3] - q[2]) * (3.0 * t * t)
    }

    pub fn radius(&self, t: f64) -> f64 {
        self.radii[0] + (self.radii[1] - self.radii[0]) * t
    }

    pub fn length(&self) -> f64 {
        let points = self.pieces();
        points.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum()
    }

    /// The corners of its straight pieces.
    pub fn pieces(&self) -> [Point3<f64>; Self::PIECES + 1] {
        std::array::from_fn(|i| self.at(i as f64 / Self::PIECES as f64))
    }

    /// The nearest place of the wall swept by spheres along `pieces`: each a cone that touches the spheres at its ends.
    pub fn foot(&self, pieces: &[Point3<f64>], point: &Point3<f64>) -> Foot {
        let grows = (self.radii[1] - self.radii[0]) / Self::PIECES as f64;
        let mut best = Foot { outside: f64::INFINITY, t: 0.0, basis: [0.0; 4], direction: Vector3::zeros() };
        for (number, pair) in pieces.windows(2).enumerate() {
            let step = pair[1] - pair[0];
            let square = step.norm_squared().max(f64::MIN_POSITIVE);
            let beside = (point - pair[0]).dot(&step) / square;
            let across = (point - pair[0] - step * beside).norm();
            // The nearest place of a cone's wall belongs to a sphere toward its wide end.
            let wider = grows * across / (square * (square - grows * grows).max(0.01 * square)).sqrt();
            let share = (beside + wider).clamp(0.0, 1.0);
            let t = (number as f64 + share) / Self::PIECES as f64;
            let arm = point - (pair[0] + step * share);
            let length = arm.norm();
            let outside = length - self.radius(t);
            if outside < best.outside {
                let ends = [number, number + 1].map(|end| Self::basis(end as f64 / Self::PIECES as f64));
                let basis = std::array::from_fn(|k| ends[0][k] * (1.0 - share) + ends[1][k] * share);
                best = Foot { outside, t, basis, direction: arm / length.max(f64::MIN_POSITIVE) };
            }
        }
        best
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_straight_limb_is_a_cone_with_a_ball_at_its_end() {
        let at = |x: f64| Point3::new(x, 0.0, 0.0);
        let limb = Limb { control: [at(0.0), at(1.0), at(2.0), at(3.0)], radii: [1.0, 2.0] };
        assert!((limb.length() - 3.0).abs() < 1e-12 && (limb.radius(0.5) - 1.5).abs() < 1e-12);
        assert!(
            (limb.at(0.5) - at(1.5)).norm() < 1e-12 && (limb.slope(0.3) - Vector3::x() * 3.0).norm() < 1e-12
        );
        let pieces = limb.pieces();
        let beyond = limb.foot(&pieces, &at(6.0));
        assert!((beyond.outside - 1.0).abs() < 1e-12 && beyond.t == 1.0);
        // The cone that touches both balls: its wall at distance h from the axis and place x lies (h - 1 - x / 3) cos
        // away, where the sine of its half angle is 1/3.
        let point = Point3::new(1.5, 2.5, 0.0);
        let beside = limb.foot(&pieces, &point);
        let expected = 2.5 * (8.0_f64 / 9.0).sqrt() - (1.0 + 1.5 / 3.0);
        assert!((beside.outside - expected).abs() < 1e-9, "{} is not {expected}", beside.outside);
    }
}
