//! Radius of the largest inscribed sphere at a station, from the wall's vertices around its section.
//!
//! A mesh's vertices lie on the wall, its facets cut inside it: a section's polygon makes thin vessels
//! thinner. So distances of vertices from the axis are fitted with the wall's mean, its slope along the
//! axis, and its first two harmonics around it; noise and stairs average out.

use nalgebra::{Point2, SMatrix, SVector, Vector2, Vector3};

use crate::mesh::preparation::Surface;

use crate::centerline::cut_plane::section::{Section, signed_angle};

/// Terms of the fit: mean, cos, sin, cos 2, sin 2, slope along the axis, and the bend of the axis (cos, sin).
const TERMS: usize = 8;
/// Variance of a vertex over that expected of each term.
const HOLD: [f64; TERMS] = [0.0, 0.01, 0.01, 0.2, 0.2, 0.02, 1.0, 1.0];
/// Triangles that lean more than this (sine) are a cap's.
const CAP: f64 = 0.75;
/// A wall that is farther from a circle than this (share of its radius) is no noisy circle.
pub const FLAT: f64 = 0.15;
/// Share of the radius that facets may cut away unnoticed.
const FACETS: f64 = 0.02;
/// Fewer vertices say nothing.
const LEAST: usize = 5;

/// Distance of the wall from the axis around one station.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct WallShape {
    /// Mean distance.
    pub mean: f64,
    /// Second harmonic (ellipse) in the frame of the section.
    pub ellipse: [f64; 2],
    /// Square of the second harmonic that noise alone would show.
    pub haze: f64,
    /// Where the vertices put the axis against where the polygon does, in the frame of the section.
    pub offset: [f64; 2],
    /// Change of the distance along the axis.
    pub slope: f64,
    /// Distance of the nearest wall in the section.
    pub nearest: f64,
    /// How much nearer than the ellipse's short half axis the wall comes.
    pub lobes: f64,
    /// Mean extent along the axis of the triangles that the section crosses: closer sections say
    /// much the same.
    pub grain: f64,
}

impl WallShape {
    pub fn circle(radius: f64) -> Self {
        Self { mean: radius, nearest: radius, ..Self::default() }
    }

    /// Radius of the largest sphere about the station: the short half axis, seen square to the
    /// sloping wall.
    pub fn inscribed(&self) -> f64 {
        let square = self.ellipse[0].powi(2) + self.ellipse[1].powi(2);
        let flatness = (square - self.haze).max(0.0).sqrt();
        let short = if flatness < FLAT * self.mean { self.mean - flatness } else { self.nearest };
        ((short - self.lobes) / (1.0 + self.slope * self.slope).sqrt()).max(0.05 * self.nearest)
    }

    /// Least squares over the vertices of the triangles that the section crosses, about `centre`.
    ///
    /// `radius` is the section's own, for sections of too few vertices.
    pub fn of(surface: &Surface, cut: &Section, centre: &Point2<f64>, radius: f64) -> Self {
        let grain = grain(surface, cut);
        let nearest = cut.distance(centre);
        // Far along a long triangle the wall may be anything; far off it is another branch's.
        let reach = grain.clamp(0.75 * radius, 2.0 * radius);
        let mut sums = Sums::default();
        for v in wall_vertices(surface, cut) {
            let p = surface.mesh.vertices[v as usize];
            let along = (p - cut.frame.origin).dot(&cut.frame.t);
            let arm = cut.frame.flat(&p) - centre;
            let distance = arm.norm();
            if along.abs() > reach || distance <= 0.0 || !(0.4..2.0).contains(&(distance / radius)) {
                continue;
            }
            sums.add(&row(&(arm / distance), along / radius), distance);
        }
        let Sums { normal, right, squares, count } = sums;
        let (mut normal, right) = (SMatrix::<f64, TERMS, TERMS>::from(normal), SVector::from(right));
        if count < LEAST {
            return Self { grain, nearest, ..Self::circle(radius) };
        }
        // Holds what the vertices leave open: a single ring says nothing of slope and bend, a few of an ellipse.
        for (i, hold) in HOLD.into_iter().enumerate() {
            normal[(i, i)] += hold;
        }
        let Some(cholesky) = normal.cholesky() else {
            return Self { grain, nearest, ..Self::circle(radius) };
        };
        let fit = cholesky.solve(&right);
        let left = (squares - fit.dot(&right)).max(0.0) / (count - TERMS.min(count - 1)) as f64;
        // Only where facets cut far inside the wall does the polygon's centroid stray.
        let coarse = ((fit[0] - radius) / fit[0] / FACETS - 1.0).clamp(0.0, 1.0);
        let polygon = if coarse > 0.0 { polygon_offset(cut, centre) } else { [0.0; 2] };
        Self {
            mean: fit[0],
            ellipse: [fit[3], fit[4]],
            haze: 4.0 * left / count as f64,
            offset: [coarse * (fit[1] - polygon[0]), coarse * (fit[2] - polygon[1])],
            slope: fit[5] / radius,
            nearest,
            lobes: 0.0,
            grain,
        }
    }

    /// Weighted mean of neighbouring shapes (their frames do not spin). Neighbours see the same triangles, or one smooth
    /// curve: their noise does not average out.
    pub fn average<'a>(shapes: impl Iterator<Item = (f64, &'a Self)>) -> Self {
        let mut sum = Self::default();
        let mut total = 0.0;
        for (weight, shape) in shapes {
            sum.mean += weight * shape.mean;
            sum.ellipse[0] += weight * shape.ellipse[0];
            sum.ellipse[1] += weight * shape.ellipse[1];
            sum.slope += weight * shape.slope;
            sum.nearest += weight * shape.nearest;
            sum.lobes += weight * shape.lobes;
            sum.haze += weight * shape.haze;
            sum.grain += weight * shape.grain;
            total += weight;
        }
        let scale = if total > 0.0 { 1.0 / total } else { 0.0 };
        Self {
            mean: sum.mean * scale,
            ellipse: sum.ellipse.map(|term| term * scale),
            haze: sum.haze * scale,
            offset: [0.0; 2],
            slope: sum.slope * scale,
            nearest: sum.nearest * scale,
            lobes: sum.lobes * scale,
            grain: sum.grain * scale,
        }
    }

    /// The same wall seen from the plane's other side (see [`super::section::Profile::mirror`]).
    pub fn mirror(&mut self) {
        self.ellipse[1] = -self.ellipse[1];
        self.offset[1] = -self.offset[1];
        self.slope = -self.slope;
    }
}

/// How much (sine) a triangle leans out of the wall into the section's plane: 0 along the axis, 1 across it.
fn lean(cut: &Section, normal: &Vector3<f64>) -> f64 {
    if *normal == Vector3::zeros() { 1.0 } else { normal.dot(&cut.frame.t).abs() }
}

/// The terms at a vertex in direction `arm` (unit) from the centre.
fn row(arm: &Vector2<f64>, along: f64) -> [f64; TERMS] {
    let (cos, sin) = (arm.x, arm.y);
    let bow = along * along;
    [1.0, cos, sin, cos * cos - sin * sin, 2.0 * sin * cos, along, bow * cos, bow * sin]
}

/// The vertices of the triangles that the section crosses; without those of caps, which say nothing of the wall.
fn wall_vertices(surface: &Surface, cut: &Section) -> Vec<u32> {
    let wall = cut.triangles.iter().zip(cut.normals(surface)).filter(|(_, normal)| lean(cut, normal) < CAP);
    let mut before = [u32::MAX; 3];
    let mut vertices = Vec::with_capacity(cut.triangles.len());
    for (&t, _) in wall {
        let corners = surface.mesh.triangles[t as usize];
        // Neighbours share an edge: what is left to sort is a third.
        vertices.extend(corners.into_iter().filter(|v| !before.contains(v)));
        before = corners;
    }
    vertices.sort_unstable();
    vertices.dedup();
    vertices
}

/// Normal equations: the lower half, column by column, two entries at a time, all that Cholesky's decomposition reads.
#[derive(Default)]
struct Sums {
    normal: [[f64; TERMS]; TERMS],
    right: [f64; TERMS],
    squares: f64,
    count: usize,
}

impl Sums {
    fn add(&mut self, row: &[f64; TERMS], distance: f64) {
        for (number, (column, &a)) in self.normal.iter_mut().zip(row).enumerate() {
            let below = number / 2 * 2;
            column[below..].iter_mut().zip(&row[below..]).for_each(|(sum, &b)| *sum += a * b);
        }
        self.right.iter_mut().zip(row).for_each(|(sum, &a)| *sum += a * distance);
        self.squares += distance * distance;
        self.count += 1;
    }
}

/// First harmonic of the polygon's distance from `centre`.
fn polygon_offset(cut: &Section, centre: &Point2<f64>) -> [f64; 2] {
    let mut sum = Vector2::zeros();
    for (p, q, _) in cut.sides() {
        let (a, b) = (p - centre, q - centre);
        sum += (a + b) * (0.5 * signed_angle(&a, &b));
    }
    // Twice the mean over the circle.
    (sum / std::f64::consts::PI).into()
}

/// Mean extent of the section's triangles along its normal.
fn grain(surface: &Surface, cut: &Section) -> f64 {
    let extent = |&t: &u32| {
        let along = surface.mesh.triangles[t as usize]
            .map(|v| (surface.mesh.vertices[v as usize] - cut.frame.origin).dot(&cut.frame.t));
        along.iter().fold(f64::MIN, |a, &b| a.max(b)) - along.iter().fold(f64::MAX, |a, &b| a.min(b))
    };
    cut.triangles.iter().map(extent).sum::<f64>() / cut.triangles.len().max(1) as f64
}
