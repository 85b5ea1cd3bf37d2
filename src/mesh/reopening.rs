//! Cuts that are known for such only once a line was found: their caps go, as if the mesh had come open.

use std::convert::Infallible;

use nalgebra::Point3;
use rustc_hash::{FxHashMap, FxHashSet};

use super::components::{Order, split_components};
use super::flat_caps::FlatCaps;
use super::openings::cap;
use super::preparation::{Surface, split_fans};

/// What closes a cut.
#[derive(Debug, Clone, PartialEq)]
pub struct Closure {
    /// A disc.
    pub triangles: Vec<u32>,
    /// Where the vessel's axis passes it.
    pub middle: Point3<f64>,
}

impl Surface {
    /// The same surface with the triangles of each closure replaced by the fan of an opening around its middle; `None`
    /// where that leaves more than one surface. Vertices are numbered anew. O(triangles).
    pub fn reopened(&self, closures: &[&Closure]) -> Option<Self> {
        let mut soup = self.mesh.clone();
        let mut opposite: Vec<u32> =
            (0..self.corners.half_edges() as u32).map(|h| self.corners.opposite(h)).collect();
        let mut middles = FxHashMap::default();
        for closure in closures {
            let corners = closure.triangles.iter().flat_map(|&t| self.mesh.triangles[t as usize]);
            middles.extend(corners.map(|v| (v, closure.middle)));
        }
        let rims = self.caps_out(closures, &middles).take_out(&mut soup, &mut opposite);
        let (_, names) = split_fans(&mut soup, &opposite);
        let rims: FxHashSet<u32> =
            (0..names.len() as u32).filter(|&v| rims.contains(&names[v as usize])).collect();
        let (openings, _) = cap(&mut soup, &mut opposite, &rims);
        for opening in &openings {
            if let Some(middle) = middles.get(&names[opening.rim[0] as usize]) {
                soup.vertices[opening.centre as usize] = *middle;
            }
        }
        let go_on = || Ok::<(), Infallible>(());
        let Ok(order) = Order::of(&soup, &opposite, go_on);
        let Ok(components) = split_components(&soup, &opposite, openings, order, go_on);
        let [surface] = <[_; 1]>::try_from(components).ok()?;
        Some(surface.into_surface())
    }

    /// All caps, those of `closures` among them, whose vertices have `middles`; openings are closed again as they were.
    fn caps_out(&self, closures: &[&Closure], middles: &FxHashMap<u32, Point3<f64>>) -> FlatCaps {
        let known = self.openings.iter().flat_map(|opening| opening.cap.clone());
        let closed = self.openings.iter().filter(|opening| opening.was_closed);
        let rims = closed.flat_map(|opening| opening.rim.iter().copied()).chain(middles.keys().copied());
        let triangles = closures.iter().flat_map(|closure| closure.triangles.iter().copied()).chain(known);
        FlatCaps { triangles: triangles.collect(), rims: rims.collect() }
    }
}
