//! The centerline of one component of the surface, before components are put together.

use crate::centerline::ExtractError;
use crate::centerline::graph::{Branch, Node, NodeKind, Warning};

/// Nodes and branches of one component; node numbers are its own.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ComponentGraph {
    pub nodes: Vec<Node>,
    pub branches: Vec<Branch>,
    pub warnings: Vec<Warning>,
}

impl ComponentGraph {
    /// How many ends it has.
    pub fn ends(&self) -> usize {
        self.nodes.iter().filter(|node| node.kind == NodeKind::End).count()
    }

    /// Refuses a line that has a number which is none, or a negative radius: around torn and scrambled walls a fit may run away, and what
    /// comes of it must not look like a line.
    ///
    /// # Errors
    /// [`ExtractError::NotTubular`], with the first such branch.
    pub fn check_numbers(&self) -> Result<(), ExtractError> {
        let is_sound = |branch: &Branch| {
            let points = branch.points.iter().all(|point| point.iter().all(|number| number.is_finite()));
            let mut radii = branch.radii.iter().chain(&branch.equivalent_radii);
            points && radii.all(|&radius| (0.0..f64::INFINITY).contains(&radius))
        };
        let Some(branch) = self.branches.iter().find(|branch| !is_sound(branch)) else { return Ok(()) };
        let end = self.nodes[branch.from].position;
        let detail =
            format!("no line can be fitted to the wall of the branch at node {} ({end})", branch.from);
        Err(ExtractError::NotTubular { detail })
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Point3;

    use super::*;
    use crate::centerline::graph::NodeKind;

    #[test]
    fn a_number_that_is_none_is_refused_wherever_it_stands() {
        let branch = Branch {
            from: 0,
            to: 1,
            points: vec![Point3::origin(), Point3::new(0.0, 0.0, 1.0)],
            radii: vec![1.0; 2],
            equivalent_radii: vec![1.0; 2],
        };
        let end =
            Node { kind: NodeKind::End, position: Point3::origin(), radius: 1.0, equivalent_radius: 1.0 };
        let nodes = vec![end; 2];
        let sound = ComponentGraph { nodes, branches: vec![branch], warnings: Vec::new() };
        assert_eq!(sound.check_numbers(), Ok(()));
        let spoil: [fn(&mut Branch); 4] = [
            |branch| branch.radii[1] = -1.0,
            |branch| branch.points[1].y = f64::NAN,
            |branch| branch.radii[0] = f64::INFINITY,
            |branch| branch.equivalent_radii[1] = f64::NAN,
        ];
        for spoil in spoil {
            let mut graph = sound.clone();
            spoil(&mut graph.branches[0]);
            assert!(matches!(graph.check_numbers(), Err(ExtractError::NotTubular { .. })));
        }
    }
}
