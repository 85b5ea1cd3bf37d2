//! The vertices of a surface around a point.

use nalgebra::Point3;

use super::TriangleGrid;

impl TriangleGrid<'_> {
    /// The vertices of triangles that are closer to a point than `radius`, in the order of their numbers.
    pub fn vertices_within(&self, centre: &Point3<f64>, radius: f64) -> Vec<Point3<f64>> {
        let vertices = &self.surface.mesh.vertices;
        let mut found = Vec::new();
        self.for_each_cell(&self.cells_around(centre, radius), |cell| {
            let corners = self.of_cell(cell).iter().flat_map(|&t| self.surface.mesh.triangles[t as usize]);
            found.extend(corners.filter(|&v| (vertices[v as usize] - centre).norm() < radius));
        });
        found.sort_unstable();
        found.dedup();
        found.into_iter().map(|v| vertices[v as usize]).collect()
    }

    /// Distance from a point to the nearest vertex of a triangle.
    pub fn clearance(&self, point: &Point3<f64>) -> f64 {
        let vertices = &self.surface.mesh.vertices;
        let square = |v: u32| (vertices[v as usize] - point).norm_squared();
        let nearest = |t: u32| {
            let [a, b, c] = self.surface.mesh.triangles[t as usize].map(square);
            a.min(b).min(c)
        };
        self.least_around(point, nearest).sqrt()
    }

    /// The least square of the distances of triangles from a point, as `square` tells each. Looks into ever larger boxes of
    /// cubes.
    pub(super) fn least_around(&self, point: &Point3<f64>, square: impl Fn(u32) -> f64) -> f64 {
        let mut reach = self.cell;
        loop {
            let mut least = f64::INFINITY;
            self.for_each_cell(&self.cells_around(point, reach), |cell| {
                least = self.of_cell(cell).iter().fold(least, |least, &t| least.min(square(t)));
            });
            let more = |k: usize| point[k] - reach > self.low[k] || point[k] + reach < self.high[k];
            // Whatever lies outside the box is farther away.
            if least.sqrt() <= reach || !(0..3).any(more) {
                return least;
            }
            reach *= 2.0;
        }
    }

    /// The cubes that a box touches, `reach` to each side of its middle.
    fn cells_around(&self, middle: &Point3<f64>, reach: f64) -> [[u16; 3]; 2] {
        [-reach, reach].map(|arm| [0, 1, 2].map(|axis| self.cell_at(middle[axis] + arm, axis)))
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::centerline::shapes::torus;
    use crate::centerline::test_surfaces::closed_surface;

    proptest! {
        #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

        #[test]
        fn what_lies_around_a_point_is_what_a_full_scan_finds(
            place in prop::array::uniform3(-20.0..20.0_f64),
            radius in 0.0..9.0_f64,
        ) {
            let surface = closed_surface(&torus(10.0, 1.5, 40, 12));
            let (grid, place) = (TriangleGrid::new(&surface), Point3::from(place));
            let distances = || surface.mesh.vertices.iter().map(|vertex| (vertex - place).norm());
            prop_assert_eq!(grid.clearance(&place), distances().fold(f64::INFINITY, f64::min));
            let near = surface.mesh.vertices.iter().filter(|vertex| (*vertex - place).norm() < radius);
            let near: Vec<_> = near.copied().collect();
            prop_assert_eq!(grid.vertices_within(&place, radius), near);
        }
    }
}
