//! The centerline of one component of the surface, before components are put together.

use crate::centerline::graph::{Branch, Node, Warning};

/// Nodes and branches of one component; node numbers are its own.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ComponentGraph {
    pub nodes: Vec<Node>,
    pub branches: Vec<Branch>,
    pub warnings: Vec<Warning>,
}
