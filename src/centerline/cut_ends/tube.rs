//! The tube that a branch would go on as past one of its points: along the arc of a circle, with the section that it
//! has there.

use std::f64::consts::TAU;

use nalgebra::{Point2, Point3, Unit, Vector2, Vector3};

use crate::centerline::cut_plane::section::{Frame, Profile, Section};
use crate::centerline::graph::Branch;
use crate::centerline::laplacian_smoothing::curve_fit::CurveEnd;
use crate::centerline::own_sections::{section_around, tangent};
use crate::centerline::triangle_grid::TriangleGrid;

/// A tube that begins at a point of a branch.
#[derive(Debug, Clone)]
pub struct Tube {
    /// Across the branch where the tube begins; `t` leads on.
    pub frame: Frame,
    /// Radius of the circle that has the section's area.
    pub radius: f64,
    /// Toward the middle of the arc, one over its radius long.
    bend: Vector3<f64>,
    /// Distance of the wall in the frame.
    wall: Profile,
    /// By what share of itself the section widens over one unit of length.
    widening: f64,
}

/// Where a point lies in a tube.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Place {
    /// Way along the axis.
    pub along: f64,
    /// Distance from the axis over that of the wall.
    pub share: f64,
    /// Distance of the wall.
    pub wall: f64,
}

impl Tube {
    /// That of `branch` past its point number `place`, toward its last point; `None` where no section is closed around
    /// that point.
    pub fn past(grid: &TriangleGrid<'_>, branch: &Branch, place: usize) -> Option<Self> {
        /// How far back the branch tells its bend, and how it widens, in radii.
        const BACK: f64 = 3.0;
        /// Most that a vessel widens a radius.
        const STEEP: f64 = 0.15;
        let (cut, _, radius) = section_around(grid, &branch.points[place], tangent(branch, place)?)?;
        let curve = CurveEnd::of(&branch.points[..=place], BACK * radius)?;
        let frame = Frame::new(branch.points[place], Unit::new_normalize(curve.tangent), cut.frame.u);
        let back = (0..place).rev().find(|&i| (branch.points[i] - frame.origin).norm() > BACK * radius);
        let back = back.unwrap_or(0);
        let grown = branch.radii[place] / branch.radii[back].max(f64::MIN_POSITIVE) - 1.0;
        let widening = grown / (branch.points[back] - frame.origin).norm();
        let most = STEEP / radius;
        let widening = if widening.is_finite() { widening.clamp(-most, most) } else { 0.0 };
        let wall = wall_around(&cut, &frame)?;
        Some(Self { frame, radius, bend: curve.curvature, wall, widening })
    }

    /// The axis and its direction, `along` from where the tube begins.
    pub fn at(&self, along: f64) -> (Point3<f64>, Vector3<f64>) {
        let Frame { origin, t, .. } = self.frame;
        let curvature = self.bend.norm();
        let angle = curvature * along;
        if !self.is_bent(curvature) {
            return (origin + t * along, t);
        }
        let inward = self.bend / curvature;
        let arm = t * angle.sin() + inward * (1.0 - angle.cos());
        (origin + arm / curvature, t * angle.cos() + inward * angle.sin())
    }

    pub fn place(&self, point: &Point3<f64>) -> Place {
        let Frame { origin, u, v, t } = self.frame;
        let arm = point - origin;
        let curvature = self.bend.norm();
        let (along, across) = if self.is_bent(curvature) {
            let inward = self.bend / curvature;
            let (ahead, aside) = (arm.dot(&t), 1.0 / curvature - arm.dot(&inward));
            let toward = 1.0 / curvature - ahead.hypot(aside);
            let square = arm - t * ahead - inward * arm.dot(&inward);
            (ahead.atan2(aside) / curvature, square + inward * toward)
        } else {
            (arm.dot(&t), arm - t * arm.dot(&t))
        };
        let flat = Vector2::new(across.dot(&u), across.dot(&v));
        // On the axis itself any direction will do.
        let toward = if flat == Vector2::zeros() { Vector2::x() } else { flat };
        let wall = self.wall.at(&toward) * (1.0 + self.widening * along).clamp(0.3, 2.0);
        Place { along, share: flat.norm() / wall, wall }
    }

    fn is_bent(&self, curvature: f64) -> bool {
        curvature * self.radius > 1e-6
    }
}

/// Distance from the middle of `frame` to a section's sides, in evenly spread directions of the frame; the section
/// stands across the same axis, maybe the other way round.
fn wall_around(cut: &Section, frame: &Frame) -> Option<Profile> {
    let corners: Vec<Point2<f64>> = cut.points.iter().map(|p| frame.flat(&cut.frame.lift(p))).collect();
    let toward = |k: usize| {
        let (sin, cos) = (TAU * k as f64 / Profile::BINS as f64).sin_cos();
        let ray = Vector2::new(cos, sin);
        let side = |i: usize| {
            let (p, q) = (corners[i].coords, corners[(i + 1) % corners.len()].coords);
            let (from, to) = (ray.perp(&p), ray.perp(&q));
            if (from < 0.0) == (to < 0.0) {
                return None;
            }
            Some((p + (q - p) * (from / (from - to))).dot(&ray)).filter(|distance| *distance > 0.0)
        };
        (0..corners.len()).filter_map(side).min_by(f64::total_cmp)
    };
    let mut radii = [0.0; Profile::BINS];
    for (k, distance) in radii.iter_mut().enumerate() {
        *distance = toward(k)?;
    }
    Some(Profile { radii })
}
