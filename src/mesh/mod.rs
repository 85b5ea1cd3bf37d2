//! Triangle surfaces: the type, its file formats, and what the method needs to know of them.

mod cavities;
mod components;
pub mod corner_table;
mod edge_groups;
mod flat_caps;
pub mod format;
mod matching;
pub mod measures;
pub mod normals;
mod numbering;
mod openings;
mod outlying;
pub mod preparation;
pub mod reopening;
mod sites;
mod snapping;
mod units;
mod weld;

use nalgebra::{Point3, Vector3};

pub use units::{Units, UnknownUnit};
pub use weld::{Welder, weld};

/// An indexed triangle surface, in the unit and frame of its file.
///
/// Triangles index into `vertices`; every index is in range and every coordinate finite
/// when the mesh comes from [`format::read`].
#[derive(Debug, Clone, Default, PartialEq)]
pub struct TriangleMesh {
    pub vertices: Vec<Point3<f64>>,
    pub triangles: Vec<[u32; 3]>,
}

impl TriangleMesh {
    /// The direction that a triangle faces, twice as long as its area.
    pub fn area_vector(&self, triangle: u32) -> Vector3<f64> {
        let [a, b, c] = self.triangles[triangle as usize].map(|v| self.vertices[v as usize]);
        (b - a).cross(&(c - a))
    }
}
