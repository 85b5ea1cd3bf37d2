//! Radii that are smaller than the sphere that fits.
//!
//! Beside an opening that is cut near a joint, sections run through its cap as well, and what they show of the wall runs
//! out to nothing. The sphere that touches the nearest wall fits for sure: no radius is less.

use nalgebra::Point3;

use super::component::ComponentGraph;
use super::graph::NodeKind;
use super::triangle_grid::TriangleGrid;

/// Radius over the widest of its branch below which it is held against the wall.
const SMALL: f64 = 0.5;
/// Distance of the wall over the radius above which that is too small.
const CLEAR: f64 = 1.25;

/// Raises radii from each end inward that are less than half of the widest in their branch and far from the wall, to its
/// distance; to no more than the widest, for a point outside the lumen has wall at any distance. Up to the first that is
/// right: a thin branch inside a wide vessel keeps its own. O(points + triangles around those looked at).
pub fn raise(grid: &TriangleGrid<'_>, graph: &mut ComponentGraph) {
    for branch in &mut graph.branches {
        let widest = branch.radii.iter().copied().fold(0.0, f64::max);
        let fit = |radius: &mut f64, point: &Point3<f64>| {
            if *radius >= SMALL * widest {
                return false;
            }
            let room = grid.wall_distance(point).min(widest);
            let is_small = room > CLEAR * *radius;
            if is_small {
                *radius = room;
            }
            is_small
        };
        let count = branch.points.len();
        for (node, is_last) in [(branch.from, false), (branch.to, true)] {
            let node = &mut graph.nodes[node];
            if node.kind != NodeKind::End {
                continue;
            }
            fit(&mut node.radius, &node.position);
            for i in (0..count).map(|i| if is_last { count - 1 - i } else { i }) {
                if !fit(&mut branch.radii[i], &branch.points[i]) {
                    break;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::centerline::graph::{Branch, Node};
    use crate::centerline::shapes::open_tube;
    use crate::centerline::test_surfaces::closed_surface;

    #[test]
    fn radii_that_run_out_to_nothing_at_an_open_end_are_those_of_the_wall() {
        let surface = closed_surface(&open_tube(8.0, 33, 96));
        let at = |z: f64| Point3::new(0.0, 0.0, z);
        let places = [0.0, 2.0, 4.0, 6.0, 7.0, 7.5, 8.0];
        let radii = vec![1.0, 1.0, 0.6, 0.9, 0.4, 0.01, 1e-5];
        let node = |z: f64, radius: f64| Node {
            position: at(z),
            radius,
            equivalent_radius: radius,
            kind: NodeKind::End,
        };
        let branch = Branch {
            from: 0,
            to: 1,
            points: places.map(at).to_vec(),
            equivalent_radii: radii.clone(),
            radii: radii.clone(),
        };
        let nodes = vec![node(0.0, 1.0), node(8.0, 1e-5)];
        let mut graph = ComponentGraph { nodes, branches: vec![branch], ..ComponentGraph::default() };
        raise(&TriangleGrid::new(&surface), &mut graph);
        let found = &graph.branches[0].radii;
        assert!(found[4..].iter().all(|radius| (radius - 1.0).abs() < 1e-3), "{found:?}");
        assert_eq!(found[..4], radii[..4], "no end, or not half of the widest");
        assert!((graph.nodes[1].radius - 1.0).abs() < 1e-3 && graph.nodes[0].radius == 1.0);
    }
}
