//! Covariance of points or directions, and its eigenvalues: the ground of eqs. 5, 7 and 9.

use nalgebra::{Matrix3, Vector3};

/// Count, sum and sum of outer products of 3-vectors; sums of two sets add.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Moments {
    count: f64,
    sum: Vector3<f64>,
    outer: Matrix3<f64>,
}

impl Default for Moments {
    fn default() -> Self {
        Self { count: 0.0, sum: Vector3::zeros(), outer: Matrix3::zeros() }
    }
}

impl Moments {
    /// Of a set of vectors.
    pub fn of(vectors: impl IntoIterator<Item = Vector3<f64>>) -> Self {
        let mut moments = Self::default();
        vectors.into_iter().for_each(|vector| moments.add(vector));
        moments
    }

    pub fn add(&mut self, vector: Vector3<f64>) {
        self.count += 1.0;
        self.sum += vector;
        self.outer += vector * vector.transpose();
    }

    /// Adds another set.
    pub fn extend(&mut self, other: &Self) {
        self.count += other.count;
        self.sum += other.sum;
        self.outer += other.outer;
    }

    /// How many vectors.
    pub fn count(&self) -> f64 {
        self.count
    }

    /// Zero for an empty set.
    pub fn mean(&self) -> Vector3<f64> {
        if self.count > 0.0 { self.sum / self.count } else { Vector3::zeros() }
    }

    /// `E[x xᵀ] - E[x] E[x]ᵀ`, 3 x 3, in the square of the vectors' unit; zero for an empty set.
    ///
    /// Differences of large numbers cancel: add points relative to one that is near them.
    pub fn covariance(&self) -> Matrix3<f64> {
        if self.count > 0.0 {
            let mean = self.mean();
            self.outer / self.count - mean * mean.transpose()
        } else {
            Matrix3::zeros()
        }
    }

    pub fn principal_axes(&self) -> PrincipalAxes {
        PrincipalAxes::of(&self.covariance())
    }
}

/// Eigenvalues and unit eigenvectors of a symmetric 3 x 3 matrix, largest eigenvalue first.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PrincipalAxes {
    /// Descending; not negative where the matrix is a covariance.
    pub values: [f64; 3],
    /// Orthonormal; the sign of each is arbitrary.
    pub vectors: [Vector3<f64>; 3],
}

impl PrincipalAxes {
    pub fn of(symmetric: &Matrix3<f64>) -> Self {
        let eigen = symmetric.symmetric_eigen();
        let mut order = [0, 1, 2];
        order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
        Self {
            values: order.map(|k| eigen.eigenvalues[k]),
            vectors: order.map(|k| eigen.eigenvectors.column(k).into_owned()),
        }
    }

    /// The direction along which the set varies least.
    pub fn least(&self) -> Vector3<f64> {
        self.vectors[2]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_box_of_points_has_its_variances_as_eigenvalues() {
        let corner = |k: i32, bit: i32, half: f64| if k >> bit & 1 == 0 { -half } else { half };
        let offset = Vector3::new(4.0, -3.0, 2.0);
        let moments = Moments::of(
            (0..8).map(|k| offset + Vector3::new(corner(k, 0, 1.0), corner(k, 1, 3.0), corner(k, 2, 2.0))),
        );
        let axes = moments.principal_axes();
        for (value, expected) in axes.values.iter().zip([9.0, 4.0, 1.0]) {
            assert!((value - expected).abs() < 1e-12, "{value} is not {expected}");
        }
        assert!((axes.vectors[0].y.abs() - 1.0).abs() < 1e-12);
        assert!((axes.least().x.abs() - 1.0).abs() < 1e-12);
        assert!((moments.mean() - offset).norm() < 1e-12);
    }

    #[test]
    fn sets_add() {
        let (a, b) = (Vector3::new(1.0, 2.0, 3.0), Vector3::new(-2.0, 0.5, 1.0));
        let mut joined = Moments::of([a, b]);
        joined.extend(&Moments::of([b, b]));
        assert!((Moments::of([a, b, b, b]).covariance() - joined.covariance()).norm() < 1e-12);
    }

    #[test]
    fn an_empty_set_is_zero_and_never_nan() {
        assert_eq!(Moments::default().covariance(), Matrix3::zeros());
        assert_eq!(Moments::default().principal_axes().values, [0.0; 3]);
    }
}
