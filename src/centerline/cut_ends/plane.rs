//! The plane that most of a set of points lies near.

use nalgebra::{Matrix3, Point3, Vector3};

/// A plane through `point`; `normal` is a unit vector.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plane {
    pub point: Point3<f64>,
    pub normal: Vector3<f64>,
}

impl Plane {
    /// Least squares in the distance, where points far off count ever less (Geman and McClure 1987): those off by
    /// `scale` count a quarter. Each point has a weight. `None` of points that span no plane.
    pub fn near(points: &[(Point3<f64>, f64)], scale: f64) -> Option<Self> {
        /// Rounds of weighing anew.
        const ROUNDS: usize = 8;
        let mut plane = Self::through(points.iter().copied())?;
        for _ in 0..ROUNDS {
            let weigh = |&(point, weight): &(Point3<f64>, f64)| {
                let off = plane.height(&point) / scale;
                (point, weight / (1.0 + off * off).powi(2))
            };
            plane = Self::through(points.iter().map(weigh))?;
        }
        Some(plane)
    }

    /// How far a point lies from it, positive where the normal leads.
    pub fn height(&self, point: &Point3<f64>) -> f64 {
        (point - self.point).dot(&self.normal)
    }

    fn through(points: impl Iterator<Item = (Point3<f64>, f64)> + Clone) -> Option<Self> {
        let (mut moment, mut total) = (Vector3::zeros(), 0.0);
        for (point, weight) in points.clone() {
            moment += point.coords * weight;
            total += weight;
        }
        let point = Point3::from(moment / total);
        let mut spread = Matrix3::zeros();
        for (other, weight) in points {
            let arm = other - point;
            spread += arm * arm.transpose() * (weight / total);
        }
        if !spread.iter().all(|entry| entry.is_finite()) {
            return None;
        }
        let eigen = spread.symmetric_eigen();
        let normal = eigen.eigenvectors.column(eigen.eigenvalues.imin()).into_owned();
        normal.try_normalize(0.5).map(|normal| Self { point, normal })
    }
}
