//! Cuts that are known for such only once a line was found: their caps go, as if the mesh had come open.

use nalgebra::Point3;
use rustc_hash::FxHashSet;

use super::components::{Order, split_components};
use super::flat_caps::FlatCaps;
use super::openings::{Opening, cap};
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
    /// where that leaves more than one surface. Openings that are there keep their centres. Vertices are numbered anew.
    /// O(triangles).
    ///
    /// # Errors
    /// That of `go_on`, which is asked between the steps, each a few passes over the surface.
    pub fn reopened<E>(
        &self,
        closures: &[&Closure],
        go_on: impl Fn() -> Result<(), E>,
    ) -> Result<Option<Self>, E> {
        let mut soup = self.mesh.clone();
        let mut opposite: Vec<u32> =
            (0..self.corners.half_edges() as u32).map(|h| self.corners.opposite(h)).collect();
        go_on()?;
        let (caps, rims) = self.caps_out(closures);
        caps.take_out(&mut soup, &mut opposite);
        let (_, names) = split_fans(&mut soup, &opposite);
        go_on()?;
        // None of these is judged to be a hole of the wall: that was done when they were found.
        let on_any: FxHashSet<u32> = rims.iter().flat_map(|rim| rim.vertices.iter().copied()).collect();
        let on_rims = (0..names.len() as u32).filter(|&v| on_any.contains(&names[v as usize])).collect();
        let (mut openings, _) = cap(&mut soup, &mut opposite, &on_rims);
        for opening in &mut openings {
            let holds = |rim: &&Rim| opening.rim.iter().all(|&v| rim.vertices.contains(&names[v as usize]));
            if let Some(rim) = rims.iter().find(holds) {
                soup.vertices[opening.centre as usize] = rim.centre;
                opening.was_closed = rim.was_closed;
            }
        }
        go_on()?;
        let order = Order::of(&soup, &opposite, &go_on)?;
        let components = split_components(&soup, &opposite, openings, order, &go_on)?;
        Ok(<[_; 1]>::try_from(components).ok().map(|[surface]| surface.into_surface()))
    }

    /// All caps, those of `closures` among them, and what they leave.
    fn caps_out(&self, closures: &[&Closure]) -> (FlatCaps, Vec<Rim>) {
        let of_closure = |closure: &&Closure| Rim {
            vertices: closure.triangles.iter().flat_map(|&t| self.mesh.triangles[t as usize]).collect(),
            centre: closure.middle,
            was_closed: true,
        };
        let of_opening = |opening: &Opening| Rim {
            vertices: opening.rim.iter().copied().collect(),
            centre: self.mesh.vertices[opening.centre as usize],
            was_closed: opening.was_closed,
        };
        let rims = closures.iter().map(of_closure).chain(self.openings.iter().map(of_opening)).collect();
        let known = self.openings.iter().flat_map(|opening| opening.cap.clone());
        let triangles = closures.iter().flat_map(|closure| closure.triangles.iter().copied()).chain(known);
        (FlatCaps::of(triangles.collect()), rims)
    }
}

/// An opening to be.
struct Rim {
    /// Its own, and of a closure all others.
    vertices: FxHashSet<u32>,
    centre: Point3<f64>,
    was_closed: bool,
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;

    use super::*;
    use crate::mesh::TriangleMesh;
    use crate::mesh::preparation::prepare;

    /// A straight tube of radius 1 along z: so many rings, half apart, of 16 vertices, open at both ends.
    fn open_tube(rings: u32) -> TriangleMesh {
        let at = |i: u32, j: u32| i * 16 + j % 16;
        let around = |j: u32| std::f64::consts::TAU * f64::from(j) / 16.0;
        let on_ring =
            |i: u32| (0..16).map(move |j| Point3::new(around(j).cos(), around(j).sin(), 0.5 * f64::from(i)));
        let side = |i: u32| {
            (0..16).flat_map(move |j| {
                let (a, b, c, d) = (at(i, j), at(i, j + 1), at(i + 1, j), at(i + 1, j + 1));
                [[a, b, c], [b, d, c]]
            })
        };
        TriangleMesh {
            vertices: (0..rings).flat_map(on_ring).collect(),
            triangles: (0..rings - 1).flat_map(side).collect(),
        }
    }

    #[test]
    fn what_is_opened_later_leaves_the_openings_before_where_they_are() {
        // A tube whose one end is open and whose other is closed by a fan.
        let mut mesh = open_tube(13);
        let centre = mesh.vertices.len() as u32;
        mesh.vertices.push(Point3::new(0.0, 0.0, 6.0));
        mesh.triangles.extend((0..16).map(|k| [12 * 16 + k, 12 * 16 + (k + 1) % 16, centre]));
        let surface = prepare(&mesh).unwrap().components.remove(0);
        let (open, before) = (surface.open_cuts(), surface.openings.len());
        let fan = |surface: &Surface| -> Vec<u32> {
            let top = |t: &u32| {
                surface.mesh.triangles[*t as usize].iter().all(|&v| surface.mesh.vertices[v as usize].z > 5.9)
            };
            (0..surface.mesh.triangles.len() as u32).filter(|t| top(t) && !surface.is_cap(*t)).collect()
        };
        let triangles = fan(&surface);
        assert_eq!((open, before, triangles.len()), (1, 1, 16), "only the one end is open");
        let aside = Point3::new(0.3, 0.0, 6.0);
        let go_on = || Ok::<(), Infallible>(());
        let Ok(once) = surface.reopened(&[&Closure { triangles, middle: aside }], go_on);
        let once = once.unwrap();
        let centres = |surface: &Surface| -> Vec<(bool, Point3<f64>)> {
            let of = |o: &Opening| (o.was_closed, surface.mesh.vertices[o.centre as usize]);
            surface.openings.iter().map(of).collect()
        };
        assert!(centres(&once).contains(&(true, aside)) && once.openings.len() == 2, "{:?}", centres(&once));
        let Ok(twice) = once.reopened(&[], go_on);
        let twice = twice.unwrap();
        assert!(centres(&twice).contains(&(true, aside)), "{:?}", centres(&twice));
        assert_eq!((twice.open_cuts(), twice.openings.len()), (1, 2));
    }
}
