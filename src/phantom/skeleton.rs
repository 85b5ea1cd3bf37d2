//! Vessels as curves with radii, and the graph they make.

use nalgebra::{Point3, Unit, Vector3};

use crate::centerline::{Branch, Centerline, Node, NodeKind};

use super::curve::direction;

/// A curve with a radius at each point. The lumen is the union of the spheres.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Vessel {
    pub points: Vec<Point3<f64>>,
    pub radii: Vec<f64>,
    /// Vessel and point that this one starts from.
    pub parent: Option<(usize, usize)>,
    /// The last point is the first one.
    pub closed: bool,
    /// How many of the points, from the first, carry a sphere: a sac's dome is one ball.
    pub solid: usize,
}

impl Vessel {
    pub fn new(points: Vec<Point3<f64>>, radii: Vec<f64>, parent: Option<(usize, usize)>) -> Self {
        let solid = points.len();
        Self { points, radii, parent, closed: false, solid }
    }

    /// With radii that change evenly from `radii[0]` to `radii[1]`.
    pub fn tapered(points: Vec<Point3<f64>>, radii: [f64; 2], parent: Option<(usize, usize)>) -> Self {
        let last = (points.len() - 1) as f64;
        let radius = |place: usize| radii[0] + (radii[1] - radii[0]) * place as f64 / last;
        let radii = (0..points.len()).map(radius).collect();
        Self::new(points, radii, parent)
    }

    fn last(&self) -> usize {
        self.points.len() - 1
    }
}

/// The flat end of a vessel: the lumen lies behind the plane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Cut {
    pub point: Point3<f64>,
    /// Out of the vessel.
    pub normal: Unit<Vector3<f64>>,
    pub radius: f64,
}

/// All vessels; a parent stands before its children.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Skeleton {
    pub vessels: Vec<Vessel>,
}

impl Skeleton {
    /// The places of a vessel that others start from, in order, each once.
    fn joints(&self, vessel: usize) -> Vec<usize> {
        let place = |child: &Vessel| child.parent.filter(|parent| parent.0 == vessel).map(|parent| parent.1);
        let mut places: Vec<_> = self.vessels.iter().filter_map(place).collect();
        places.sort_unstable();
        places.dedup();
        places
    }

    /// The cuts at a vessel's first and last point.
    pub fn cuts(&self, vessel: usize) -> [Option<Cut>; 2] {
        let Vessel { points, radii, parent, closed, solid } = &self.vessels[vessel];
        let last = points.len() - 1;
        let cut = |place: usize, sign: f64| Cut {
            point: points[place],
            normal: Unit::new_normalize(direction(points, place).into_inner() * sign),
            radius: radii[place],
        };
        let free_start = !closed && parent.is_none();
        let free_end = !closed && *solid == points.len() && self.joints(vessel).last() != Some(&last);
        [free_start.then(|| cut(0, -1.0)), free_end.then(|| cut(last, 1.0))]
    }

    /// The graph: a vessel is a branch, or several where others start from it.
    pub fn graph(&self) -> Centerline {
        let mut graph = Centerline::default();
        // Node at each joint of each vessel, as (place, node).
        let mut nodes: Vec<Vec<(usize, usize)>> = Vec::new();
        for (index, vessel) in self.vessels.iter().enumerate() {
            let mut at: Vec<(usize, usize)> = Vec::new();
            if let Some((parent, place)) = vessel.parent {
                at.extend(nodes[parent].iter().find(|joint| joint.0 == place).map(|joint| (0, joint.1)));
            } else if !vessel.closed {
                at.push((0, add_node(&mut graph, NodeKind::End, vessel, 0)));
            }
            for place in self.joints(index) {
                at.push((place, add_node(&mut graph, NodeKind::Junction, vessel, place)));
            }
            if vessel.closed && at.is_empty() {
                at.push((0, add_node(&mut graph, NodeKind::Junction, vessel, 0)));
            } else if !vessel.closed && at.last().is_none_or(|joint| joint.0 != vessel.last()) {
                at.push((vessel.last(), add_node(&mut graph, NodeKind::End, vessel, vessel.last())));
            }
            add_branches(&mut graph, vessel, &at);
            nodes.push(at);
        }
        graph
    }
}

fn add_node(graph: &mut Centerline, kind: NodeKind, vessel: &Vessel, place: usize) -> usize {
    let radius = vessel.radii[place];
    graph.nodes.push(Node { kind, position: vessel.points[place], radius, equivalent_radius: radius });
    graph.nodes.len() - 1
}

/// The pieces of a vessel between its nodes; those of a ring go around it.
fn add_branches(graph: &mut Centerline, vessel: &Vessel, nodes: &[(usize, usize)]) {
    let mut add = |places: Vec<usize>, from: usize, to: usize| {
        let points = places.iter().map(|&place| vessel.points[place]).collect();
        let radii = places.iter().map(|&place| vessel.radii[place]).collect();
        graph.branches.push(Branch::new(from, to, points, radii));
    };
    for pair in nodes.windows(2) {
        add((pair[0].0..=pair[1].0).collect(), pair[0].1, pair[1].1);
    }
    if let (true, Some(first), Some(last)) = (vessel.closed, nodes.first(), nodes.last()) {
        // The last point of a ring is its first: it is named once.
        add((last.0..vessel.last()).chain(0..=first.0).collect(), last.1, first.1);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(points: &[[f64; 3]], parent: Option<(usize, usize)>) -> Vessel {
        Vessel::tapered(points.iter().copied().map(Point3::from).collect(), [2.0, 1.0], parent)
    }

    #[test]
    fn a_side_branch_splits_its_parent() {
        let trunk = line(&[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]], None);
        let side = line(&[[1.0, 0.0, 0.0], [1.0, 3.0, 0.0]], Some((0, 1)));
        let skeleton = Skeleton { vessels: vec![trunk, side] };
        let graph = skeleton.graph();
        assert_eq!(graph.nodes.len(), 4);
        let ends: Vec<_> = graph.branches.iter().map(|branch| (branch.from, branch.to)).collect();
        assert_eq!(ends, [(0, 1), (1, 2), (1, 3)]);
        assert_eq!(graph.nodes[1].kind, NodeKind::Junction);
        assert_eq!(graph.nodes[1].radius, 1.5);
        let tip = skeleton.cuts(1);
        assert!(tip[0].is_none());
        assert_eq!(tip[1].unwrap().normal, Vector3::y_axis());
        assert_eq!(skeleton.cuts(0)[0].unwrap().normal, -Vector3::x_axis());
    }

    #[test]
    fn a_child_at_the_end_continues_and_uncuts_its_parent() {
        let trunk = line(&[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]], None);
        let arm = |y: f64| line(&[[1.0, 0.0, 0.0], [2.0, y, 0.0]], Some((0, 1)));
        let skeleton = Skeleton { vessels: vec![trunk, arm(1.0), arm(-1.0)] };
        assert_eq!(skeleton.cuts(0)[1], None);
        let graph = skeleton.graph();
        assert_eq!((graph.nodes.len(), graph.branches.len()), (4, 3));
        assert_eq!(graph.degree(1), 3);
    }

    #[test]
    fn rings_go_around() {
        let square = [[0.0; 3], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0], [0.0; 3]];
        let mut ring = line(&square, None);
        ring.closed = true;
        let alone = Skeleton { vessels: vec![ring.clone()] }.graph();
        assert_eq!((alone.nodes.len(), alone.branches.len()), (1, 1));
        assert_eq!(alone.branches[0].length(), 4.0);
        let arm = line(&[[1.0, 1.0, 0.0], [5.0, 5.0, 0.0]], Some((0, 2)));
        let other = line(&[[1.0, 0.0, 0.0], [5.0, -5.0, 0.0]], Some((0, 1)));
        let graph = Skeleton { vessels: vec![ring, arm, other] }.graph();
        assert_eq!((graph.nodes.len(), graph.branches.len()), (4, 4));
        assert_eq!(graph.branches[0].length(), 1.0);
        assert_eq!(graph.branches[1].length(), 3.0);
        assert_eq!((graph.branches[1].from, graph.branches[1].to), (1, 0));
    }
}
