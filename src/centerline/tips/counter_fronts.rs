//! Fronts from the tips of short wide branches, that meet the one from the root.
//!
//! Where the front from the root hides a [`Stump`], the distance `d` from the stump's cap counts instead: the function
//! is the larger of the root's distance and `C - d`, with `C` such that on the stump the latter is, but for the last half
//! radius above its base. From there on `d` counts twice, so that the front ends near it: along a shortest way to the
//! root both sides of the comparison would fall alike. The level sets are square to the stump, and the Reeb graph has as
//! many loops as the surface, as that of any function.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use super::geodesic::{EdgeGraph, Geodesic, geodesic_near};
use super::stumps::Stump;
use crate::centerline::{CancelToken, ExtractError};

/// The larger of the distance `from_root` and what each stump's front says, without hollows. O(n log n).
///
/// # Errors
/// [`ExtractError::Cancelled`].
pub fn countered(
    edges: &EdgeGraph,
    (source, from_root): (u32, &[f64]),
    stumps: &[Stump],
    cancel: &CancelToken,
) -> Result<Geodesic, ExtractError> {
    /// How far above its base, in radii, a stump's front meets the other at the latest: at the base it is no tube any
    /// more.
    const ABOVE: f64 = 0.5;
    let mut function = from_root.to_vec();
    for Stump { vertex, cap, base, radius, .. } in stumps {
        let from_root = |v: u32| from_root[v as usize];
        let firm = (base - ABOVE * radius).max(0.0);
        let tube = geodesic_near(edges, (*vertex, cap), |v, d| d < firm || cap.contains(&v), cancel)?;
        // A cap may be that of an opening, whose centre is raised.
        let wall = tube.reached().filter(|(v, _)| !cap.contains(v));
        let meet = wall.map(|(v, d)| from_root(v) + d).fold(0.0, f64::max);
        let level = |d: f64| meet - d - (d - firm).max(0.0);
        let goes_on = |v: u32, d: f64| level(d) > from_root(v) || cap.contains(&v);
        let front = geodesic_near(edges, (*vertex, cap), goes_on, cancel)?;
        for (v, d) in front.reached() {
            let value = &mut function[v as usize];
            *value = value.max(level(d));
        }
    }
    flooded(edges, (source, from_root), function, cancel)
}

/// The `function` with a peak at each of the `raised` vertices, without hollows. O(n log n).
///
/// # Errors
/// [`ExtractError::Cancelled`].
pub fn with_peaks(
    edges: &EdgeGraph,
    (source, function): (u32, &[f64]),
    raised: &[u32],
    cancel: &CancelToken,
) -> Result<Geodesic, ExtractError> {
    let mut peaked = function.to_vec();
    for &v in raised {
        let around = edges.neighbours(v).iter().map(|&(u, _)| function[u as usize]);
        peaked[v as usize] = around.fold(function[v as usize], f64::max) + edges.peak(v);
    }
    flooded(edges, (source, function), peaked, cancel)
}

/// A function whose hollows are filled to their lowest way out, so that its only minimum is the source, and the order
/// in which it rises from there, each vertex after a neighbour. Where it is level now, that is the order of `before`.
/// O(n log n).
fn flooded(
    edges: &EdgeGraph,
    (source, before): (u32, &[f64]),
    mut function: Vec<f64>,
    cancel: &CancelToken,
) -> Result<Geodesic, ExtractError> {
    const RUN: usize = 8192;
    let mut order = Vec::with_capacity(function.len());
    let mut seen = vec![false; function.len()];
    // Non-negative doubles sort like their bits; the vertex number breaks ties.
    let key = |value: f64, v: u32| Reverse((value.to_bits(), before[v as usize].to_bits(), v));
    let mut heap = BinaryHeap::from([key(function[source as usize], source)]);
    seen[source as usize] = true;
    while let Some(Reverse((bits, _, v))) = heap.pop() {
        order.push(v);
        if order.len().is_multiple_of(RUN) {
            cancel.check()?;
        }
        for &(u, _) in edges.neighbours(v) {
            if !std::mem::replace(&mut seen[u as usize], true) {
                let value = function[u as usize].max(f64::from_bits(bits));
                function[u as usize] = value;
                heap.push(key(value, u));
            }
        }
    }
    Ok(Geodesic { distance: function, order })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::centerline::shapes::open_tube;
    use crate::centerline::test_surfaces::closed_surface;
    use crate::centerline::tips::geodesic::geodesic;

    /// The edges of a tube of radius 1, 20 long, and the distances from a vertex on its upper rim: they come aslant.
    fn tube() -> (EdgeGraph, Vec<f64>) {
        let surface = closed_surface(&open_tube(20.0, 41, 16));
        let edges = EdgeGraph::new(&surface.mesh.vertices, &surface.corners);
        let is_rim = |p: &nalgebra::Point3<f64>| p.z == 20.0 && p.x < -0.99;
        assert!(is_rim(&surface.mesh.vertices[0]), "{:?}", surface.mesh.vertices[0]);
        let distance = geodesic(&edges, &[0], &CancelToken::new()).unwrap().distance;
        (edges, distance)
    }

    #[test]
    fn a_flooded_function_has_no_hollow_and_rises_in_its_order() {
        let (edges, mut function) = tube();
        // Hollows all over.
        (1..function.len()).step_by(7).for_each(|v| function[v] *= 0.3);
        let before = function.clone();
        let Geodesic { distance, order } =
            flooded(&edges, (0, &before), function, &CancelToken::new()).unwrap();
        assert_eq!(order.len(), distance.len());
        assert!(order.windows(2).all(|pair| distance[pair[0] as usize] <= distance[pair[1] as usize]));
        assert!(distance.iter().zip(&before).all(|(after, before)| after >= before));
        let mut passed = vec![false; order.len()];
        for &v in &order {
            assert!(
                v == 0 || edges.neighbours(v).iter().any(|&(u, _)| passed[u as usize]),
                "{v} is a hollow"
            );
            passed[v as usize] = true;
        }
    }

    #[test]
    fn without_stumps_the_root_s_distance_stays() {
        let (edges, from_root) = tube();
        let same = countered(&edges, (0, &from_root), &[], &CancelToken::new()).unwrap();
        assert_eq!(same.distance, from_root);
    }

    #[test]
    fn a_stump_s_front_counts_on_it_alone() {
        let (edges, from_root) = tube();
        let last = crate::centerline::tips::farthest(&from_root);
        let cap = [last].into_iter().collect();
        let stump = Stump { vertex: last, cap, base: 4.0, radius: 1.0, leaf: last };
        let met = countered(&edges, (0, &from_root), &[stump], &CancelToken::new()).unwrap();
        let top = met.distance[last as usize];
        let to_tip = geodesic(&edges, &[last], &CancelToken::new()).unwrap().distance;
        for (v, &d) in to_tip.iter().enumerate() {
            if d < 3.0 {
                assert!((met.distance[v] - (top - d)).abs() < 1e-9, "{v} at {d}");
            } else if d > 8.0 {
                assert_eq!(met.distance[v], from_root[v], "{v} at {d}");
            }
        }
    }

    #[test]
    fn a_peak_stands_over_what_is_around_it() {
        let (edges, from_root) = tube();
        let at = from_root.iter().position(|&d| (9.0..11.0).contains(&d)).unwrap() as u32;
        let peaked = with_peaks(&edges, (0, &from_root), &[at], &CancelToken::new()).unwrap().distance;
        assert!(edges.neighbours(at).iter().all(|&(u, _)| peaked[u as usize] < peaked[at as usize]));
        assert!((0..peaked.len()).all(|v| v == at as usize || peaked[v] == from_root[v]));
    }
}
