//! Where a ray crosses a triangle (Moller and Trumbore 1997).

use nalgebra::{Point3, Vector3};

use crate::mesh::preparation::Surface;

/// Distance along the ray to triangle `corners`, ahead of `origin`; in units of `direction`'s length.
///
/// `wanted` looks at the determinant first: it is negative where the ray leaves the lumen (normals point
/// outward), positive where it enters, zero along the triangle.
pub fn crossing(
    surface: &Surface,
    corners: &[u32; 3],
    origin: &Point3<f64>,
    direction: &Vector3<f64>,
    wanted: impl Fn(f64) -> bool,
) -> Option<f64> {
    let [a, b, c] = corners.map(|v| surface.mesh.vertices[v as usize]);
    let (e1, e2) = (b - a, c - a);
    let p = direction.cross(&e2);
    let determinant = e1.dot(&p);
    if !wanted(determinant) {
        return None;
    }
    let s = origin - a;
    let u = s.dot(&p) / determinant;
    let q = s.cross(&e1);
    let v = direction.dot(&q) / determinant;
    let distance = e2.dot(&q) / determinant;
    let within = u >= 0.0 && v >= 0.0 && u + v <= 1.0;
    (within && distance > 0.0).then_some(distance)
}
