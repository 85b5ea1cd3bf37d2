//! A branch's line continued past its last section, with how far to trust it.
//!
//! The line is a curve whose curvature wanders and forgets itself (an Ornstein-Uhlenbeck process, which a
//! Kalman filter follows exactly: Kalman 1960; Rasmussen and Williams, *Gaussian Processes for Machine
//! Learning*, 2006, appendix B); the sections see it with noise. How much of both is what makes the seen
//! points most likely. So a noisy line is continued straight from a long run, a clean one by its own bend.

use nalgebra::{Matrix3, Point3, RowVector3, Vector3};

/// Strength of the bends that is expected of a vessel before it is seen (root mean square curvature, per
/// radius), and how many times more or less it may easily be.
const EXPECTED_BEND: f64 = 0.15;
const EASILY: f64 = 2.0;
/// Strengths of bend tried, per radius.
const BENDS: [f64; 4] = [0.05, 0.1, 0.2, 0.35];
/// Lengths tried, in radii, over which a vessel forgets its bend.
const MEMORIES: [f64; 2] = [4.0, 12.0];
/// Deviations of the sections' noise tried, in radii: a real vessel is never quite a tube.
const NOISES: [f64; 4] = [0.01, 0.025, 0.06, 0.15];
/// More points than this say nothing of the end.
const MOST: usize = 64;

/// A point of the line as its section sees it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Seen {
    pub point: Point3<f64>,
    /// What is doubted of it beside the branch's noise, in radii.
    pub doubt: f64,
}

/// How a branch bends, and how noisy its sections are. Lengths in radii.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Process {
    /// Root mean square curvature.
    bend: f64,
    /// Length over which the bend is forgotten.
    memory: f64,
    /// Deviation of a section's centre.
    pub noise: f64,
}

/// Position, direction and bend at the end of a run of points, with their uncertainty.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Continuation {
    point: Point3<f64>,
    /// Derivative by length; nearly a unit vector.
    slope: Vector3<f64>,
    /// Per unit of length.
    curvature: Vector3<f64>,
    /// The length that the others are counted in.
    radius: f64,
    process: Process,
    /// Of position, slope and curvature along each axis, in radii.
    covariance: Matrix3<f64>,
}

/// What is known of position, slope and curvature: means along three axes, one covariance for all.
struct State {
    mean: Matrix3<f64>,
    covariance: Matrix3<f64>,
    /// Twice the negative logarithm of the likelihood of what was seen.
    unlikely: f64,
}

impl Default for Process {
    fn default() -> Self {
        Self { bend: EXPECTED_BEND, memory: MEMORIES[0], noise: 0.02 }
    }
}

impl Process {
    /// The process that makes the points most likely, each counted in the radius beside it. The default for
    /// fewer than eight. O(points).
    pub fn of(points: &[(Point3<f64>, f64)]) -> Self {
        const LEAST: usize = 8;
        if points.len() < LEAST {
            return Self::default();
        }
        let mut run = vec![(Vector3::zeros(), 0.0)];
        let mut place = Vector3::zeros();
        for pair in points.windows(2) {
            place += (pair[1].0 - pair[0].0) / (0.5 * (pair[0].1 + pair[1].1)).max(f64::MIN_POSITIVE);
            run.push((place, 0.0));
        }
        let mut best = (f64::INFINITY, Self::default());
        for (noise, memory) in NOISES.into_iter().flat_map(|noise| MEMORIES.map(|memory| (noise, memory))) {
            for bend in BENDS {
                let process = Self { bend, memory, noise };
                let unusual = (bend / EXPECTED_BEND).ln() / f64::ln(EASILY);
                let score = process.follow(&run).unlikely + unusual * unusual;
                if score < best.0 {
                    best = (score, process);
                }
            }
        }
        best.1
    }

    /// Effect of the curvature at a place on position, slope and curvature `step` further on.
    fn response(&self, step: f64) -> Vector3<f64> {
        let left = (-step / self.memory).exp();
        let slope = self.memory * (1.0 - left);
        Vector3::new(self.memory * (step - slope), slope, left)
    }

    fn transition(&self, step: f64) -> Matrix3<f64> {
        let bend = self.response(step);
        Matrix3::new(1.0, step, bend.x, 0.0, 1.0, bend.y, 0.0, 0.0, bend.z)
    }

    /// Covariance gathered over a step: three-point Gauss-Legendre quadrature of the responses to white noise.
    fn gathered(&self, step: f64) -> Matrix3<f64> {
        const NODES: [(f64, f64); 3] =
            [(0.112_701_665_379_258_3, 5.0 / 18.0), (0.5, 8.0 / 18.0), (0.887_298_334_620_741_7, 5.0 / 18.0)];
        let rate = 2.0 * self.bend * self.bend / self.memory;
        let part = |&(place, weight): &(f64, f64)| {
            let response = self.response(place * step);
            response * response.transpose() * (weight * step * rate)
        };
        NODES.iter().map(part).sum()
    }

    /// Runs over points with their own doubts (all in radii) and returns what is known at the last.
    fn follow(&self, run: &[(Vector3<f64>, f64)]) -> State {
        /// Nothing is known of the first direction.
        const OPEN: f64 = 1e4;
        let noise = |doubt: f64| self.noise * self.noise + doubt * doubt;
        let mut state = State {
            mean: Matrix3::from_rows(&[run[0].0.transpose(), RowVector3::zeros(), RowVector3::zeros()]),
            covariance: Matrix3::from_diagonal(&Vector3::new(noise(run[0].1), OPEN, self.bend * self.bend)),
            unlikely: 0.0,
        };
        for (number, pair) in run.windows(2).enumerate() {
            let (from, (to, doubt)) = (pair[0].0, pair[1]);
            let step = (to - from).norm();
            let transition = self.transition(step);
            state.mean = transition * state.mean;
            state.covariance = transition * state.covariance * transition.transpose() + self.gathered(step);
            let spread = state.covariance[(0, 0)] + noise(doubt);
            let missed = to.transpose() - state.mean.row(0);
            let gain: Vector3<f64> = state.covariance.column(0) / spread;
            state.mean += gain * missed;
            let seen: RowVector3<f64> = state.covariance.row(0).into();
            state.covariance -= gain * seen;
            if number > 0 {
                state.unlikely += missed.norm_squared() / spread + 3.0 * spread.ln();
            }
        }
        state
    }
}

impl Continuation {
    /// The line of `points` at the last of them; `radius` is the vessel's there. `None` for fewer than four
    /// points or a radius of nothing. O(points).
    pub fn of(points: &[Seen], radius: f64, process: Process) -> Option<Self> {
        let points = &points[points.len().saturating_sub(MOST)..];
        let end = points.last()?.point;
        let positive = radius > 0.0;
        if points.len() < 4 || !positive {
            return None;
        }
        let run: Vec<(Vector3<f64>, f64)> =
            points.iter().map(|seen| ((seen.point - end) / radius, seen.doubt)).collect();
        let state = process.follow(&run);
        let row = |i: usize| -> Vector3<f64> { state.mean.row(i).transpose() };
        Some(Self {
            point: end + row(0) * radius,
            slope: row(1),
            curvature: row(2) / radius,
            radius,
            process,
            covariance: state.covariance,
        })
    }

    /// A line of which nothing more is known than its place and its direction.
    pub fn straight(point: Point3<f64>, direction: Vector3<f64>, radius: f64) -> Self {
        const DOUBT: [f64; 3] = [0.05, 0.2, EXPECTED_BEND];
        let covariance = Matrix3::from_diagonal(&Vector3::from(DOUBT.map(|doubt| doubt * doubt)));
        let process = Process::default();
        Self { point, slope: direction, curvature: Vector3::zeros(), radius, process, covariance }
    }

    /// Most likely point and unit direction at distance `s` past the last point, in the input's unit.
    pub fn at(&self, s: f64) -> (Point3<f64>, Vector3<f64>) {
        let bend = self.process.response(s / self.radius);
        let (bow, turn) = (bend.x * self.radius * self.radius, bend.y * self.radius);
        let direction = self.slope + self.curvature * turn;
        let unit = direction.try_normalize(0.0).unwrap_or(direction);
        (self.point + self.slope * s + self.curvature * bow, unit)
    }

    /// Standard deviation, across the line, of the point at distance `s`, in the input's unit.
    pub fn doubt(&self, s: f64) -> f64 {
        let step = (s / self.radius).max(0.0);
        let transition = self.process.transition(step);
        let spread = transition * self.covariance * transition.transpose() + self.process.gathered(step);
        self.radius * spread[(0, 0)].max(0.0).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn circle(noise: f64) -> Vec<Point3<f64>> {
        let jump = |i: u32, k: f64| noise * ((f64::from(i) * k).fract() - 0.5);
        (0..40)
            .map(|i| (i, 0.04 * f64::from(i)))
            .map(|(i, a)| Point3::new(10.0 * a.sin() + jump(i, 0.618), 10.0 * a.cos() + jump(i, 0.414), 0.0))
            .collect()
    }

    fn continued(points: &[Point3<f64>], radius: f64) -> Option<Continuation> {
        let process = Process::of(&points.iter().map(|&p| (p, radius)).collect::<Vec<_>>());
        let seen: Vec<Seen> = points.iter().map(|&point| Seen { point, doubt: 0.0 }).collect();
        Continuation::of(&seen, radius, process)
    }

    #[test]
    fn a_clean_bend_is_continued_and_doubt_grows() {
        let line = continued(&circle(0.0), 1.0).unwrap();
        let (ahead, direction) = line.at(2.0);
        assert!((ahead.coords.norm() - 10.0).abs() < 0.1, "{ahead}");
        assert!(direction.dot(&ahead.coords.normalize()).abs() < 0.05);
        assert!(line.doubt(0.0) < line.doubt(1.0) && line.doubt(1.0) < line.doubt(4.0));
        assert!((ahead.coords.norm() - 10.0).abs() < 3.0 * line.doubt(2.0));
    }

    #[test]
    fn noise_is_doubted_and_does_not_throw_the_line_off() {
        let (clean, noisy) = (continued(&circle(0.0), 1.0).unwrap(), continued(&circle(0.3), 1.0).unwrap());
        assert!(noisy.doubt(2.0) > 2.0 * clean.doubt(2.0));
        let (ahead, _) = noisy.at(2.0);
        assert!((ahead.coords.norm() - 10.0).abs() < 0.3, "{ahead}");
    }

    #[test]
    fn the_unit_has_no_part_in_it() {
        let metres: Vec<Point3<f64>> = circle(0.1).iter().map(|p| p / 1000.0).collect();
        let (a, b) = (continued(&circle(0.1), 1.0).unwrap(), continued(&metres, 0.001).unwrap());
        assert!((a.at(3.0).0 - b.at(0.003).0 * 1000.0).norm() < 1e-9);
        assert!((a.doubt(3.0) - b.doubt(0.003) * 1000.0).abs() < 1e-9);
    }

    #[test]
    fn three_points_are_no_run() {
        assert_eq!(continued(&circle(0.0)[..3], 1.0), None);
        assert_eq!(continued(&circle(0.0), 0.0), None);
    }
}
