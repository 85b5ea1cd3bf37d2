//! The morphology-preserving smoothing filter (the paper's ref. 6), off by default.
//!
//! Facet normals are filtered over a context that respects features, then the vertices move to agree with
//! them. The stairs of a binary volume are sharp in the raw normals and vanish in the context (the normals'
//! average over a few rings), while a real edge stays there: so the context weighs, the normals are averaged.
//! Laplacian smoothing would shrink the vessel; here the volume is put back.

use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

use crate::mesh::TriangleMesh;

use crate::centerline::{Control, ExtractError, Stage};

/// Rounds of filter and update.
const ROUNDS: usize = 3;
/// Averaging passes from the raw normals to the context.
const CONTEXT_PASSES: usize = 6;
/// Passes of the context-weighted filter a round.
const FILTER_PASSES: usize = 12;
/// Passes of the vertex update a round.
const UPDATE_PASSES: usize = 15;
/// Difference of two context normals (the length of their difference, about radians) that halves the
/// weight roughly; the tube's own curvature stays below it, the rim of a cut end does not.
const CONTEXT_SIGMA: f64 = 0.4;
/// No vertex moves farther than this many of its own mean edge lengths.
const LARGEST_MOVE: f64 = 2.0;
/// Corrections of the volume by an even offset; the first leaves an error of second order.
const VOLUME_PASSES: usize = 3;

/// Smooths a closed surface in place; its volume stays, its triangles and the vertices `fixed` too. `O(n)`,
/// scale-free.
///
/// # Errors
/// [`ExtractError::Cancelled`].
pub fn smooth(mesh: &mut TriangleMesh, fixed: &[u32], control: &Control<'_>) -> Result<(), ExtractError> {
    let rings = Rings::new(mesh);
    let original = mesh.vertices.clone();
    let mut reach: Vec<f64> = rings.mean_edges(mesh).into_iter().map(|edge| LARGEST_MOVE * edge).collect();
    fixed.iter().for_each(|&v| reach[v as usize] = 0.0);
    let volume = volume(mesh);
    let progress = |round: usize, part: f64| {
        control.report(Stage::SmoothingFilter, (round as f64 + part) / ROUNDS as f64)
    };
    for round in 0..ROUNDS {
        progress(round, 0.0)?;
        let (raw, areas) = facets(mesh);
        let mut context = raw.clone();
        for _ in 0..CONTEXT_PASSES {
            control.cancel.check()?;
            context = rings.filtered(&context, &areas, |_, _| 1.0);
        }
        progress(round, 0.3)?;
        let weight = |f: usize, g: usize| {
            (-(context[f] - context[g]).norm_squared() / (2.0 * CONTEXT_SIGMA * CONTEXT_SIGMA)).exp()
        };
        let mut normals = raw;
        for _ in 0..FILTER_PASSES {
            control.cancel.check()?;
            normals = rings.filtered(&normals, &areas, weight);
        }
        progress(round, 0.7)?;
        for _ in 0..UPDATE_PASSES {
            control.cancel.check()?;
            mesh.vertices = rings.updated(mesh, &normals, &original, &reach);
        }
        for _ in 0..VOLUME_PASSES {
            offset_to_volume(mesh, &rings, volume, &reach);
        }
    }
    progress(ROUNDS, 0.0)
}

/// Facets around each vertex, in compressed rows.
struct Rings {
    start: Vec<u32>,
    facets: Vec<u32>,
    triangles: Vec<[u32; 3]>,
}

impl Rings {
    fn new(mesh: &TriangleMesh) -> Self {
        let mut start = vec![0u32; mesh.vertices.len() + 1];
        for &v in mesh.triangles.iter().flatten() {
            start[v as usize + 1] += 1;
        }
        for v in 0..mesh.vertices.len() {
            start[v + 1] += start[v];
        }
        let mut cursor = start.clone();
        let mut facets = vec![0; 3 * mesh.triangles.len()];
        for (f, triangle) in mesh.triangles.iter().enumerate() {
            for &v in triangle {
                facets[cursor[v as usize] as usize] = f as u32;
                cursor[v as usize] += 1;
            }
        }
        Self { start, facets, triangles: mesh.triangles.clone() }
    }

    fn around(&self, v: u32) -> &[u32] {
        &self.facets[self.start[v as usize] as usize..self.start[v as usize + 1] as usize]
    }

    /// Each facet's normal as the area-weighted mean over the facets that share a vertex with it,
    /// `weight(f, g)` times as much of facet `g`. A facet that shares an edge counts twice.
    fn filtered(
        &self,
        normals: &[Vector3<f64>],
        areas: &[f64],
        weight: impl Fn(usize, usize) -> f64 + Sync,
    ) -> Vec<Vector3<f64>> {
        let one = |f: usize| {
            let mut sum = Vector3::zeros();
            for &v in &self.triangles[f] {
                for &g in self.around(v) {
                    sum += normals[g as usize] * (areas[g as usize] * weight(f, g as usize));
                }
            }
            sum.try_normalize(1e-300).unwrap_or(normals[f])
        };
        (0..normals.len()).into_par_iter().map(one).collect()
    }

    /// One pass of the vertex update: `x + 1/|F| sum n_f (n_f . (c_f - x))` over the facets at the vertex.
    fn updated(
        &self,
        mesh: &TriangleMesh,
        normals: &[Vector3<f64>],
        original: &[Point3<f64>],
        reach: &[f64],
    ) -> Vec<Point3<f64>> {
        let one = |v: usize| {
            let position = mesh.vertices[v];
            let ring = self.around(v as u32);
            if ring.is_empty() {
                return position;
            }
            let mut step = Vector3::zeros();
            for &f in ring {
                let [a, b, c] = self.triangles[f as usize].map(|u| mesh.vertices[u as usize].coords);
                let normal = normals[f as usize];
                step += normal * normal.dot(&((a + b + c) / 3.0 - position.coords));
            }
            let moved = position + step / ring.len() as f64 - original[v];
            original[v] + moved.cap_magnitude(reach[v])
        };
        (0..mesh.vertices.len()).into_par_iter().map(one).collect()
    }

    /// Mean length of the triangles' edges at each vertex.
    fn mean_edges(&self, mesh: &TriangleMesh) -> Vec<f64> {
        let one = |v: usize| {
            let ring = self.around(v as u32);
            let total: f64 = ring
                .iter()
                .flat_map(|&f| self.triangles[f as usize])
                .map(|u| (mesh.vertices[u as usize] - mesh.vertices[v]).norm())
                .sum();
            total / (2 * ring.len()).max(1) as f64
        };
        (0..mesh.vertices.len()).into_par_iter().map(one).collect()
    }
}

/// Unit normals and areas of the facets; the normal of a facet without area is zero.
fn facets(mesh: &TriangleMesh) -> (Vec<Vector3<f64>>, Vec<f64>) {
    let one = |triangle: &[u32; 3]| {
        let [a, b, c] = triangle.map(|v| mesh.vertices[v as usize]);
        let cross = (b - a).cross(&(c - a));
        let length = cross.norm();
        (if length > 0.0 { cross / length } else { cross }, 0.5 * length)
    };
    mesh.triangles.par_iter().map(one).unzip()
}

/// Enclosed volume about the first vertex, by the divergence theorem.
fn volume(mesh: &TriangleMesh) -> f64 {
    let Some(&origin) = mesh.vertices.first() else { return 0.0 };
    let six = |triangle: &[u32; 3]| {
        let [a, b, c] = triangle.map(|v| mesh.vertices[v as usize] - origin);
        a.dot(&b.cross(&c))
    };
    mesh.triangles.iter().map(six).sum::<f64>() / 6.0
}

/// Moves every vertex along its normal by what the missing volume is, spread over the area.
fn offset_to_volume(mesh: &mut TriangleMesh, rings: &Rings, wanted: f64, reach: &[f64]) {
    let (normals, areas) = facets(mesh);
    let area: f64 = areas.iter().sum();
    if area <= 0.0 {
        return;
    }
    let step = (wanted - volume(mesh)) / area;
    for v in (0..mesh.vertices.len()).filter(|&v| reach[v] > 0.0) {
        let sum: Vector3<f64> =
            rings.around(v as u32).iter().map(|&f| normals[f as usize] * areas[f as usize]).sum();
        if let Some(normal) = sum.try_normalize(1e-300) {
            mesh.vertices[v] += normal * step;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::centerline::CancelToken;
    use crate::centerline::test_surfaces::voxels;

    const RADIUS: f64 = 6.0;
    const LENGTH: i32 = 60;

    fn axis() -> Vector3<f64> {
        Vector3::new(0.15, 0.3, 1.0).normalize()
    }

    /// The faces between the voxels of a tilted tube and the rest: stairs everywhere.
    fn voxel_tube(scale: f64) -> TriangleMesh {
        let mut mesh = voxels([-12, -12, 0], [40, 40, LENGTH], |point| {
            (point - axis() * point.dot(&axis())).norm() < RADIUS
        });
        mesh.vertices.iter_mut().for_each(|point| *point *= scale);
        mesh
    }

    /// Area-weighted mean angle between the facets' normals and the tube's, away from its ends; degrees.
    fn deviation(mesh: &TriangleMesh) -> f64 {
        let (normals, areas) = facets(mesh);
        let (mut sum, mut weight) = (0.0, 0.0);
        for (f, triangle) in mesh.triangles.iter().enumerate() {
            let [a, b, c] = triangle.map(|v| mesh.vertices[v as usize].coords);
            let centre = (a + b + c) / 3.0;
            if !(10.0..f64::from(LENGTH) - 10.0).contains(&centre.z) {
                continue;
            }
            let radial = (centre - axis() * centre.dot(&axis())).normalize();
            sum += areas[f] * normals[f].dot(&radial).clamp(-1.0, 1.0).acos().to_degrees();
            weight += areas[f];
        }
        sum / weight
    }

    #[test]
    fn stairs_go_and_the_volume_stays() {
        let mut mesh = voxel_tube(1.0);
        let (before, volume_before) = (deviation(&mesh), volume(&mesh));
        smooth(&mut mesh, &[], &Control::silent()).unwrap();
        let after = deviation(&mesh);
        assert!(after < 0.5 * before, "normals deviate by {after} degrees after, {before} before");
        let change = (volume(&mesh) / volume_before - 1.0).abs();
        assert!(change < 0.01, "the volume changes by {change}");
    }

    #[test]
    fn the_radius_stays_too() {
        let mut mesh = voxel_tube(1.0);
        smooth(&mut mesh, &[], &Control::silent()).unwrap();
        let radii: Vec<f64> = mesh
            .vertices
            .iter()
            .filter(|point| (15.0..f64::from(LENGTH) - 15.0).contains(&point.z))
            .map(|point| (point.coords - axis() * point.coords.dot(&axis())).norm())
            .collect();
        let mean = radii.iter().sum::<f64>() / radii.len() as f64;
        assert!((mean / RADIUS - 1.0).abs() < 0.03, "mean radius {mean}");
        assert!(radii.iter().all(|radius| (radius / RADIUS - 1.0).abs() < 0.15));
    }

    #[test]
    fn the_unit_does_not_matter() {
        let (mut metres, mut millimetres) = (voxel_tube(1e-3), voxel_tube(1.0));
        smooth(&mut metres, &[], &Control::silent()).unwrap();
        smooth(&mut millimetres, &[], &Control::silent()).unwrap();
        for (a, b) in metres.vertices.iter().zip(&millimetres.vertices) {
            assert!((a.coords * 1e3 - b.coords).norm() < 1e-6);
        }
    }

    #[test]
    fn fixed_vertices_stay() {
        let mut mesh = voxel_tube(1.0);
        let before = mesh.vertices.clone();
        let fixed: Vec<u32> = (0..50).collect();
        smooth(&mut mesh, &fixed, &Control::silent()).unwrap();
        assert_eq!(mesh.vertices[..50], before[..50]);
        assert_ne!(mesh.vertices[50..], before[50..]);
    }

    #[test]
    fn it_stops_when_cancelled() {
        let cancel = CancelToken::new();
        cancel.cancel();
        let control = Control::new(cancel, &|_| {});
        assert_eq!(smooth(&mut voxel_tube(1.0), &[], &control), Err(ExtractError::Cancelled));
    }
}
