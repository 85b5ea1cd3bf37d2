//! Whether the line reaches every part of its surface: what it misses shows as wall without a line.

use crate::mesh::preparation::Surface;

use super::component::ComponentGraph;
use super::graph::Warning;

/// A warning when wall lies farther from the line of component `index` than its radii allow.
///
/// Looks at up to a few thousand vertices, evenly by number. O(those x points of the line).
pub fn check(index: usize, surface: &Surface, graph: &ComponentGraph) -> Option<Warning> {
    const SAMPLES: usize = 4000;
    /// Farthest that wall may lie, in radii of the line there: the wall of a flat vessel does.
    const FAR: f64 = 3.0;
    /// Least share of the wall that is told.
    const LEAST: f64 = 0.005;
    let line: Vec<_> = graph
        .branches
        .iter()
        .flat_map(|branch| branch.points.iter().zip(&branch.radii))
        .map(|(point, radius)| (*point, (FAR * radius).powi(2)))
        .collect();
    let step = surface.mesh.vertices.len().div_ceil(SAMPLES).max(1);
    let samples = surface.mesh.vertices.iter().step_by(step);
    let (mut missed, mut worst, mut count) = (0usize, None, 0usize);
    for vertex in samples {
        count += 1;
        let share = |(point, reach): &(nalgebra::Point3<f64>, f64)| (vertex - point).norm_squared() / reach;
        let nearest = line.iter().map(share).fold(f64::INFINITY, f64::min);
        if nearest > 1.0 {
            missed += 1;
            if worst.is_none_or(|(_, most)| nearest > most) {
                worst = Some((*vertex, nearest));
            }
        }
    }
    let (vertex, _) = worst.filter(|_| missed as f64 > LEAST * count as f64)?;
    Some(Warning {
        code: "wall-without-line",
        detail: format!(
            "{:.1} % of the wall of component {index} lies farther than {FAR} radii from the line, most of all at \
             [{:.4}, {:.4}, {:.4}]: a branch may be missing there",
            100.0 * missed as f64 / count as f64,
            vertex.x,
            vertex.y,
            vertex.z
        ),
    })
}

#[cfg(test)]
mod tests {
    use nalgebra::Point3;

    use super::*;
    use crate::centerline::graph::Branch;
    use crate::centerline::shapes::open_tube;
    use crate::mesh::preparation::prepare;

    #[test]
    fn wall_beyond_the_end_of_a_line_is_told() {
        let tube = &prepare(&open_tube(20.0, 60, 12)).unwrap().components[0];
        let line = |length: f64| ComponentGraph {
            branches: vec![Branch {
                from: 0,
                to: 1,
                points: (0..=40).map(|i| Point3::new(0.0, 0.0, length * f64::from(i) / 40.0)).collect(),
                radii: vec![1.0; 41],
            }],
            ..ComponentGraph::default()
        };
        assert_eq!(check(0, tube, &line(20.0)), None);
        let warning = check(0, tube, &line(12.0)).unwrap();
        assert!(warning.detail.starts_with("2") && warning.detail.contains("20.0000]"), "{}", warning.detail);
    }
}
