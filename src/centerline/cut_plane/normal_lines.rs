//! The point nearest to a set of normal lines in the least-squares sense (eq. 10).

use nalgebra::{Matrix3, Point3, Vector3};

use crate::centerline::thinning::covariance::PrincipalAxes;

/// Share of the largest possible eigenvalue below which the lines are taken as parallel:
/// their directions then lie within about 2.5 degrees of each other.
const PARALLEL: f64 = 2e-3;

/// The normal equations of eq. 10 over a set of lines `x_i + t v_i`; those of two sets add.
///
/// `sum (I - v_i v_iᵀ) x = sum (I - v_i v_iᵀ) x_i`, where the printed square of the cross product
/// is `|(x - x_i) x v_i|² = (x - x_i)ᵀ (I - v_i v_iᵀ) (x - x_i)` for unit `v_i`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NormalLines {
    count: f64,
    matrix: Matrix3<f64>,
    right: Vector3<f64>,
    sum: Vector3<f64>,
}

impl Default for NormalLines {
    fn default() -> Self {
        Self { count: 0.0, matrix: Matrix3::zeros(), right: Vector3::zeros(), sum: Vector3::zeros() }
    }
}

impl NormalLines {
    /// Adds the line through `point` along the unit vector `direction`.
    pub fn add(&mut self, point: Point3<f64>, direction: Vector3<f64>) {
        let across = Matrix3::identity() - direction * direction.transpose();
        self.count += 1.0;
        self.matrix += across;
        self.right += across * point.coords;
        self.sum += point.coords;
    }

    /// Adds all lines of another set; a line in both counts twice.
    pub fn extend(&mut self, other: &Self) {
        self.count += other.count;
        self.matrix += other.matrix;
        self.right += other.right;
        self.sum += other.sum;
    }

    /// How many lines.
    pub fn count(&self) -> f64 {
        self.count
    }

    /// The minimiser of eq. 10; `None` for no lines.
    ///
    /// Lines around a tube fix it: across the axis by where they meet, along the axis by the mean of
    /// their points. Where all lines are parallel (a flat patch) nothing fixes it along them, and it
    /// stays at the height of the points' mean.
    pub fn nearest_point(&self) -> Option<Point3<f64>> {
        if self.count < 1.0 {
            return None;
        }
        let centroid = self.sum / self.count;
        let residual = self.right - self.matrix * centroid;
        let axes = PrincipalAxes::of(&self.matrix);
        let mut shift = Vector3::zeros();
        for (value, vector) in axes.values.iter().zip(&axes.vectors) {
            if *value > PARALLEL * self.count {
                shift += vector * (vector.dot(&residual) / value);
            }
        }
        Some(Point3::from(centroid + shift))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lines(pairs: impl IntoIterator<Item = (Point3<f64>, Vector3<f64>)>) -> NormalLines {
        let mut lines = NormalLines::default();
        pairs.into_iter().for_each(|(point, direction)| lines.add(point, direction));
        lines
    }

    #[test]
    fn normals_of_a_third_of_a_cylinder_meet_on_its_axis() {
        let set = lines((0..60).map(|k| {
            let angle = f64::from(k % 20) * 0.1;
            let normal = Vector3::new(angle.cos(), angle.sin(), 0.0);
            (Point3::new(7.0, -2.0, f64::from(k / 20)) + normal * 3.0, normal)
        }));
        let centre = set.nearest_point().unwrap();
        assert!((centre - Point3::new(7.0, -2.0, 1.0)).norm() < 1e-9, "{centre}");
    }

    #[test]
    fn normals_of_a_sphere_meet_at_its_centre() {
        let centre = Point3::new(1.0, 2.0, 3.0);
        let directions = [Vector3::x(), Vector3::y(), Vector3::z(), Vector3::new(1.0, 1.0, 1.0).normalize()];
        let set = lines(directions.map(|normal| (centre + normal * 4.0, normal)));
        assert!((set.nearest_point().unwrap() - centre).norm() < 1e-9);
    }

    #[test]
    fn parallel_lines_leave_the_point_among_them() {
        let set = lines((0..9).map(|k| (Point3::new(f64::from(k % 3), f64::from(k / 3), 5.0), Vector3::z())));
        assert!((set.nearest_point().unwrap() - Point3::new(1.0, 1.0, 5.0)).norm() < 1e-12);
        assert_eq!(NormalLines::default().nearest_point(), None);
    }

    #[test]
    fn two_sets_add() {
        let a =
            lines([(Point3::new(1.0, 0.0, 0.0), Vector3::x()), (Point3::new(0.0, 1.0, 0.0), Vector3::y())]);
        let b =
            lines([(Point3::new(0.0, 1.0, 2.0), Vector3::y()), (Point3::new(-1.0, 0.0, 2.0), Vector3::x())]);
        let mut both = a;
        both.extend(&b);
        assert_eq!(both.count(), 4.0);
        assert!((both.nearest_point().unwrap() - Point3::new(0.0, 0.0, 1.0)).norm() < 1e-12);
    }
}
