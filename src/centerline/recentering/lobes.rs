//! How much nearer than its ellipse the wall of a branch comes: a real lumen is rounded to a triangle, a square or more
//! sides as well, and its largest inscribed sphere touches the flat sides.
//!
//! The third to the sixth harmonic are smooth curves along the branch, like its ellipse. They count where they explain
//! more than their unknowns cost (the Bayesian information criterion, Schwarz 1978) and than the harmonics two orders
//! above do, which no vessel has: noise and stairs have all alike.

use std::f64::consts::TAU;

use crate::centerline::recentering::swept_fit::{Fitted, Search, fit_harmonic};
use crate::centerline::recentering::swept_tube::SweptTube;
use crate::centerline::recentering::swept_wall::{Heard, outside};

/// The harmonics that lobes may have.
const ORDERS: [i32; 4] = [3, 4, 5, 6];
/// The highest of those that is heard among others as large: stairs have no such axis.
const ROUNDED: i32 = 4;
/// Deviation of the wall from its ellipse, in radii, below which lobes are nothing.
const NOTHING: f64 = 0.003;
/// Directions that are looked in for the nearest wall.
const DIRECTIONS: u32 = 64;

/// Of each station, how much nearer its nearest wall is than the short half axis of its ellipse.
/// `rung`: the stiffness of the tube's shape. O(vertices).
pub fn lobes(tube: &SweptTube, heard: &[Heard], rung: usize) -> Vec<f64> {
    let count: f64 = heard.iter().map(|h| h.weight).sum();
    let squares: f64 = heard.iter().map(|h| outside(tube, h).powi(2) * h.weight).sum();
    let radius = tube.shapes.iter().map(|shape| shape.x).sum::<f64>() / tube.shapes.len() as f64;
    let mut found: Vec<(i32, Fitted)> = Vec::new();
    if squares > count * (NOTHING * radius).powi(2) {
        found.extend(ORDERS.iter().filter_map(|&order| shown(tube, heard, order, (rung, count, squares))));
    }
    if found.is_empty() {
        return vec![0.0; tube.points.len()];
    }
    let floor = near_walls(tube, heard);
    let facets = facets(tube, heard);
    let one = |station: usize| {
        let shape = &tube.shapes[station];
        let short = shape.x - shape.y.hypot(shape.z);
        // Order, how sure it is, and its two terms.
        let harmonic = |(order, fitted): &(i32, Fitted)| {
            let [cos, sin] = [fitted.curve[station].x, fitted.curve[station].y];
            let square = cos * cos + sin * sin;
            let noise = ((square - fitted.haze).max(0.0) / square.max(f64::MIN_POSITIVE)).sqrt();
            let sure = noise * (2.0 * square.sqrt() / facets - 1.0).clamp(0.0, 1.0);
            (f64::from(*order), sure, [cos, sin])
        };
        let harmonics: Vec<(f64, f64, [f64; 2])> = found.iter().map(harmonic).collect();
        let wall = |direction: u32| {
            let angle = TAU * f64::from(direction) / f64::from(DIRECTIONS);
            let ellipse = shape.x + shape.y * (2.0 * angle).cos() + shape.z * (2.0 * angle).sin();
            let lobes = harmonics.iter().map(|(order, sure, [cos, sin])| {
                let angle = order * angle;
                sure * (cos * angle.cos() + sin * angle.sin())
            });
            ellipse + lobes.sum::<f64>()
        };
        let nearest = (0..DIRECTIONS).map(wall).fold(f64::INFINITY, f64::min);
        (short - nearest.max(floor[station] * shape.x)).max(0.0)
    };
    (0..tube.points.len()).map(one).collect()
}

/// The harmonic of an order, where the wall shows it.
///
/// `count`: the vertices by their weight; `squares`: what the ellipse leaves of them.
fn shown(
    tube: &SweptTube,
    heard: &[Heard],
    order: i32,
    (rung, count, squares): (usize, f64, f64),
) -> Option<(i32, Fitted)> {
    let fitted = fit_harmonic(tube, heard, order, Search::From(rung))?;
    let gain = |fitted: &Fitted| count * (squares / fitted.left.max(f64::MIN_POSITIVE)).ln().max(0.0);
    let explains = gain(&fitted) - fitted.freedom * count.ln();
    // Binary voxels along the diagonal of their lattice have six sides too, but many more lobes as large.
    if explains <= 0.0 || (order > ROUNDED && fitted.left > 0.5 * squares) {
        return None;
    }
    let control = fit_harmonic(tube, heard, order + 2, Search::Keep(fitted.rung))?;
    (explains > gain(&control)).then_some((order, fitted))
}

/// How far facets cut inside the wall, in the input's unit: where an edge's middle lies. A mesh may show lobes of half of
/// that where there are none.
fn facets(tube: &SweptTube, heard: &[Heard]) -> f64 {
    let length = tube.along[tube.along.len() - 1];
    // The square of an edge is the wall's area for each vertex; an edge's middle lies an eighth of it over the radius
    // inside.
    TAU / 8.0 * length / heard.len().max(1) as f64
}

/// Of each station, the ratio to the mean radius that hardly any vertex around it lies nearer than: a smooth harmonic
/// runs past the sides of a wall with corners.
fn near_walls(tube: &SweptTube, heard: &[Heard]) -> Vec<f64> {
    /// Stations to either side whose vertices are heard.
    const AROUND: usize = 3;
    /// Share of the vertices that may lie nearer.
    const FEW: f64 = 0.05;
    let mut ratios = vec![Vec::new(); tube.points.len()];
    for vertex in heard {
        ratios[vertex.station].push(vertex.ratio(tube));
    }
    let one = |station: usize| {
        let last = (station + AROUND + 1).min(ratios.len());
        let mut near: Vec<f64> = ratios[station.saturating_sub(AROUND)..last].concat();
        if near.is_empty() {
            return 0.0;
        }
        let few = (FEW * near.len() as f64) as usize;
        *near.select_nth_unstable_by(few, f64::total_cmp).1
    };
    (0..tube.points.len()).map(one).collect()
}
