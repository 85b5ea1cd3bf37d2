//! A smooth curve near given points: least squares with a penalty on its third differences
//! (Whittaker 1923; Eilers, *A perfect smoother*, 2003), on uneven spacing.
//!
//! It does the work of the paper's Laplacian smoothing and thinning (IV.C) for the preset `default`:
//! a straight or evenly bent line is left where it is, so nothing shrinks toward the inside of bends.

use nalgebra::{Matrix3, Point3, Vector3};

use super::banded::Banded;

/// Moves `targets` onto the smoothest curve that respects their `weights` (3 x 3, identity: firm).
///
/// `third` and `second` weigh the squared differences against a point of weight 1 at mean spacing;
/// `third` by the number of the first point that takes part. `abscissa` ascends strictly. Points with a
/// huge weight stay. O(n).
pub fn fit_curve(
    targets: &[Point3<f64>],
    weights: &[Matrix3<f64>],
    abscissa: &[f64],
    third: impl Fn(usize) -> f64,
    second: f64,
) -> Vec<Point3<f64>> {
    CurveFit::new(targets, weights, abscissa).curve(third, second)
}

/// Targets, weights and spacing of a curve that is fitted several times, more and less stiff.
///
/// `WIDTH`: how many points take part in a difference, times how many coordinates move.
pub struct CurveFit<'a, const WIDTH: usize> {
    /// The curve is told from the first of them on.
    points: &'a [Point3<f64>],
    /// The first coordinates, that move; the others stay.
    axes: usize,
    /// The normal equations without a penalty.
    system: Banded<WIDTH>,
    right: Vec<f64>,
    seconds: Vec<[f64; 3]>,
    thirds: Vec<[f64; 4]>,
}

impl<'a> CurveFit<'a, 12> {
    /// As for [`fit_curve`].
    pub fn new(targets: &'a [Point3<f64>], weights: &[Matrix3<f64>], abscissa: &[f64]) -> Self {
        Self::pulled(targets, 3, weights, |_| Vector3::zeros(), abscissa)
    }
}

impl<'a, const WIDTH: usize> CurveFit<'a, WIDTH> {
    /// The same where the targets are not known, only the right sides: how `pull` draws each of `points`, its weight
    /// times the way to its target. Only the first `axes` coordinates of the points move; the others are all alike.
    pub fn pulled(
        points: &'a [Point3<f64>],
        axes: usize,
        weights: &[Matrix3<f64>],
        pull: impl Fn(usize) -> Vector3<f64>,
        abscissa: &[f64],
    ) -> Self {
        /// Holds directions that nothing else pins.
        const HOLD: f64 = 1e-9;
        let mut system = Banded::new(axes * points.len());
        let mut right = Vec::with_capacity(axes * points.len());
        for (i, (point, weight)) in points.iter().zip(weights).enumerate() {
            let away = point - points[0];
            right.extend_from_slice(&(weight * away + away * HOLD + pull(i)).as_slice()[..axes]);
            for row in 0..axes {
                for column in row..axes {
                    system.add(axes * i + row, axes * i + column, weight[(row, column)]);
                }
                system.add(axes * i + row, axes * i + row, HOLD);
            }
        }
        Self { points, axes, system, right, seconds: differences(abscissa), thirds: differences(abscissa) }
    }

    /// The curve for weights of the squared third and second differences; third ones only where `WIDTH` has room for
    /// them. O(n).
    pub fn curve(&self, third: impl Fn(usize) -> f64, second: f64) -> Vec<Point3<f64>> {
        let Some(origin) = self.points.first().filter(|_| self.points.len() >= 3) else {
            return self.points.to_vec();
        };
        let mut system = self.system.clone();
        penalise(&mut system, self.axes, &self.seconds, |_| second);
        if WIDTH >= 4 * self.axes {
            penalise(&mut system, self.axes, &self.thirds, third);
        }
        let mut moved = self.right.clone();
        system.solve(&mut moved);
        let way = |moved: &[f64]| Vector3::from_fn(|axis, _| moved.get(axis).copied().unwrap_or(0.0));
        moved.chunks_exact(self.axes).map(|moved| origin + way(moved)).collect()
    }
}

/// The coefficients of the divided differences over `POINTS` neighbours, scaled so that on even spacing they are the
/// plain differences (1, -2, 1 and -1, 3, -3, 1).
fn differences<const POINTS: usize>(abscissa: &[f64]) -> Vec<[f64; POINTS]> {
    let order = POINTS - 1;
    let factorial: f64 = (1..=order).map(|k| k as f64).product();
    let of = |s: &[f64]| {
        let step = (s[order] - s[0]) / order as f64;
        std::array::from_fn(|i| {
            let product: f64 = (0..POINTS).filter(|&j| j != i).map(|j| s[i] - s[j]).product();
            factorial * step.powi(order as i32) / product
        })
    };
    abscissa.windows(POINTS).map(of).collect()
}

/// Adds the squares of differences, each by its weight.
fn penalise<const POINTS: usize, const WIDTH: usize>(
    system: &mut Banded<WIDTH>,
    axes: usize,
    differences: &[[f64; POINTS]],
    weight: impl Fn(usize) -> f64,
) {
    for (start, coefficient) in differences.iter().enumerate() {
        let weight = weight(start);
        if weight == 0.0 {
            continue;
        }
        for i in 0..POINTS {
            for j in i..POINTS {
                let value = weight * coefficient[i] * coefficient[j];
                for axis in 0..axes {
                    system.add(axes * (start + i) + axis, axes * (start + j) + axis, value);
                }
            }
        }
    }
}

/// Position, unit tangent and curvature vector at the end of a run of points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CurveEnd {
    pub point: Point3<f64>,
    pub tangent: Vector3<f64>,
    pub curvature: Vector3<f64>,
}

impl CurveEnd {
    /// Least squares parabola through the last of `points` (weights ascending to the end); a line for
    /// fewer than five. `reach` bounds how far back, along the curve.
    pub fn of(points: &[Point3<f64>], reach: f64) -> Option<Self> {
        let (&end, rest) = points.split_last()?;
        let mut run = vec![(0.0, Vector3::zeros())];
        let (mut back, mut previous) = (0.0, end);
        for &p in rest.iter().rev() {
            back -= (p - previous).norm();
            previous = p;
            run.push((back, p - end));
            if -back > reach && run.len() >= 3 {
                break;
            }
        }
        if run.len() < 2 || back == 0.0 {
            return None;
        }
        let quadratic = if run.len() >= 5 { 1.0 } else { 0.0 };
        let mut normal = Matrix3::zeros();
        let mut right = Matrix3::zeros();
        for (s, d) in &run {
            let x = s / -back;
            let basis = Vector3::new(1.0, x, quadratic * 0.5 * x * x);
            normal += basis * basis.transpose();
            right += basis * d.transpose();
        }
        normal[(2, 2)] += 1.0 - quadratic + 1e-6;
        let solved = normal.try_inverse()? * right;
        let slope: Vector3<f64> = solved.row(1).transpose() / -back;
        let tangent = slope.try_normalize(0.0)?;
        let bend: Vector3<f64> = solved.row(2).transpose() / (back * back);
        let curvature = bend - tangent * tangent.dot(&bend);
        let offset: Vector3<f64> = solved.row(0).transpose();
        Some(Self { point: end + offset, tangent, curvature })
    }

    /// The curve continued by `s`, with its direction there.
    pub fn at(&self, s: f64) -> (Point3<f64>, Vector3<f64>) {
        let direction = (self.tangent + self.curvature * s).normalize();
        (self.point + self.tangent * s + self.curvature * (0.5 * s * s), direction)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STIFF: f64 = 200.0;

    #[test]
    fn a_parabola_is_left_alone_and_noise_is_not() {
        let abscissa: Vec<f64> = (0..60).map(|i| f64::from(i) + 0.3 * f64::from(i % 3)).collect();
        let on = |s: f64| Point3::new(s, 0.01 * s * s, -0.005 * s * s);
        let clean: Vec<_> = abscissa.iter().map(|&s| on(s)).collect();
        let weights = vec![Matrix3::identity(); 60];
        for (p, q) in clean.iter().zip(fit_curve(&clean, &weights, &abscissa, |_| STIFF, 0.0)) {
            assert!((p - q).norm() < 1e-6, "{p} moved to {q}");
        }
        let sign = |i: usize| if i.is_multiple_of(2) { 0.1 } else { -0.1 };
        let noisy: Vec<_> = clean.iter().enumerate().map(|(i, p)| p + Vector3::y() * sign(i)).collect();
        let fitted = fit_curve(&noisy, &weights, &abscissa, |_| STIFF, 0.0);
        let worst = fitted.iter().zip(&clean).map(|(p, q)| (p - q).norm()).fold(0.0, f64::max);
        assert!(worst < 0.04, "noise of 0.1 is left at {worst}");
    }

    #[test]
    fn the_end_of_a_circle_continues_on_it() {
        let points: Vec<_> = (0..=20)
            .map(|i| 0.02 * f64::from(i))
            .map(|a: f64| Point3::new(10.0 * a.sin(), 10.0 * a.cos(), 0.0))
            .collect();
        let end = CurveEnd::of(&points, 3.0).unwrap();
        let (ahead, _) = end.at(2.0);
        assert!((ahead.coords.norm() - 10.0).abs() < 0.02, "{ahead}");
        assert!((end.curvature.norm() - 0.1).abs() < 0.01);
    }
}
