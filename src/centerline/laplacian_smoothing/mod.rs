//! Laplacian smoothing of the centerline points (IV.C).
//!
//! It evens the points of a branch, and draws those near a segment's border across it, so that the points of
//! neighbouring segments come together in the joint.

pub mod banded;
pub mod branch;
pub mod continuation;
pub mod curve_fit;

use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

use crate::centerline::ExtractError;
use crate::centerline::control::{Control, Stage};
use crate::centerline::tips::geodesic::EdgeGraph;

/// How much of the way to its neighbours' mean a point goes in one pass; the whole way would let the points
/// of a regular mesh swap places.
const STEP: f64 = 0.5;

/// `passes` passes over all points, each point moving towards the mean of the points of the mesh vertices
/// next to its own, within its segment and across. Points in the input's unit, one a vertex. `O(n)` a pass.
///
/// # Errors
/// [`ExtractError::Cancelled`].
pub fn smooth(
    points: &mut Vec<Point3<f64>>,
    graph: &EdgeGraph,
    passes: usize,
    control: &Control<'_>,
) -> Result<(), ExtractError> {
    for pass in 0..passes {
        control.report(Stage::LaplacianSmoothing, pass as f64 / passes as f64)?;
        let one = |i: usize| {
            let links = graph.neighbours(i as u32);
            if links.is_empty() {
                return points[i];
            }
            let pull: Vector3<f64> = links.iter().map(|&(j, _)| points[j as usize] - points[i]).sum();
            points[i] + pull * (STEP / links.len() as f64)
        };
        *points = (0..points.len()).into_par_iter().map(one).collect();
    }
    control.report(Stage::LaplacianSmoothing, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::centerline::test_surfaces::{capsule, closed_surface};

    #[test]
    fn points_on_a_straight_axis_stay_on_it_and_noise_goes() {
        let surface = closed_surface(&capsule(1.0, 20.0, 20));
        let graph = EdgeGraph::new(&surface.mesh.vertices, &surface.corners);
        let axis: Vec<_> = surface.mesh.vertices.iter().map(|p| Point3::new(0.0, 0.0, p.z)).collect();
        let mut smooth_axis = axis.clone();
        smooth(&mut smooth_axis, &graph, 10, &Control::silent()).unwrap();
        for (after, before) in smooth_axis.iter().zip(&axis) {
            assert!(after.x.abs() < 1e-12 && after.y.abs() < 1e-12);
            if (3.0..17.0).contains(&before.z) {
                assert!((after.z - before.z).abs() < 1e-9);
            }
        }
        let noise =
            |k: usize| Vector3::new((k as f64 * 0.618).fract() - 0.5, (k as f64 * 0.414).fract() - 0.5, 0.0);
        let mut noisy: Vec<_> = axis.iter().enumerate().map(|(k, p)| p + noise(k)).collect();
        let spread = |points: &[Point3<f64>]| points.iter().map(|p| p.x.powi(2) + p.y.powi(2)).sum::<f64>();
        let before = spread(&noisy);
        smooth(&mut noisy, &graph, 10, &Control::silent()).unwrap();
        assert!(spread(&noisy) < 0.1 * before, "{} {before}", spread(&noisy));
    }
}
