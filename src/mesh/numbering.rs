//! An order of vertices that every file of the same surface leads to.

use nalgebra::{Point3, Vector3};

use super::TriangleMesh;
use super::corner_table::{NONE, next, previous};

/// Names a component's vertices by a walk from its outermost one, breadth first, and returns them in that order.
///
/// Later stages start at vertex 0 and break ties by number: this order knows neither the file's nor the frame.
pub(super) fn walk(
    soup: &TriangleMesh,
    opposite: &[u32],
    triangles: &[u32],
    name: &mut [u32],
) -> Vec<Point3<f64>> {
    let origin = |h: u32| soup.triangles[(h / 3) as usize][(h % 3) as usize];
    let Some(start) = outermost(soup, triangles) else { return Vec::new() };
    name[origin(start) as usize] = 0;
    // For each vertex a half-edge from it: the way back to the one that it was reached from.
    let mut reached = Vec::with_capacity(triangles.len() / 2 + 2);
    reached.push(start);
    let mut cursor = 0;
    while cursor < reached.len() {
        let mut h = reached[cursor];
        loop {
            let slot = &mut name[origin(next(h)) as usize];
            if *slot == NONE {
                *slot = reached.len() as u32;
                reached.push(opposite[h as usize]);
            }
            h = opposite[previous(h) as usize];
            if h == reached[cursor] {
                break;
            }
        }
        cursor += 1;
    }
    reached.into_iter().map(|h| soup.vertices[origin(h) as usize]).collect()
}

/// The half-edge from the vertex farthest from the middle of the surface to its neighbour nearest to there.
fn outermost(soup: &TriangleMesh, triangles: &[u32]) -> Option<u32> {
    let corners = |t: u32| soup.triangles[t as usize].map(|v| soup.vertices[v as usize]);
    let [base, ..] = corners(*triangles.first()?);
    let (mut moment, mut total) = (Vector3::zeros(), 0.0);
    for [a, b, c] in triangles.iter().map(|&t| corners(t)) {
        let twice = (b - a).cross(&(c - a)).norm();
        moment += ((a - base) + (b - base) + (c - base)) * (twice / 3.0);
        total += twice;
    }
    let middle = if total > 0.0 { base + moment / total } else { base };
    let mut best = (f64::NEG_INFINITY, f64::NEG_INFINITY, NONE);
    for &t in triangles {
        let away = corners(t).map(|p| (p - middle).norm_squared());
        for k in 0..3 {
            let (from, to) = (away[k], -away[(k + 1) % 3]);
            if from > best.0 || (from == best.0 && to > best.1) {
                best = (from, to, 3 * t + k as u32);
            }
        }
    }
    Some(best.2)
}
