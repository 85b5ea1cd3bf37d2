//! Surfaces of known shape for the unit tests of the stages.

use std::collections::BTreeMap;
use std::f64::consts::{PI, TAU};

use nalgebra::{Point3, Vector3};

use crate::mesh::TriangleMesh;
use crate::mesh::preparation::{Surface, prepare};

/// The only component of a mesh, prepared.
pub fn closed_surface(mesh: &TriangleMesh) -> Surface {
    let mut prepared = prepare(mesh).unwrap();
    assert_eq!(prepared.components.len(), 1, "the test surface is in one piece");
    prepared.components.remove(0)
}

/// A surface of revolution around z: `profile` gives radius and z from pole to pole (radius 0 there).
pub fn revolved(profile: &[(f64, f64)], sides: usize) -> TriangleMesh {
    let mut mesh = TriangleMesh::default();
    let rings = &profile[1..profile.len() - 1];
    for (k, &(radius, z)) in rings.iter().enumerate() {
        for i in 0..sides {
            let angle = TAU * (i as f64 + 0.5 * (k % 2) as f64) / sides as f64;
            mesh.vertices.push(Point3::new(radius * angle.cos(), radius * angle.sin(), z));
        }
    }
    let at = |k: usize, i: usize| (k * sides + i % sides) as u32;
    for k in 0..rings.len() - 1 {
        for i in 0..sides {
            let j = i + k % 2;
            let (a, b, c, d) = (at(k, i), at(k, i + 1), at(k + 1, j), at(k + 1, j + 1));
            if k % 2 == 0 {
                mesh.triangles.extend([[a, b, c], [b, d, c]]);
            } else {
                mesh.triangles.extend([[a, d, c], [a, b, d]]);
            }
        }
    }
    let (bottom, top) = (mesh.vertices.len() as u32, mesh.vertices.len() as u32 + 1);
    mesh.vertices.push(Point3::new(0.0, 0.0, profile[0].1));
    mesh.vertices.push(Point3::new(0.0, 0.0, profile[profile.len() - 1].1));
    for i in 0..sides {
        mesh.triangles.push([bottom, at(0, i + 1), at(0, i)]);
        mesh.triangles.push([top, at(rings.len() - 1, i), at(rings.len() - 1, i + 1)]);
    }
    mesh
}

/// A tube along z from 0 to `length` with half spheres on its ends.
pub fn capsule(radius: f64, length: f64, sides: usize) -> TriangleMesh {
    let edge = TAU * radius / sides as f64;
    let arc = ((0.5 * PI * radius / edge).ceil() as usize).max(2);
    let wall = ((length / edge).ceil() as usize).max(2);
    let polar = |k: usize| 0.5 * PI * k as f64 / arc as f64;
    let mut profile: Vec<(f64, f64)> =
        (0..arc).map(|k| (radius * polar(k).sin(), -radius * polar(k).cos())).collect();
    profile.extend((0..=wall).map(|k| (radius, length * k as f64 / wall as f64)));
    profile.extend((0..arc).rev().map(|k| (radius * polar(k).sin(), length + radius * polar(k).cos())));
    revolved(&profile, sides)
}

/// The faces between the unit voxels whose centres are `inside` and the others, within a box of voxels.
pub fn voxels(low: [i32; 3], high: [i32; 3], inside: impl Fn(Vector3<f64>) -> bool) -> TriangleMesh {
    let filled = |v: [i32; 3]| {
        (0..3).all(|k| (low[k]..high[k]).contains(&v[k]))
            && inside(Vector3::from(v.map(|c| f64::from(c) + 0.5)))
    };
    let mut names = BTreeMap::new();
    let mut mesh = TriangleMesh::default();
    let mut vertex = |mesh: &mut TriangleMesh, corner: [i32; 3]| {
        *names.entry(corner).or_insert_with(|| {
            mesh.vertices.push(Point3::from(Vector3::from(corner.map(f64::from))));
            mesh.vertices.len() as u32 - 1
        })
    };
    for x in low[0]..high[0] {
        for y in low[1]..high[1] {
            for z in (low[2]..high[2]).filter(|&z| filled([x, y, z])) {
                for (axis, side) in (0..3).flat_map(|axis| [(axis, 0), (axis, 1)]) {
                    let mut next = [x, y, z];
                    next[axis] += 2 * side - 1;
                    if filled(next) {
                        continue;
                    }
                    let quad = [(0, 0), (1, 0), (1, 1), (0, 1)].map(|(i, j)| {
                        let mut corner = [x, y, z];
                        corner[axis] += side;
                        corner[(axis + 1) % 3] += i;
                        corner[(axis + 2) % 3] += j;
                        vertex(&mut mesh, corner)
                    });
                    let [a, b, c, d] = quad;
                    let outward = |t: [u32; 3]| if side == 1 { t } else { [t[0], t[2], t[1]] };
                    mesh.triangles.extend([outward([a, b, c]), outward([a, c, d])]);
                }
            }
        }
    }
    mesh
}
