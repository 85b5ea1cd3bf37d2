//! A surface that rounding has taken apart: corners that were one vertex and no longer have equal coordinates.
//!
//! Some programs transform each triangle on its own. Welding by equal coordinates then leaves a soup of patches.

use std::collections::HashMap;
use std::collections::hash_map::Entry;

use nalgebra::Point3;

use super::TriangleMesh;
use super::corner_table::NONE;
use super::measures::diagonal;
use super::sites::Sites;

/// Vertices this near are one, in diagonals of the bounding box: ten times what single precision rounds off.
const NEAR: f64 = 1e-6;

/// The triangles of a mesh in pieces, between the first of the vertices that lie within a millionth of the diagonal
/// of each other, and the vertices that these stand for. `None` where the mesh is not in pieces, or stays so.
///
/// A connected surface has about half as many vertices as triangles, one in pieces more than three quarters.
/// O(n) on average.
pub(super) fn snap(mesh: &TriangleMesh) -> Option<(Vec<[u32; 3]>, Sites)> {
    let mut used = vec![false; mesh.vertices.len()];
    mesh.triangles.iter().flatten().for_each(|&v| used[v as usize] = true);
    let in_pieces = |vertices: usize| 4 * vertices > 3 * mesh.triangles.len();
    let count = used.iter().filter(|&&used| used).count();
    if !in_pieces(count) {
        return None;
    }
    let mut near = Near::new(NEAR * diagonal(mesh));
    let mut name: Vec<u32> = (0..used.len() as u32).collect();
    let mut moved = Sites::default();
    for v in (0..used.len() as u32).filter(|&v| used[v as usize]) {
        let first = near.first(&mesh.vertices, v);
        if first != v {
            name[v as usize] = first;
            moved.add(v);
        }
    }
    let renamed = mesh.triangles.iter().map(|corners| corners.map(|v| name[v as usize]));
    (!in_pieces(count - moved.count)).then(|| (renamed.collect(), moved))
}

/// Vertices by cubes of four reaches a side.
struct Near {
    reach: f64,
    /// The last vertex put into each cube.
    cubes: HashMap<[i64; 3], u32>,
    /// By vertex: the one before it in its cube.
    before: HashMap<u32, u32>,
}

impl Near {
    fn new(reach: f64) -> Self {
        Self { reach, cubes: HashMap::new(), before: HashMap::new() }
    }

    /// The first vertex within reach of `v`: itself where there is none, and then it is put in.
    fn first(&mut self, vertices: &[Point3<f64>], v: u32) -> u32 {
        let place = vertices[v as usize];
        let cube = |offset: f64| [0, 1, 2].map(|k| ((place[k] + offset) / (4.0 * self.reach)).floor() as i64);
        let (low, high) = (cube(-self.reach), cube(self.reach));
        let mut found = NONE;
        for x in low[0]..=high[0] {
            for y in low[1]..=high[1] {
                for z in low[2]..=high[2] {
                    let mut other = self.cubes.get(&[x, y, z]).copied();
                    while let Some(near) = other {
                        if (vertices[near as usize] - place).norm() <= self.reach {
                            found = found.min(near);
                        }
                        other = self.before.get(&near).copied();
                    }
                }
            }
        }
        if found != NONE {
            return found;
        }
        match self.cubes.entry(cube(0.0)) {
            Entry::Occupied(mut last) => {
                self.before.insert(v, last.insert(v));
            }
            Entry::Vacant(empty) => {
                empty.insert(v);
            }
        }
        v
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two pyramids back to back over a ring of eight, each triangle with corners of its own, up to `off` away.
    fn bipyramid(off: f64) -> TriangleMesh {
        let on_ring = |k: u32, jitter: u32| {
            let angle = std::f64::consts::TAU * f64::from(k % 8) / 8.0;
            let shift = off * (f64::from(jitter) * 0.618).fract();
            Point3::new(100.0 + angle.cos() + shift, angle.sin() - shift, shift)
        };
        let apex = |k: u32| Point3::new(100.0, off * f64::from(k % 2), if k < 8 { 1.0 } else { -1.0 });
        let corners = |k: u32| [apex(k), on_ring(k, 2 * k), on_ring(k + 1, 2 * k + 1)];
        let vertices = (0..16).flat_map(corners).collect();
        TriangleMesh { vertices, triangles: (0..16).map(|k| [3 * k, 3 * k + 1, 3 * k + 2]).collect() }
    }

    #[test]
    fn corners_that_rounding_took_apart_are_one_again() {
        let (triangles, moved) = snap(&bipyramid(1e-7)).unwrap();
        assert_eq!(triangles[..2], [[0, 1, 2], [0, 2, 5]]);
        assert_eq!(triangles[7..9], [[0, 20, 1], [24, 1, 2]]);
        assert_eq!((moved.count, moved.list()), (38, "3, 4, 6, 7, 9, ...".to_owned()));
    }

    #[test]
    fn corners_that_lie_apart_stay_and_whole_surfaces_are_not_looked_at() {
        assert_eq!(snap(&bipyramid(1e-4)), None);
        let whole = TriangleMesh {
            vertices: vec![Point3::origin(), Point3::new(1e-9, 0.0, 0.0), Point3::new(1.0, 0.0, 1.0)],
            triangles: vec![[0, 1, 2], [1, 0, 2], [2, 1, 0], [1, 2, 0]],
        };
        assert_eq!(snap(&whole), None);
    }
}
