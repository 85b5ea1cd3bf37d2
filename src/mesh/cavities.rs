//! Closed surfaces inside another one: no vessels of their own.

use nalgebra::Point3;

use super::TriangleMesh;
use super::measures::{bounds, signed_volume, total_area};

/// A surface whose box is smaller than this share of the largest is not looked at: many specks would take long.
const SPECK: f64 = 0.02;

/// Volume of a surface over its area to the power of 3/2 from which on it encloses something; a sphere has 0.094.
const HOLLOW: f64 = 1e-5;

/// Which of some closed surfaces lie inside another of them. O(surfaces x those that enclose something), and O(triangles)
/// for each pair whose boxes lie one inside the other.
pub fn inside_others(surfaces: &[&TriangleMesh]) -> Vec<bool> {
    let boxes: Vec<_> = surfaces.iter().map(|mesh| bounds(mesh)).collect();
    let size = |number: usize| (boxes[number][1] - boxes[number][0]).norm();
    let largest = (0..surfaces.len()).map(size).fold(0.0, f64::max);
    let encloses = |&outer: &usize| {
        let mesh = surfaces[outer];
        size(outer) >= SPECK * largest && signed_volume(mesh).abs() > HOLLOW * total_area(mesh).powf(1.5)
    };
    let outers: Vec<usize> = (0..surfaces.len()).filter(encloses).collect();
    let nested = |inner: usize, outer: usize| {
        let ([low, high], [least, most]) = (boxes[inner], boxes[outer]);
        inner != outer && (0..3).all(|axis| least[axis] < low[axis] && high[axis] < most[axis])
    };
    let within =
        |inner: usize, outer: usize| nested(inner, outer) && is_inside(surfaces[inner], surfaces[outer]);
    let inside =
        |inner: usize| size(inner) >= SPECK * largest && outers.iter().any(|&outer| within(inner, outer));
    (0..surfaces.len()).map(inside).collect()
}

/// Whether a few vertices of a surface, evenly by number, all lie inside another.
fn is_inside(inner: &TriangleMesh, outer: &TriangleMesh) -> bool {
    const SAMPLES: usize = 4;
    let step = inner.vertices.len().div_ceil(SAMPLES).max(1);
    inner.vertices.iter().step_by(step).all(|vertex| winds_around(outer, vertex))
}

/// Whether a closed surface winds around a point: the sum of its triangles' solid angles is not nothing (Van Oosterom
/// and Strackee, *The solid angle of a plane triangle*, 1983).
fn winds_around(surface: &TriangleMesh, point: &Point3<f64>) -> bool {
    let half_angle = |triangle: &[u32; 3]| {
        let [a, b, c] = triangle.map(|v| surface.vertices[v as usize] - point);
        let (p, q, r) = (a.norm(), b.norm(), c.norm());
        let below = p * q * r + a.dot(&b) * r + b.dot(&c) * p + c.dot(&a) * q;
        a.dot(&b.cross(&c)).atan2(below)
    };
    let halves: f64 = surface.triangles.iter().map(half_angle).sum();
    halves.abs() > std::f64::consts::PI
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A cube from `low` to `low + edge` along every axis.
    fn cube(low: f64, edge: f64) -> TriangleMesh {
        let at = |i: u32, axis: u32| low + edge * f64::from(i >> axis & 1);
        let vertices = (0..8).map(|i| Point3::new(at(i, 0), at(i, 1), at(i, 2))).collect();
        let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let triangles = quads.iter().flat_map(|q| [[q[0], q[1], q[2]], [q[0], q[2], q[3]]]).collect();
        TriangleMesh { vertices, triangles }
    }

    #[test]
    fn a_cube_in_a_cube_is_inside_and_one_across_its_side_is_not() {
        let (outer, inner, across) = (cube(0.0, 4.0), cube(1.0, 1.0), cube(3.5, 1.0));
        assert_eq!(inside_others(&[&outer, &inner, &across]), [false, true, false]);
    }

    #[test]
    fn a_point_beside_a_surface_is_not_inside_it() {
        assert!(winds_around(&cube(0.0, 1.0), &Point3::new(0.5, 0.5, 0.999)));
        assert!(!winds_around(&cube(0.0, 1.0), &Point3::new(0.5, 0.5, 1.001)));
    }
}
