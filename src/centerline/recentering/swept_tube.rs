//! A run of stations as a tube: a line of cubics, and around each station a circle with an ellipse on top of it.

use nalgebra::{Point3, Vector3};

use crate::centerline::cut_plane::section::Frame;
use crate::centerline::segmentation::track::{Station, tangents};

/// The tube that a run of stations sweeps.
pub struct SweptTube {
    pub points: Vec<Point3<f64>>,
    /// Frames that do not spin; `t` is the line's direction.
    pub frames: Vec<Frame>,
    /// Of each station: mean radius, and the two terms (cos 2, sin 2) of the ellipse in its frame.
    pub shapes: Vec<Vector3<f64>>,
    /// Of each station: change of the mean radius along the line.
    slopes: Vec<f64>,
    /// Way along the line to each station.
    pub along: Vec<f64>,
    /// Of each piece between two stations.
    cubics: Vec<Cubic>,
    /// How far past its first and its last station the tube goes on.
    beyond: [f64; 2],
}

/// Coefficients of the share of a piece, of its square and of its cube.
struct Cubic([Vector3<f64>; 3]);

impl Cubic {
    /// Hermite interpolation over `step` with the slopes `from` and `to`.
    fn new(step: Vector3<f64>, from: Vector3<f64>, to: Vector3<f64>) -> Self {
        Self([from, step * 3.0 - from * 2.0 - to, from + to - step * 2.0])
    }
}

/// A place on a cubic: point, derivative and second derivative by the share of the piece.
pub struct OnCubic {
    pub point: Point3<f64>,
    pub first: Vector3<f64>,
    second: Vector3<f64>,
}

impl OnCubic {
    /// How much shorter the wall at `arm` from here is than the line: above 1 outside a bend, nothing at its centre.
    pub fn room(&self, arm: &Vector3<f64>) -> f64 {
        1.0 - arm.dot(&self.second) / self.first.norm_squared().max(f64::MIN_POSITIVE)
    }
}

impl SweptTube {
    /// The tube of two stations or more.
    pub fn of(stations: &[Station], beyond: [f64; 2]) -> Self {
        let points = stations.iter().map(|s| s.point).collect();
        let frames = stations.iter().map(|s| s.frame).collect();
        let shapes = stations.iter().map(|s| Vector3::new(s.shape.mean, 0.0, 0.0)).collect();
        let mut tube = Self {
            points,
            frames,
            shapes,
            slopes: Vec::new(),
            along: Vec::new(),
            cubics: Vec::new(),
            beyond,
        };
        tube.settle();
        for (i, station) in stations.iter().enumerate() {
            let [x, y] = station.shape.ellipse;
            let [x, y] = turned([x, y], &station.frame, &tube.frames[i]);
            tube.shapes[i] = Vector3::new(station.shape.mean, x, y);
        }
        tube
    }

    /// Sets frames, ways and cubics anew after the points moved.
    pub fn settle(&mut self) {
        let mut like = self.frames.first().map_or(Vector3::x(), |frame| frame.u);
        for ((frame, point), tangent) in self.frames.iter_mut().zip(&self.points).zip(tangents(&self.points))
        {
            *frame = Frame::new(*point, tangent, like);
            like = frame.u;
        }
        self.along = vec![0.0];
        for pair in self.points.windows(2) {
            self.along.push(self.along[self.along.len() - 1] + (pair[1] - pair[0]).norm());
        }
        let cubic = |k: usize| {
            let (step, chord) = (self.points[k + 1] - self.points[k], self.chord(k));
            Cubic::new(step, self.frames[k].t * chord, self.frames[k + 1].t * chord)
        };
        self.cubics = (0..self.points.len() - 1).map(cubic).collect();
        self.settle_slopes();
    }

    pub fn set_shapes(&mut self, shapes: Vec<Vector3<f64>>) {
        self.shapes = shapes;
        self.settle_slopes();
    }

    fn settle_slopes(&mut self) {
        let slope = |station: usize| {
            let (a, b) = (station.saturating_sub(1), (station + 1).min(self.points.len() - 1));
            (self.shapes[b].x - self.shapes[a].x) / (self.along[b] - self.along[a]).max(f64::MIN_POSITIVE)
        };
        self.slopes = (0..self.points.len()).map(slope).collect();
    }

    /// The ellipse's terms at a station, told in another frame of the same plane.
    pub fn ellipse(&self, station: usize, frame: &Frame) -> [f64; 2] {
        let shape = &self.shapes[station];
        turned([shape.y, shape.z], &self.frames[station], frame)
    }

    /// Change of the mean radius along the line at a station.
    pub fn slope(&self, station: usize) -> f64 {
        self.slopes[station]
    }

    /// Whether it has a length at every piece and a radius at every station, all of them numbers.
    pub fn is_sound(&self) -> bool {
        let ascends = self.along.windows(2).all(|pair| pair[0] < pair[1]);
        let is_number = |point: &Point3<f64>| point.iter().all(|value| value.is_finite());
        let has_shape = |s: &Vector3<f64>| s.x > 0.0 && s.iter().all(|value| value.is_finite());
        ascends && self.points.iter().all(is_number) && self.shapes.iter().all(has_shape)
    }

    /// Mean of the ellipses' amplitudes over their mean radii.
    pub fn flatness(&self) -> f64 {
        self.shapes.iter().map(|s| s.y.hypot(s.z) / s.x).sum::<f64>() / self.shapes.len() as f64
    }

    /// The largest ratio of the tube's radius to the line's radius of bend, over four pieces at least.
    pub fn tightest_bend(&self) -> f64 {
        const APART: usize = 4;
        let bend = |i: usize| {
            let angle = self.frames[i].t.angle(&self.frames[i + APART].t);
            angle * self.shapes[i + APART / 2].x
                / (self.along[i + APART] - self.along[i]).max(f64::MIN_POSITIVE)
        };
        (0..self.points.len().saturating_sub(APART)).map(bend).fold(0.0, f64::max)
    }

    /// Length of piece `k`, from station `k` to the next.
    pub fn chord(&self, k: usize) -> f64 {
        self.along[k + 1] - self.along[k]
    }

    /// The shares of piece `k` beside which the wall is the tube's.
    pub fn reach(&self, k: usize) -> (f64, f64) {
        let low = if k == 0 { -self.beyond[0] / self.chord(k) } else { 0.0 };
        let last = k + 2 == self.points.len();
        let high = if last { 1.0 + self.beyond[1] / self.chord(k) } else { 1.0 };
        (low, high)
    }

    /// The piece that a point lies beside, and the share of it, by its chords; searched from piece `near` on.
    pub fn beside(&self, point: &Point3<f64>, near: usize) -> (usize, f64) {
        let last = self.points.len() - 2;
        let share = |k: usize| {
            let chord = self.points[k + 1] - self.points[k];
            (point - self.points[k]).dot(&chord) / chord.norm_squared().max(f64::MIN_POSITIVE)
        };
        let mut k = near.min(last);
        let mut t = share(k);
        let forward = t > 1.0;
        while if forward { t > 1.0 && k < last } else { t < 0.0 && k > 0 } {
            k = if forward { k + 1 } else { k - 1 };
            t = share(k);
            // In the wedge at a corner it lies beside neither.
            t = if forward { t.max(0.0) } else { t.min(1.0) };
        }
        (k, t)
    }

    /// The foot of a point on the cubic of piece `k`, by Newton's method from share `t`.
    pub fn foot(&self, point: &Point3<f64>, k: usize, mut t: f64) -> (f64, OnCubic) {
        const STEPS: usize = 3;
        /// A step so small, in pieces, is the last: what it leaves is its square.
        const STILL: f64 = 1e-6;
        /// How far past its piece a foot may lie, in pieces.
        const PAST: f64 = 0.25;
        let (low, high) = self.reach(k);
        for _ in 0..STEPS {
            let place = self.at(k, t);
            let arm = point - place.point;
            let square = place.first.norm_squared();
            let before = t;
            t += arm.dot(&place.first) / (square * place.room(&arm).max(0.2));
            t = t.clamp(low - PAST, high + PAST);
            if (t - before).abs() < STILL {
                break;
            }
        }
        (t, self.at(k, t))
    }

    /// The place on piece `k` at share `t`.
    pub fn at(&self, k: usize, t: f64) -> OnCubic {
        let Cubic([a, b, c]) = &self.cubics[k];
        let cube = c * t;
        OnCubic {
            point: self.points[k] + (a + (b + cube) * t) * t,
            first: a + (b * 2.0 + cube * 3.0) * t,
            second: b * 2.0 + cube * 6.0,
        }
    }
}

/// The terms cos 2 and sin 2 of one frame, told in another.
fn turned([x, y]: [f64; 2], from: &Frame, to: &Frame) -> [f64; 2] {
    let (a, b) = (from.u.dot(&to.u), from.u.dot(&to.v));
    let square = (a * a + b * b).max(f64::MIN_POSITIVE);
    let (cos, sin) = ((a * a - b * b) / square, 2.0 * a * b / square);
    [x * cos - y * sin, x * sin + y * cos]
}

#[cfg(test)]
mod tests {
    use nalgebra::Unit;

    use super::*;

    /// Stations on a circle of radius 10 around the origin.
    fn arc() -> SweptTube {
        let on = |a: f64| Point3::new(10.0 * a.cos(), 10.0 * a.sin(), 0.0);
        let station = |i: u32| {
            let a = 0.05 * f64::from(i);
            let tangent = Unit::new_normalize(Vector3::new(-a.sin(), a.cos(), 0.0));
            Station::rough(on(a), tangent, 1.0, 0)
        };
        SweptTube::of(&(0..40).map(station).collect::<Vec<_>>(), [0.0; 2])
    }

    #[test]
    fn a_point_beside_an_arc_has_its_foot_on_the_arc() {
        let tube = arc();
        for (angle, height) in [(0.42_f64, 0.3), (1.234, -0.8), (0.9, 0.0)] {
            for across in [9.1, 10.0, 10.9] {
                let point = Point3::new(across * angle.cos(), across * angle.sin(), height);
                let expected = Point3::new(10.0 * angle.cos(), 10.0 * angle.sin(), 0.0);
                // From either side: at a station the pieces that meet there have the same foot.
                for near in [0, 30] {
                    let (k, t) = tube.beside(&point, near);
                    let (_, place) = tube.foot(&point, k, t);
                    assert!((place.point - expected).norm() < 1e-4, "{} is not {expected}", place.point);
                }
            }
        }
    }
}
