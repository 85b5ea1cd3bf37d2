//! Small surfaces made on the spot.

use std::f64::consts::TAU;

use nalgebra::Point3;
use rosaline::mesh::TriangleMesh;
use rosaline::mesh::format::write_stl_binary;

/// An open tube of radius 1 along a quarter of a circle of radius 10, `rings` rings of `sides` vertices.
pub fn tube(rings: u32, sides: u32) -> TriangleMesh {
    let mut mesh = TriangleMesh::default();
    for ring in 0..rings {
        let bend = TAU / 4.0 * f64::from(ring) / f64::from(rings - 1);
        for side in 0..sides {
            let around = TAU * f64::from(side) / f64::from(sides);
            let reach = 10.0 + around.cos();
            mesh.vertices.push(Point3::new(reach * bend.cos(), reach * bend.sin(), around.sin()));
        }
    }
    for ring in 0..rings - 1 {
        for side in 0..sides {
            let next = (side + 1) % sides;
            let (a, b) = (ring * sides + side, ring * sides + next);
            mesh.triangles.extend([[a, a + sides, b], [b, a + sides, b + sides]]);
        }
    }
    mesh
}

/// Binary STL of a small tube.
pub fn small() -> Vec<u8> {
    stl(&tube(60, 24))
}

/// Binary STL of a mesh whose extraction, smoothed first, takes many times as long as its upload.
pub fn large() -> Vec<u8> {
    stl(&tube(300, 60))
}

/// Binary STL of a mesh.
pub fn stl(mesh: &TriangleMesh) -> Vec<u8> {
    let mut bytes = Vec::new();
    write_stl_binary(mesh, &mut bytes).unwrap();
    bytes
}

/// A closed ball: a surface without a centerline.
pub fn ball() -> Vec<u8> {
    let (rings, sides) = (24_u32, 24_u32);
    let mut mesh = TriangleMesh::default();
    let pole = |z| Point3::new(0.0, 0.0, z);
    mesh.vertices.push(pole(1.0));
    for ring in 1..rings {
        let (sine, cosine) = (TAU / 2.0 * f64::from(ring) / f64::from(rings)).sin_cos();
        for side in 0..sides {
            let around = TAU * f64::from(side) / f64::from(sides);
            mesh.vertices.push(Point3::new(sine * around.cos(), sine * around.sin(), cosine));
        }
    }
    mesh.vertices.push(pole(-1.0));
    let last = 1 + (rings - 1) * sides;
    for side in 0..sides {
        let next = (side + 1) % sides;
        mesh.triangles.push([0, 1 + side, 1 + next]);
        mesh.triangles.push([last, last - sides + next, last - sides + side]);
        for ring in 0..rings - 2 {
            let (a, b) = (1 + ring * sides + side, 1 + ring * sides + next);
            mesh.triangles.extend([[a, a + sides, b], [b, a + sides, b + sides]]);
        }
    }
    stl(&mesh)
}
