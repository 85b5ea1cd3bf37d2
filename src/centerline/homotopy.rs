//! Homotopy, promised by construction (the paper's third property) and checked on every result.

use crate::mesh::preparation::Surface;

use super::component::ComponentGraph;
use super::graph::Warning;

/// A warning when the line of component `index` is not one part with as many loops as the surface, its
/// openings capped, has handles.
pub fn check(index: usize, surface: &Surface, graph: &ComponentGraph) -> Option<Warning> {
    let parts = parts(graph);
    let loops = graph.branches.len() + parts - graph.nodes.len();
    let genus = surface.genus();
    let equal = parts == 1 && loops == genus;
    (!equal).then(|| Warning {
        code: "homotopy",
        detail: format!(
            "the line of component {index} has {parts} parts and {loops} loops, its surface 1 part and {genus} \
             handles: branches are missing or too many"
        ),
    })
}

/// Connected parts of the graph.
fn parts(graph: &ComponentGraph) -> usize {
    let mut name: Vec<usize> = (0..graph.nodes.len()).collect();
    let mut parts = graph.nodes.len();
    for branch in &graph.branches {
        let (a, b) = (root(&mut name, branch.from), root(&mut name, branch.to));
        if a != b {
            name[a] = b;
            parts -= 1;
        }
    }
    parts
}

/// The name of a node's part, with the path to it halved.
fn root(name: &mut [usize], mut node: usize) -> usize {
    while name[node] != node {
        name[node] = name[name[node]];
        node = name[node];
    }
    node
}

#[cfg(test)]
mod tests {
    use nalgebra::Point3;

    use super::*;
    use crate::centerline::graph::{Branch, Node, NodeKind};
    use crate::centerline::shapes::{open_tube, torus};
    use crate::mesh::preparation::prepare;

    fn graph(nodes: usize, branches: &[(usize, usize)]) -> ComponentGraph {
        let node = Node { kind: NodeKind::End, position: Point3::origin(), radius: 1.0 };
        let branch =
            |&(from, to): &(usize, usize)| Branch { from, to, points: Vec::new(), radii: Vec::new() };
        ComponentGraph {
            nodes: vec![node; nodes],
            branches: branches.iter().map(branch).collect(),
            ..ComponentGraph::default()
        }
    }

    #[test]
    fn loops_and_parts_are_counted() {
        let tube = &prepare(&open_tube(10.0, 20, 12)).unwrap().components[0];
        let ring = &prepare(&torus(10.0, 1.5, 40, 12)).unwrap().components[0];
        assert_eq!(check(0, tube, &graph(2, &[(0, 1)])), None);
        assert_eq!(check(0, ring, &graph(1, &[(0, 0)])), None);
        assert_eq!(check(0, ring, &graph(2, &[(0, 1), (1, 0)])), None);
        let warning = check(3, ring, &graph(4, &[(0, 1), (2, 3)])).unwrap();
        assert!(warning.detail.contains("component 3 has 2 parts and 0 loops"), "{}", warning.detail);
        assert!(check(0, tube, &graph(2, &[(0, 1), (0, 1)])).is_some());
    }
}
