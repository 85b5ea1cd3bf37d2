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

    /// The wall swept by spheres along the curve: between the corners of [`Self::pieces`] cones that touch both spheres.
    pub fn wall(&self) -> LimbWall {
        let corners = self.pieces();
        let grows = (self.radii[1] - self.radii[0]) / Self::PIECES as f64;
        let cone = |number: usize| {
            let step = corners[number + 1] - corners[number];
            let square = step.norm_squared().max(f64::MIN_POSITIVE);
            let slant = grows / (square * (square - grows * grows).max(0.01 * square)).sqrt();
            let radius = self.radii[0] + grows * number as f64;
            let reach = 0.5 * square.sqrt() + radius.max(radius + grows);
            Cone { from: corners[number], step, square, slant, radius, reach }
        };
        LimbWall { cones: std::array::from_fn(cone), grows }
    }
}

/// One piece of a limb's wall.
#[derive(Debug, Clone, Copy)]
struct Cone {
    from: Point3<f64>,
    step: Vector3<f64>,
    /// Square of its length.
    square: f64,
    /// How far up the axis a wall place's sphere sits, by its distance from the axis, in lengths of the piece.
    slant: f64,
    /// At its start.
    radius: f64,
    /// No place of its wall is farther from its middle.
    reach: f64,
}

/// The wall of a limb, made ready to be asked for many points.
#[derive(Debug, Clone, Copy)]
pub struct LimbWall {
    cones: [Cone; Limb::PIECES],
    /// How much the radius grows along each.
    grows: f64,
}

impl LimbWall {
    /// The place that is nearest to `point`. `near`: the parameter of a place that may be close, which saves looking at
    /// most of the others.
    pub fn foot(&self, point: &Point3<f64>, near: f64) -> Foot {
        let first = ((near * Limb::PIECES as f64) as usize).min(Limb::PIECES - 1);
        let (mut number, mut share, mut arm, mut outside) = self.beside(first, point);
        for other in (0..Limb::PIECES).filter(|&other| other != first) {
            let cone = &self.cones[other];
            // What cannot be nearer need not be looked at.
            let least = outside + cone.reach;
            if least < 0.0 || (point - cone.from - cone.step * 0.5).norm_squared() > least * least {
                continue;
            }
            let found = self.beside(other, point);
            if found.3 < outside {
                (number, share, arm, outside) = found;
            }
        }
        Self::placed(number, share, arm, outside)
    }

    /// The same, looked for downhill from `near` alone: for a point whose place is known but for a small move.
    pub fn foot_near(&self, point: &Point3<f64>, near: f64) -> Foot {
        let first = ((near * Limb::PIECES as f64) as usize).min(Limb::PIECES - 1);
        let mut best = self.beside(first, point);
        for step in [-1, 1] {
            while let Some(next) = best.0.checked_add_signed(step).filter(|&next| next < Limb::PIECES) {
                let found = self.beside(next, point);
                if found.3 >= best.3 {
                    break;
                }
                best = found;
            }
        }
        let (number, share, arm, outside) = best;
        Self::placed(number, share, arm, outside)
    }

    fn placed(number: usize, share: f64, arm: Vector3<f64>, outside: f64) -> Foot {
        let ends = [number, number + 1].map(|end| Limb::basis(end as f64 / Limb::PIECES as f64));
        let basis = std::array::from_fn(|k| ends[0][k] * (1.0 - share) + ends[1][k] * share);
        let t = (number as f64 + share) / Limb::PIECES as f64;
        Foot { outside, t, basis, direction: arm / arm.norm().max(f64::MIN_POSITIVE) }
    }

    /// The nearest place of one cone: its number, the share of it, the arm from there to the point, and the distance.
    fn beside(&self, number: usize, point: &Point3<f64>) -> (usize, f64, Vector3<f64>, f64) {
        let cone = &self.cones[number];
        let from = point - cone.from;
        let beside = from.dot(&cone.step) / cone.square;
        // The nearest place of a cone's wall belongs to a sphere toward its wide end.
        let wider = cone.slant * (from - cone.step * beside).norm();
        let share = (beside + wider).clamp(0.0, 1.0);
        let arm = from - cone.step * share;
        (number, share, arm, arm.norm() - cone.radius - self.grows * share)
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
        let wall = limb.wall();
        let beyond = wall.foot(&at(6.0), 0.0);
        assert!((beyond.outside - 1.0).abs() < 1e-12 && beyond.t == 1.0);
        // The cone that touches both balls: its wall at distance h from the axis and place x lies (h - 1 - x / 3) cos
        // away, where the sine of its half angle is 1/3.
        let point = Point3::new(1.5, 2.5, 0.0);
        let beside = wall.foot(&point, 0.5);
        let expected = 2.5 * (8.0_f64 / 9.0).sqrt() - (1.0 + 1.5 / 3.0);
        assert!((beside.outside - expected).abs() < 1e-9, "{} is not {expected}", beside.outside);
    }

    #[test]
    fn the_foot_is_the_same_from_wherever_it_is_looked_for() {
        let at = |x: f64, y: f64| Point3::new(x, y, 0.1 * x * y);
        let limb =
            Limb { control: [at(0.0, 0.0), at(2.0, 0.0), at(3.0, 2.0), at(2.0, 4.0)], radii: [1.0, 0.6] };
        let wall = limb.wall();
        for i in 0..300 {
            let place = |k: f64| 8.0 * (f64::from(i) * k).fract() - 3.0;
            let point = Point3::new(place(0.618), place(0.414), place(0.732));
            let of = |near: usize| wall.foot(&point, near as f64 / 12.0).outside;
            let least =
                (0..Limb::PIECES).map(|piece| wall.beside(piece, &point).3).fold(f64::INFINITY, f64::min);
            assert!((0..=12).all(|near| (of(near) - least).abs() < 1e-12), "{point}");
        }
    }

    #[test]
    fn downhill_from_where_it_was_leads_to_where_it_is() {
        let at = |x: f64, y: f64| Point3::new(x, y, 0.1 * x * y);
        let limb = |bent: f64| {
            let control = [at(0.0, 0.0), at(2.0, 0.0), at(3.0, 2.0 + bent), at(2.0, 4.0 + bent)];
            Limb { control, radii: [1.0, 0.6] }.wall()
        };
        let (before, after) = (limb(0.0), limb(0.2));
        for i in 0..300 {
            let share = f64::from(i) / 300.0;
            let turn = std::f64::consts::TAU * (f64::from(i) * 0.618).fract();
            // Vertices lie about the wall.
            let axis =
                Limb { control: [at(0.0, 0.0), at(2.0, 0.0), at(3.0, 2.0), at(2.0, 4.0)], radii: [1.0, 0.6] };
            let point = axis.at(share) + Vector3::new(turn.cos(), 0.3, turn.sin()) * 0.8;
            let (known, found) =
                (after.foot(&point, 0.5), after.foot_near(&point, before.foot(&point, 0.5).t));
            assert!((known.outside - found.outside).abs() < 1e-12, "{point}");
        }
    }
}
