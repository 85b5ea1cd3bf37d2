//! Whose wall a section cuts: the level sets of a branch sweep its wall, so every vertex has an owner.
//!
//! A section that takes in another branch cuts that branch's wall; one that only grows quickly (the bulb
//! of a carotid, a fusiform aneurysm) does not.

use crate::mesh::preparation::Surface;

use crate::centerline::cut_plane::section::Section;
use crate::centerline::tips::Chain;
use crate::centerline::tips::reeb::ReebGraph;

const NONE: u32 = u32::MAX;

/// Number of the chain that sweeps each vertex; what was swept by a leaf that is no tip belongs to the
/// chain beside it. O(n).
pub fn owners(surface: &Surface, graph: &ReebGraph, chains: &[Chain]) -> Vec<u32> {
    let mut owner = vec![NONE; surface.mesh.vertices.len()];
    let mut queue: Vec<u32> = Vec::with_capacity(owner.len());
    for (number, chain) in chains.iter().enumerate() {
        for &(arc, _) in &chain.arcs {
            for &v in &graph.arcs[arc as usize].vertices {
                owner[v as usize] = number as u32;
                queue.push(v);
            }
        }
    }
    let mut next = 0;
    while let Some(&v) = queue.get(next) {
        next += 1;
        for u in surface.corners.neighbours(v) {
            if owner[u as usize] == NONE {
                owner[u as usize] = owner[v as usize];
                queue.push(u);
            }
        }
    }
    owner
}

/// The wall of one branch.
#[derive(Debug, Clone, Copy)]
pub struct Wall<'a> {
    pub surface: &'a Surface,
    owners: &'a [u32],
    own: u32,
}

impl<'a> Wall<'a> {
    /// The wall of chain number `own`.
    pub fn new(surface: &'a Surface, owners: &'a [u32], own: usize) -> Self {
        Self { surface, owners, own: own as u32 }
    }

    /// Whether nearly all of a section lies on the branch's own wall.
    pub fn owns(&self, cut: &Section) -> bool {
        /// Share of the section's length.
        const OWN: f64 = 0.95;
        let (mut own, mut all) = (0.0, 0.0);
        for (p, q, t) in cut.sides() {
            let length = (q - p).norm();
            let corners = self.surface.mesh.triangles[t as usize];
            let mine = corners.iter().filter(|&&v| self.owners[v as usize] == self.own).count();
            all += length;
            own += if mine >= 2 { length } else { 0.0 };
        }
        own > OWN * all
    }
}
