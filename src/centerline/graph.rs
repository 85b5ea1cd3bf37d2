//! The result: a graph of nodes and the branches between them.

use nalgebra::Point3;

use super::quality::Quality;

/// What a node of the centerline is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NodeKind {
    /// The vessel ends here: one branch.
    End,
    /// Branches meet here: three or more branch ends; or the seam of a ring without junctions: two.
    Junction,
}

/// An end or a junction.
#[derive(Debug, Clone, PartialEq)]
pub struct Node {
    pub kind: NodeKind,
    /// In the input's unit and frame.
    pub position: Point3<f64>,
    /// Radius of the largest inscribed sphere at `position`, in the input's unit.
    pub radius: f64,
    /// Radius of the circle that has the area of the widest branch's section here, in the input's unit.
    pub equivalent_radius: f64,
}

/// A curve between two nodes (both ends at one node: a loop).
#[derive(Debug, Clone, PartialEq)]
pub struct Branch {
    /// Index of the node that `points` starts at.
    pub from: usize,
    /// Index of the node that `points` ends at.
    pub to: usize,
    /// At least two; the first and last equal the nodes' positions exactly.
    pub points: Vec<Point3<f64>>,
    /// Radius of the largest inscribed sphere at each point.
    pub radii: Vec<f64>,
    /// Radius of the circle that has the section's area at each point; none is below the inscribed one.
    pub equivalent_radii: Vec<f64>,
}

impl Branch {
    /// A branch whose sections are circles, as far as it is known.
    pub fn new(from: usize, to: usize, points: Vec<Point3<f64>>, radii: Vec<f64>) -> Self {
        Self { from, to, points, equivalent_radii: radii.clone(), radii }
    }

    /// The way along the points to each of them, in the input's unit.
    pub fn ways(&self) -> Vec<f64> {
        let mut way = 0.0;
        let steps = self.points.windows(2).map(|pair| (pair[1] - pair[0]).norm());
        let rest = steps.map(|step| {
            way += step;
            way
        });
        std::iter::once(0.0).chain(rest).collect()
    }

    /// Length along the points, in the input's unit.
    pub fn length(&self) -> f64 {
        self.points.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum()
    }
}

/// The centerline of every component of a surface.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Centerline {
    pub nodes: Vec<Node>,
    pub branches: Vec<Branch>,
}

impl Centerline {
    /// How many branch ends meet at a node (a loop at one node counts twice).
    pub fn degree(&self, node: usize) -> usize {
        self.branches
            .iter()
            .map(|branch| usize::from(branch.from == node) + usize::from(branch.to == node))
            .sum()
    }
}

/// What the surface was found to be, after welding and before capping.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct SurfaceSummary {
    pub vertices: usize,
    pub triangles: usize,
    pub components: usize,
    /// Sum over the components, openings capped.
    pub genus: usize,
    /// Boundary loops.
    pub openings: usize,
    /// Diagonal of the bounding box, in the input's unit.
    pub diagonal: f64,
}

/// Something the user should know about an otherwise successful result.
#[derive(Debug, Clone, PartialEq)]
pub struct Warning {
    /// A stable word.
    pub code: &'static str,
    /// With counts; never text out of the mesh file.
    pub detail: String,
}

/// All that [`super::extract`] answers.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Extraction {
    pub centerline: Centerline,
    pub surface: SurfaceSummary,
    /// What was measured of the line; `None` of one that no extraction made.
    pub quality: Option<Quality>,
    pub warnings: Vec<Warning>,
}
