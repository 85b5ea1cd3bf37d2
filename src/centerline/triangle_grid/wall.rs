//! The distance of a point from the wall: caps are none.

use nalgebra::{Point3, Vector3};

use super::TriangleGrid;

impl TriangleGrid<'_> {
    /// Distance from a point to the nearest triangle that closes no opening.
    pub fn wall_distance(&self, point: &Point3<f64>) -> f64 {
        let mesh = &self.surface.mesh;
        let square = |t: u32| {
            if self.surface.is_cap(t) {
                return f64::INFINITY;
            }
            let corners = mesh.triangles[t as usize].map(|v| mesh.vertices[v as usize]);
            (nearest_on(&corners, point) - point).norm_squared()
        };
        self.least_around(point, square).sqrt()
    }
}

/// The point of a triangle that is nearest to a point (Ericson, *Real-Time Collision Detection*, 2005, 5.1.5).
fn nearest_on([a, b, c]: &[Point3<f64>; 3], point: &Point3<f64>) -> Point3<f64> {
    let (ab, ac) = (b - a, c - a);
    let (normal, arm) = (ab.cross(&ac), point - a);
    let square = normal.norm_squared();
    // Barycentric coordinates of the foot on the triangle's plane.
    let (v, w) = (arm.cross(&ac).dot(&normal) / square, ab.cross(&arm).dot(&normal) / square);
    if square > 0.0 && v >= 0.0 && w >= 0.0 && v + w <= 1.0 {
        return a + ab * v + ac * w;
    }
    let on_side = |from: &Point3<f64>, side: Vector3<f64>| {
        let share = (point - from).dot(&side) / side.norm_squared().max(f64::MIN_POSITIVE);
        from + side * share.clamp(0.0, 1.0)
    };
    let sides = [on_side(a, ab), on_side(b, c - b), on_side(c, -ac)];
    let away = |other: &Point3<f64>| (other - point).norm_squared();
    sides.into_iter().fold(*a, |best, other| if away(&other) < away(&best) { other } else { best })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::centerline::shapes::open_tube;
    use crate::centerline::test_surfaces::closed_surface;

    #[test]
    fn the_wall_of_a_tube_is_a_radius_away_also_beside_its_caps() {
        let surface = closed_surface(&open_tube(8.0, 33, 96));
        let grid = TriangleGrid::new(&surface);
        for (x, z, expected) in
            [(0.0, 4.0, 1.0), (0.0, 0.0, 1.0), (0.25, 0.01, 0.75), (0.5, 7.9, 0.5), (3.0, 4.0, 2.0)]
        {
            let found = grid.wall_distance(&Point3::new(x, 0.0, z));
            assert!((found - expected).abs() < 1e-3, "{found} where {expected} is");
        }
        assert!((grid.wall_distance(&Point3::new(1.0, 0.0, 11.0)) - 3.0).abs() < 1e-12);
    }

    #[test]
    fn a_needle_without_area_has_a_nearest_point_too() {
        let corners = [0.0, 1.0, 2.0].map(|x| Point3::new(x, 0.0, 0.0));
        assert_eq!(nearest_on(&corners, &Point3::new(1.5, 1.0, 0.0)), Point3::new(1.5, 0.0, 0.0));
        assert_eq!(nearest_on(&corners, &Point3::new(9.0, 1.0, 0.0)), Point3::new(2.0, 0.0, 0.0));
    }
}
