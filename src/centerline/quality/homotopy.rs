//! Homotopy, promised by construction (the paper's third property) and checked on every result.

use crate::mesh::preparation::Surface;

use crate::centerline::component::ComponentGraph;
use crate::centerline::graph::Warning;

/// Parts and loops of the line against those of the surface, its openings capped.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Homotopy {
    /// Components of the surface that have a line: those that were left out are warnings of their own.
    pub components: usize,
    /// Handles of these components.
    pub genus: usize,
    /// Connected parts of the line.
    pub parts: usize,
    /// Independent loops of the line.
    pub loops: usize,
    /// Whether each component has one part with as many loops as it has handles.
    pub equal: bool,
}

impl Default for Homotopy {
    /// That of nothing.
    fn default() -> Self {
        Self { components: 0, genus: 0, parts: 0, loops: 0, equal: true }
    }
}

impl Homotopy {
    /// That of one component and its line.
    pub fn of(surface: &Surface, graph: &ComponentGraph) -> Self {
        let parts = parts(graph);
        let loops = graph.branches.len() + parts - graph.nodes.len();
        let genus = surface.genus();
        Self { components: 1, genus, parts, loops, equal: parts == 1 && loops == genus }
    }

    pub fn add(&mut self, other: &Self) {
        self.components += other.components;
        self.genus += other.genus;
        self.parts += other.parts;
        self.loops += other.loops;
        self.equal &= other.equal;
    }

    /// That of component `index` where it fails.
    pub fn warning(&self, index: usize) -> Option<Warning> {
        let Self { genus, parts, loops, .. } = self;
        (!self.equal).then(|| Warning {
            code: "homotopy",
            detail: format!(
                "the line of component {index} has {parts} parts and {loops} loops, its surface 1 part and \
                 {genus} handles: branches are missing or too many"
            ),
        })
    }
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
        let node =
            Node { kind: NodeKind::End, position: Point3::origin(), radius: 1.0, equivalent_radius: 1.0 };
        let branch = |&(from, to): &(usize, usize)| Branch::new(from, to, Vec::new(), Vec::new());
        ComponentGraph {
            nodes: vec![node; nodes],
            branches: branches.iter().map(branch).collect(),
            ..ComponentGraph::default()
        }
    }

    fn told(surface: &Surface, graph: &ComponentGraph) -> Option<Warning> {
        Homotopy::of(surface, graph).warning(0)
    }

    #[test]
    fn loops_and_parts_are_counted() {
        let tube = &prepare(&open_tube(10.0, 20, 12)).unwrap().components[0];
        let ring = &prepare(&torus(10.0, 1.5, 40, 12)).unwrap().components[0];
        assert_eq!(told(tube, &graph(2, &[(0, 1)])), None);
        assert_eq!(told(ring, &graph(1, &[(0, 0)])), None);
        assert_eq!(told(ring, &graph(2, &[(0, 1), (1, 0)])), None);
        let warning = Homotopy::of(ring, &graph(4, &[(0, 1), (2, 3)])).warning(3).unwrap();
        assert!(warning.detail.contains("component 3 has 2 parts and 0 loops"), "{}", warning.detail);
        assert!(told(tube, &graph(2, &[(0, 1), (0, 1)])).is_some());
    }
}
