//! Smooth curves through what the stations of a tube hear: its shape and its centre along the branch, as stiff as
//! generalised cross-validation asks for (Craven and Wahba 1979).

use nalgebra::{Matrix3, Point3, Vector3};

use crate::centerline::laplacian_smoothing::curve_fit::CurveFit;
use crate::centerline::recentering::swept_tube::SweptTube;
use crate::centerline::recentering::swept_wall::{Heard, outside, outside_circle};

/// How stiff a curve may be; the stiffest first: of equal ones it is taken.
const LADDER: [f64; 8] = [2400.0, 300.0, 40.0, 6.0, 1.0, 0.2, 0.03, 0.005];

/// Which rungs of the ladder are tried.
#[derive(Debug, Clone, Copy)]
pub enum Search {
    Whole,
    /// From one to the better of its neighbours, as long as there is one.
    From(usize),
    Keep(usize),
}

/// A smooth curve through what the stations hear.
pub struct Fitted {
    pub curve: Vec<Point3<f64>>,
    /// Its stiffness' place on the ladder.
    pub rung: usize,
    /// Weighted squares that it leaves.
    pub left: f64,
    /// Unknowns that it uses up (trace of the hat matrix).
    pub freedom: f64,
    /// Vertices that were heard, by their weight.
    pub count: f64,
    /// Square of the second harmonic that noise alone would show.
    pub haze: f64,
    /// Whether it has an ellipse.
    pub flat: bool,
}

/// What is fitted: values at the stations, and how a vertex sees them.
///
/// `WIDTH`: of a value the numbers that move, times the points that take part in a difference.
struct Problem<'a, const WIDTH: usize, Row: Fn(&Heard) -> Vector3<f64>, Hold: Fn(usize) -> Matrix3<f64>> {
    tube: &'a SweptTube,
    heard: &'a [Heard],
    values: Vec<Point3<f64>>,
    /// Distance of a vertex from the tube that has these values.
    outside: fn(&SweptTube, &Heard) -> f64,
    /// Derivative of a vertex's distance by the values of its station.
    row: Row,
    /// What holds the values in directions that no vertex sees.
    hold: Hold,
    /// How many directions vertices see.
    seen: f64,
    /// Differences of this order are penalised: 2 keeps a taper, 3 an even bend.
    order: usize,
}

/// The shape along the tube: with an ellipse where that explains the vertices better than a circle, by the
/// Bayesian information criterion (Schwarz 1978). `was_flat`: what was chosen before, and stays if the stiffness does.
pub fn fit_shape(tube: &SweptTube, heard: &[Heard], search: Search, was_flat: bool) -> Option<Fitted> {
    let hold = |_| Matrix3::zeros();
    let circle = || {
        let values = tube.shapes.iter().map(|s| Point3::new(s.x, 0.0, 0.0)).collect();
        let row = |_: &Heard| Vector3::x();
        let outside = outside_circle;
        Problem::<3, _, _> { tube, heard, values, outside, row, hold, seen: 1.0, order: 2 }.solve(search)
    };
    let ellipse = || {
        let values = tube.shapes.iter().map(|s| Point3::from(*s)).collect();
        let row = |h: &Heard| h.terms;
        let fitted = Problem::<9, _, _> { tube, heard, values, outside, row, hold, seen: 3.0, order: 2 }
            .solve(search)?;
        Some(Fitted { flat: true, ..fitted })
    };
    if let Search::Keep(_) = search {
        return if was_flat { ellipse() } else { circle() };
    }
    let circle = circle()?;
    let Some(ellipse) = ellipse() else { return Some(circle) };
    let count: f64 = heard.iter().map(|h| h.weight).sum();
    let gain = |other: &Fitted| count * (circle.left / other.left.max(f64::MIN_POSITIVE)).ln();
    let price = (ellipse.freedom - circle.freedom) * count.ln();
    if gain(&ellipse) <= price {
        return Some(circle);
    }
    // A circle with a fourth harmonic is no vessel's shape: what it explains with as many unknowns, noise that
    // vertices share explains.
    let square = {
        let values = tube.shapes.iter().map(|s| Point3::new(s.x, 0.0, 0.0)).collect();
        let row = |h: &Heard| h.fourth();
        let outside = outside_circle;
        Problem::<9, _, _> { tube, heard, values, outside, row, hold, seen: 3.0, order: 2 }
            .solve(Search::Keep(ellipse.rung))
    };
    let noise = square.map_or(0.0, |square| gain(&square).max(0.0));
    Some(if gain(&ellipse) > price + noise { ellipse } else { circle })
}

/// The harmonic of that order on top of the tube's shape: cos in `x`, sin in `y`.
pub fn fit_harmonic(tube: &SweptTube, heard: &[Heard], order: i32, search: Search) -> Option<Fitted> {
    let values = vec![Point3::origin(); tube.points.len()];
    let row = |h: &Heard| {
        let [cos, sin] = h.harmonic(tube, order);
        Vector3::new(cos, sin, 0.0)
    };
    let hold = |_| Matrix3::zeros();
    Problem::<6, _, _> { tube, heard, values, outside, row, hold, seen: 2.0, order: 2 }.solve(search)
}

/// The line along the middle of the tube; along itself nothing moves it.
pub fn fit_centre(tube: &SweptTube, heard: &[Heard], search: Search) -> Option<Fitted> {
    let along = |i: usize| tube.frames[i].t;
    let row = |h: &Heard| h.direction - along(h.station) * along(h.station).dot(&h.direction);
    let hold = |i: usize| along(i) * along(i).transpose();
    let values = tube.points.clone();
    Problem::<12, _, _> { tube, heard, values, outside, row, hold, seen: 2.0, order: 3 }.solve(search)
}

impl<const WIDTH: usize, Row: Fn(&Heard) -> Vector3<f64>, Hold: Fn(usize) -> Matrix3<f64>>
    Problem<'_, WIDTH, Row, Hold>
{
    /// The curve as stiff as generalised cross-validation asks for; `None` where most stations hear no vertex.
    /// O(vertices).
    fn solve(&self, search: Search) -> Option<Fitted> {
        let n = self.values.len();
        let mut weights = vec![Matrix3::zeros(); n];
        let mut pulls = vec![Vector3::zeros(); n];
        let (mut squares, mut count) = (0.0, 0.0);
        for heard in self.heard {
            let (row, outside) = ((self.row)(heard), (self.outside)(self.tube, heard));
            weights[heard.station] += row * row.transpose() * heard.weight;
            pulls[heard.station] += row * (outside * heard.weight);
            squares += outside * outside * heard.weight;
            count += heard.weight;
        }
        let mean = weights.iter().map(Matrix3::trace).sum::<f64>() / (self.seen * n as f64);
        let heard = weights.iter().filter(|weight| weight.trace() > 0.0).count();
        if 2 * heard < n {
            return None;
        }
        let left = |curve: &[Point3<f64>]| {
            let one = |i: usize| {
                let moved = curve[i] - self.values[i];
                moved.dot(&(weights[i] * moved)) - 2.0 * moved.dot(&pulls[i])
            };
            // Where nothing is left, rounding may leave less.
            (squares + (0..n).map(one).sum::<f64>()).max(0.0)
        };
        let scaled: Vec<Matrix3<f64>> = (0..n).map(|i| weights[i] / mean + (self.hold)(i)).collect();
        let fit = CurveFit::pulled(
            &self.values,
            WIDTH / (self.order + 1),
            &scaled,
            |i| pulls[i] / mean,
            &self.tube.along,
        );
        let tried = |rung: usize| {
            let stiffness = LADDER[rung];
            let curve = self.curve(&fit, stiffness);
            let (left, freedom) = (left(&curve), self.seen * self.freedom(stiffness));
            let haze = 4.0 * left * freedom / self.seen / (count * count);
            Fitted { curve, rung, left, freedom, count, haze, flat: false }
        };
        match search {
            Search::Keep(rung) => Some(tried(rung)),
            Search::Whole => (0..LADDER.len()).map(tried).min_by(|a, b| a.score().total_cmp(&b.score())),
            Search::From(rung) => Some(better(tried(rung), tried)),
        }
    }

    fn curve(&self, fit: &CurveFit<'_, WIDTH>, stiffness: f64) -> Vec<Point3<f64>> {
        /// Keeps a bend that no vertex supports from swinging out.
        const SECOND: f64 = 1e-3;
        let (third, second) = if self.order == 3 { (stiffness, SECOND) } else { (0.0, stiffness) };
        fit.curve(|_| third, second)
    }

    /// Trace of the hat matrix for one of the seen directions, as on even spacing.
    fn freedom(&self, stiffness: f64) -> f64 {
        let n = self.values.len();
        let gain = |k: usize| {
            let wave = 2.0 - 2.0 * (std::f64::consts::PI * k as f64 / n as f64).cos();
            1.0 / (1.0 + stiffness * wave.powi(self.order as i32))
        };
        self.order as f64 + (self.order..n).map(gain).sum::<f64>()
    }
}

impl Fitted {
    /// Generalised cross-validation (Craven and Wahba 1979). An unknown counts 1.4, which keeps it from taking noise
    /// for shape (Kim and Gu 2004). Without bound where there are hardly more vertices than unknowns.
    fn score(&self) -> f64 {
        const PRICE: f64 = 1.4;
        const MOST: f64 = 0.9;
        let used = PRICE * self.freedom / self.count;
        if used < MOST { self.left / (1.0 - used).powi(2) } else { f64::INFINITY }
    }
}

/// From one rung upward, or where that is no better downward, as long as the next is better.
fn better(mut best: Fitted, tried: impl Fn(usize) -> Fitted) -> Fitted {
    let start = best.rung;
    for stiffer in (0..start).rev().map(&tried) {
        if stiffer.score().total_cmp(&best.score()).is_gt() {
            break;
        }
        best = stiffer;
    }
    for softer in (start + 1..if best.rung < start { 0 } else { LADDER.len() }).map(&tried) {
        if softer.score().total_cmp(&best.score()).is_ge() {
            break;
        }
        best = softer;
    }
    best
}
