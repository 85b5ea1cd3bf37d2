//! What the wall in a section says of the centerline point (section IV.B, eq. 10): the centroid where
//! the section is clean; where it takes in another branch, the place at which the branch's known wall
//! fits the part that is seen.

use std::f64::consts::TAU;

use nalgebra::{Matrix2, Matrix3, Point2, Vector2, Vector3};

use crate::mesh::preparation::Surface;

use crate::centerline::cut_plane::section::{Profile, Section, signed_angle};
use crate::centerline::cut_plane::wall_shape::WallShape;
use crate::centerline::segmentation::track::{Sight, Station};

/// The wall leaves the expected profile beyond this share of the radius.
const GATE: f64 = 0.25;
/// Share of the circumference that must agree for a section to be clean.
const CLEAN: f64 = 0.92;
/// Share of the circumference below which the rest, the mouth of a thin branch, is left out.
const WHOLE: f64 = 0.98;
/// Share of the circumference below which a partial wall says nothing.
const LEAST: f64 = 0.12;
/// Wall whose normal leans more than this (sine) out of the section is a cap or another branch.
const LEAN: f64 = 0.75;

/// A side of a section that is wall, not cap.
struct WallSide {
    ends: [Point2<f64>; 2],
    middle: Point2<f64>,
    /// Of the wall, unit, in the section's plane.
    normal: Vector2<f64>,
}

/// The sides of a section that are wall.
fn wall_sides(surface: &Surface, cut: &Section) -> Vec<WallSide> {
    let mut wall = Vec::with_capacity(cut.points.len());
    for ((p, q, t), normal) in cut.sides().zip(cut.normals(surface)) {
        if let Some((normal, lean)) = plane_normal(cut, normal)
            && lean <= LEAN
            && !surface.is_cap(t)
        {
            wall.push(WallSide { ends: [p, q], middle: nalgebra::center(&p, &q), normal });
        }
    }
    wall
}

/// A piece of a section's wall, seen from the centre.
struct WallPiece {
    /// Unit.
    direction: Vector2<f64>,
    distance: f64,
    /// Distance of the wall expected there.
    radius: f64,
    /// Share of the circumference.
    share: f64,
}

/// What part of the expected profile the section's wall shows.
pub struct Agreement {
    pieces: Vec<WallPiece>,
    /// Share of the full circle that agrees.
    pub support: f64,
}

/// Compares a section's wall with the profile expected around `centre`; `gate` in local radii.
fn agreement(wall: &[WallSide], centre: Point2<f64>, expected: &Profile, gate: f64) -> Agreement {
    let mut pieces = Vec::with_capacity(wall.len());
    let mut support = 0.0;
    for &WallSide { ends: [p, q], middle, normal } in wall {
        let arm = middle - centre;
        let distance = arm.norm();
        let direction = arm / distance;
        // Not so at the centre itself.
        let faces = normal.dot(&direction) >= 0.6;
        if !faces {
            continue;
        }
        let radius = expected.at(&direction);
        if (distance - radius).abs() > gate * radius {
            continue;
        }
        let share = signed_angle(&(p - centre), &(q - centre)).abs() / TAU;
        support += share;
        pieces.push(WallPiece { direction, distance, radius, share });
    }
    Agreement { pieces, support }
}

/// A triangle's normal in the section's plane, and how much (sine) it leaned out of it.
fn plane_normal(cut: &Section, normal: &Vector3<f64>) -> Option<(Vector2<f64>, f64)> {
    let flat = Vector2::new(normal.dot(&cut.frame.u), normal.dot(&cut.frame.v)).try_normalize(1e-9)?;
    Some((flat, normal.dot(&cut.frame.t).abs()))
}

/// The normal of a triangle and those that touch it, each weighted with its area, at most the triangle's own: a long
/// facet beside a small one says nothing of it.
fn broad_normal(surface: &Surface, t: u32) -> Option<Vector3<f64>> {
    let area = |t: u32| surface.mesh.area_vector(t);
    let own = area(t).norm();
    let around = surface.mesh.triangles[t as usize].into_iter().flat_map(|v| surface.corners.star(v));
    let areas = around.map(|h| area(h / 3));
    let sum: Vector3<f64> = areas.map(|area| area * (own / area.norm().max(own))).sum();
    sum.try_normalize(0.0)
}

/// Whether a section lies square to its wall: one that lies aslant over a cap may look as round as any.
fn is_square(surface: &Surface, cut: &Section) -> bool {
    /// Cosine of the most that the section may lean.
    const LEAN: f64 = 0.8;
    wall_axis(surface, cut).dot(&cut.frame.t) > LEAN
}

/// The direction that the wall's normals around a section leave free: the eigenvector of least
/// eigenvalue of their covariance (eq. 9), on the side of the section's normal.
pub fn wall_axis(surface: &Surface, cut: &Section) -> Vector3<f64> {
    let mut covariance = Matrix3::zeros();
    for ((p, q, _), normal) in
        cut.sides().zip(cut.normals(surface)).filter(|((.., t), _)| !surface.is_cap(*t))
    {
        covariance += normal * normal.transpose() * (q - p).norm();
    }
    let eigen = covariance.symmetric_eigen();
    let axis: Vector3<f64> = eigen.eigenvectors.column(eigen.eigenvalues.imin()).into();
    if axis.dot(&cut.frame.t) < 0.0 { -axis } else { axis }
}

/// Judges a station by its section, expecting the wall `expected` of its neighbour.
///
/// Sets target, weight, radii, profile and sight. `expected` is in the section's frame.
pub fn judge(surface: &Surface, station: &mut Station, cut: &Section, expected: &Profile) {
    let measure = cut.measure();
    let mean = expected.mean();
    let sound = measure.area > 0.0 && cut.encloses(&measure.centroid);
    let growth = measure.radius() / mean;
    if sound && (1.0 - GATE..1.0 + GATE).contains(&growth) {
        let wall = wall_sides(surface, cut);
        let seen = agreement(&wall, measure.centroid, &expected.scaled(growth), GATE);
        if seen.support >= CLEAN && is_square(surface, cut) {
            accept_clean(surface, station, cut, measure.centroid, measure.radius());
            if seen.support < WHOLE {
                leave_out(&wall, station, cut, &expected.scaled(growth));
            }
            return;
        }
    }
    fit_part(surface, station, cut, expected);
}

/// Judges a station near an end, where no other branch can take part: a section counts as long as
/// `share` of its length is wall and not cap.
pub fn judge_end(surface: &Surface, station: &mut Station, cut: &Section, expected: &Profile, share: f64) {
    const GROWTH: std::ops::Range<f64> = 0.6..1.5;
    /// Where those around a triangle lean less (sine), noise has turned it.
    const WALL: f64 = 0.5;
    let measure = cut.measure();
    let (mut wall, mut all) = (0.0, 0.0);
    for ((p, q, t), normal) in cut.sides().zip(cut.normals(surface)) {
        let length = (q - p).norm();
        all += length;
        let leans = |normal: Vector3<f64>| normal.dot(&cut.frame.t).abs();
        if surface.is_cap(t) {
            continue;
        }
        if plane_normal(cut, normal).is_some_and(|(_, lean)| lean <= LEAN)
            || broad_normal(surface, t).is_some_and(|normal| leans(normal) < WALL)
        {
            wall += length;
        }
    }
    let sound = measure.area > 0.0 && cut.encloses(&measure.centroid);
    let grown = GROWTH.contains(&(measure.radius() / expected.mean()));
    if sound && wall > share * all && grown && is_square(surface, cut) {
        accept_clean(surface, station, cut, measure.centroid, measure.radius());
    }
}

/// Takes a section as the branch's own.
pub fn accept_clean(
    surface: &Surface,
    station: &mut Station,
    cut: &Section,
    centroid: Point2<f64>,
    radius: f64,
) {
    station.frame = cut.frame;
    station.seeds = Some(cut.seeds());
    station.profile = Profile::of(cut, &centroid, radius);
    station.weight = Matrix3::identity();
    station.section_radius = radius;
    station.shape = WallShape::of(surface, cut, &centroid, radius);
    let [x, y] = station.shape.offset;
    station.target = cut.frame.lift(&(centroid + Vector2::new(x, y)));
    station.radius = station.shape.inscribed();
    station.sight = Sight::Clean;
}

/// Centres a clean section by the part of it that agrees: what does not is the mouth of a branch.
fn leave_out(wall: &[WallSide], station: &mut Station, cut: &Section, expected: &Profile) {
    const ROUNDS: usize = 3;
    let mut profile = expected.clone();
    let mut centre = Point2::origin();
    for _ in 0..ROUNDS {
        (centre, _, _) = fit_centre(wall, &profile, centre);
        let seen = agreement(wall, centre, &profile, GATE);
        let (mut all, mut grown) = (0.0, 0.0);
        for piece in &seen.pieces {
            all += piece.share;
            grown += piece.share * piece.distance / piece.radius;
        }
        if all > 0.0 {
            profile = profile.scaled(grown / all);
        }
    }
    station.target = cut.frame.lift(&centre);
    station.section_radius = profile.mean();
    station.profile = profile;
}

/// Fits the expected wall to the part of the section that agrees with it, by Gauss-Newton on the
/// distances along the normals (the partial wall's form of eq. 10).
fn fit_part(surface: &Surface, station: &mut Station, cut: &Section, expected: &Profile) {
    let mean = expected.mean();
    let wall = wall_sides(surface, cut);
    let (centre, information, support) = fit_centre(&wall, expected, Point2::origin());
    station.frame = cut.frame;
    station.profile = expected.clone();
    station.section_radius = mean;
    station.shape = WallShape::circle(mean);
    station.radius = mean;
    if support < LEAST || (centre - Point2::origin()).norm() > 0.75 * mean {
        station.target = station.point;
        station.weight = Matrix3::zeros();
        station.sight = Sight::Lost;
        return;
    }
    station.target = cut.frame.lift(&centre);
    let (u, v) = (cut.frame.u, cut.frame.v);
    let lifted = u * u.transpose() * information.m11
        + v * v.transpose() * information.m22
        + (u * v.transpose() + v * u.transpose()) * information.m12;
    // The share seen tempers how firmly the part speaks.
    station.weight = lifted * support;
    station.sight = Sight::Partial;
}

/// Where the expected wall lies on the part of the section that agrees with it: its centre, how firmly that
/// part holds it, and the share of the circle that it is.
fn fit_centre(wall: &[WallSide], expected: &Profile, start: Point2<f64>) -> (Point2<f64>, Matrix2<f64>, f64) {
    let mut centre = start;
    let mean = expected.mean();
    let mut seen = agreement(wall, centre, expected, 1.6 * GATE);
    let mut information = Matrix2::zeros();
    for round in 0..6 {
        if seen.support < LEAST {
            break;
        }
        information = Matrix2::zeros();
        let mut pull = Vector2::zeros();
        for piece in &seen.pieces {
            let (direction, excess) = (piece.direction, piece.distance - piece.radius);
            let doubt = excess / (GATE * mean);
            let weight = piece.share / (1.0 + doubt * doubt);
            information += direction * direction.transpose() * (2.0 * weight);
            pull += direction * (2.0 * weight * excess);
        }
        // A weak pull home keeps the direction that no wall pins.
        let damped = information + Matrix2::identity() * 0.02;
        let Some(step) = damped.try_inverse().map(|inverse| inverse * pull) else { break };
        let limit = 0.25 * mean / step.norm().max(0.25 * mean);
        centre += step * limit;
        let gate = if round < 2 { 1.6 * GATE } else { GATE };
        seen = agreement(wall, centre, expected, gate);
    }
    (centre, information, seen.support)
}
