//! Radius of the largest inscribed sphere at a station, from the wall's vertices around its section.
//!
//! A mesh's vertices lie on the wall, its facets cut inside it: a section's polygon makes thin vessels
//! thinner. So distances of vertices from the axis are fitted with the wall's mean, its slope along the
//! axis, and its first two harmonics around it; noise and stairs average out.

use nalgebra::{Point2, SMatrix, SVector};

use crate::mesh::preparation::Surface;

use crate::centerline::cut_plane::section::Section;

/// Terms of the fit: mean, cos, sin, cos 2, sin 2, slope.
const TERMS: usize = 6;

/// Distance of the wall from the axis around one station.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct WallShape {
    /// Mean distance.
    pub mean: f64,
    /// Second harmonic (ellipse) in the frame of the section.
    pub ellipse: [f64; 2],
    /// Change of the distance along the axis.
    pub slope: f64,
    /// Distance of the nearest wall in the section.
    pub nearest: f64,
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
        /// A wall that is farther from a circle than this (share of its radius) is no noisy circle.
        const FLAT: f64 = 0.15;
        let flatness = self.ellipse[0].hypot(self.ellipse[1]);
        let short = if flatness < FLAT * self.mean { self.mean - flatness } else { self.nearest };
        (short / (1.0 + self.slope * self.slope).sqrt()).max(0.05 * self.nearest)
    }

    /// Least squares over the vertices of the triangles that the section crosses, about `centre`.
    ///
    /// `radius` is the section's own, for sections of too few vertices.
    pub fn of(surface: &Surface, cut: &Section, centre: &Point2<f64>, radius: f64) -> Self {
        let mut vertices: Vec<u32> =
            cut.triangles.iter().flat_map(|&t| surface.mesh.triangles[t as usize]).collect();
        vertices.sort_unstable();
        vertices.dedup();
        let mut normal = SMatrix::<f64, TERMS, TERMS>::zeros();
        let mut right = SVector::<f64, TERMS>::zeros();
        let mut count = 0;
        for v in vertices {
            let p = surface.mesh.vertices[v as usize];
            let along = (p - cut.frame.origin).dot(&cut.frame.t);
            let arm = cut.frame.flat(&p) - centre;
            let distance = arm.norm();
            // Far along a long triangle the wall may be anything; far off it is another branch's.
            if along.abs() > 0.75 * radius || distance <= 0.0 || !(0.4..2.0).contains(&(distance / radius)) {
                continue;
            }
            let (cos, sin) = (arm.x / distance, arm.y / distance);
            let row = SVector::<f64, TERMS>::from([
                1.0,
                cos,
                sin,
                cos * cos - sin * sin,
                2.0 * sin * cos,
                along / radius,
            ]);
            normal += row * row.transpose();
            right += row * distance;
            count += 1;
        }
        let grain = grain(surface, cut);
        let nearest = cut.distance(centre);
        if count < 2 * TERMS {
            return Self { grain, nearest, ..Self::circle(radius) };
        }
        // Holds what the vertices leave open (a single ring says nothing of the slope).
        for i in 1..TERMS {
            normal[(i, i)] += 5e-4 * count as f64;
        }
        let Some(cholesky) = normal.cholesky() else {
            return Self { grain, nearest, ..Self::circle(radius) };
        };
        let fit = cholesky.solve(&right);
        Self { mean: fit[0], ellipse: [fit[3], fit[4]], slope: fit[5] / radius, nearest, grain }
    }

    /// Weighted mean of neighbouring shapes (their frames do not spin).
    pub fn average<'a>(shapes: impl Iterator<Item = (f64, &'a Self)>) -> Self {
        let mut sum = Self::default();
        let mut total = 0.0;
        for (weight, shape) in shapes {
            sum.mean += weight * shape.mean;
            sum.ellipse[0] += weight * shape.ellipse[0];
            sum.ellipse[1] += weight * shape.ellipse[1];
            sum.slope += weight * shape.slope;
            sum.nearest += weight * shape.nearest;
            sum.grain += weight * shape.grain;
            total += weight;
        }
        let scale = if total > 0.0 { 1.0 / total } else { 0.0 };
        Self {
            mean: sum.mean * scale,
            ellipse: sum.ellipse.map(|term| term * scale),
            slope: sum.slope * scale,
            nearest: sum.nearest * scale,
            grain: sum.grain * scale,
        }
    }

    /// The same wall seen from the plane's other side (see [`super::section::Profile::mirror`]).
    pub fn mirror(&mut self) {
        self.ellipse[1] = -self.ellipse[1];
        self.slope = -self.slope;
    }
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
