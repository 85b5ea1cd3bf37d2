//! Closed-form surfaces for the unit tests of the method.

use std::f64::consts::{PI, TAU};

use nalgebra::{Point3, Vector3};

use crate::mesh::TriangleMesh;

/// A grid of `rings` x `sides` points, closed around; `wrap` closes it along as well.
fn grid(rings: usize, sides: usize, wrap: bool, at: impl Fn(f64, f64) -> Point3<f64>) -> TriangleMesh {
    let mut mesh = TriangleMesh::default();
    let last = if wrap { rings } else { rings - 1 };
    for i in 0..rings {
        for j in 0..sides {
            mesh.vertices.push(at(i as f64 / last as f64, TAU * j as f64 / sides as f64));
        }
    }
    for i in 0..last {
        for j in 0..sides {
            let v = |i: usize, j: usize| ((i % rings) * sides + j % sides) as u32;
            mesh.triangles.push([v(i, j), v(i, j + 1), v(i + 1, j)]);
            mesh.triangles.push([v(i, j + 1), v(i + 1, j + 1), v(i + 1, j)]);
        }
    }
    mesh
}

/// A straight tube of radius 1 from z = 0 to `length`, open at both ends.
pub fn open_tube(length: f64, rings: usize, sides: usize) -> TriangleMesh {
    grid(rings, sides, false, |s, a| Point3::new(a.cos(), a.sin(), s * length))
}

/// A tube of radius `thin` around a circle of radius `wide` in the plane z = 0.
pub fn torus(wide: f64, thin: f64, rings: usize, sides: usize) -> TriangleMesh {
    grid(rings, sides, true, |s, a| {
        let out = Vector3::new((TAU * s).cos(), (TAU * s).sin(), 0.0);
        // The section turns so that normals point outward with this winding.
        Point3::origin() + out * (wide + thin * a.cos()) - Vector3::z() * (thin * a.sin())
    })
}

/// A sphere of radius 1 whose poles are small openings (capped by the preparation).
pub fn sphere(rings: usize, sides: usize) -> TriangleMesh {
    grid(rings, sides, false, |s, a| {
        let polar = PI * (0.01 + 0.98 * s);
        Point3::new(polar.sin() * a.cos(), polar.sin() * a.sin(), -polar.cos())
    })
}
