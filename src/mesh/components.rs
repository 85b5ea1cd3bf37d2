//! The connected components of closed triangles: each a surface of its own, oriented outward, numbered by a walk; those
//! inside another go.

use std::ops::Range;

use nalgebra::Point3;
use rayon::prelude::*;

use super::TriangleMesh;
use super::cavities::inside_others;
use super::corner_table::{CornerTable, NONE};
use super::measures::signed_volume;
use super::numbering::walk;
use super::openings::Opening;
use super::preparation::{PreparationReport, Surface};

/// A connected component, oriented outward.
pub(super) struct Component {
    surface: Surface,
    /// Whether it was turned to be.
    inverted: bool,
    /// One of its vertices in the soup.
    vertex: u32,
}

impl Component {
    pub(super) fn into_surface(self) -> Surface {
        self.surface
    }
}

/// Drops the surfaces that lie inside another, and counts those and the inverted ones that remain.
pub(super) fn leave_cavities_out(
    components: Vec<Component>,
    names: &[u32],
    report: &mut PreparationReport,
) -> Vec<Surface> {
    let meshes: Vec<&TriangleMesh> = components.iter().map(|component| &component.surface.mesh).collect();
    let inside = inside_others(&meshes);
    let mut surfaces = Vec::with_capacity(components.len());
    for (component, inside) in components.into_iter().zip(inside) {
        if inside {
            report.cavities.add(names[component.vertex as usize]);
        } else {
            report.inverted_components += usize::from(component.inverted);
            surfaces.push(component.surface);
        }
    }
    surfaces
}

/// What belongs together in a closed soup, and the names that its vertices get.
pub(super) struct Order {
    /// Each triangle's component.
    component: Vec<u32>,
    /// Each component's triangles in ascending order.
    members: Vec<Vec<u32>>,
    /// Each component's vertices in their order.
    vertices: Vec<Vec<Point3<f64>>>,
    /// Each vertex's number in its component.
    vertex_name: Vec<u32>,
}

impl Order {
    /// O(triangles). `go_on` is asked before each component.
    pub(super) fn of<E>(
        soup: &TriangleMesh,
        opposite: &[u32],
        go_on: impl Fn() -> Result<(), E>,
    ) -> Result<Self, E> {
        let (component, members) = component_triangles(opposite, soup.triangles.len());
        let mut vertex_name = vec![NONE; soup.vertices.len()];
        let mut vertices = Vec::with_capacity(members.len());
        for triangles in &members {
            go_on()?;
            vertices.push(walk(soup, opposite, triangles, &mut vertex_name));
        }
        Ok(Self { component, members, vertices, vertex_name })
    }
}

/// Cuts the closed soup into its connected components, each oriented outward.
pub(super) fn split_components<E>(
    soup: &TriangleMesh,
    opposite: &[u32],
    openings: Vec<Opening>,
    order: Order,
    go_on: impl Fn() -> Result<(), E>,
) -> Result<Vec<Component>, E> {
    let Order { component, members, vertices, vertex_name } = order;
    let mut triangle_name = vec![NONE; soup.triangles.len()];
    let mut components = Vec::with_capacity(members.len());
    for (triangles, vertices) in members.iter().zip(vertices) {
        go_on()?;
        let vertex = soup.triangles[triangles[0] as usize][0];
        for (i, &t) in triangles.iter().enumerate() {
            triangle_name[t as usize] = i as u32;
        }
        let renamed = |&t: &u32| soup.triangles[t as usize].map(|v| vertex_name[v as usize]);
        let local = |h: usize| {
            let o = opposite[(3 * triangles[h / 3]) as usize + h % 3];
            3 * triangle_name[(o / 3) as usize] + o % 3
        };
        let mut mesh = TriangleMesh { vertices, triangles: triangles.par_iter().map(renamed).collect() };
        let mut local: Vec<u32> = (0..3 * triangles.len()).into_par_iter().map(local).collect();
        go_on()?;
        let inverted = signed_volume(&mesh) < 0.0;
        if inverted {
            local = invert(&mut mesh, &local);
        }
        let corners = CornerTable::new(&mesh.triangles, local, mesh.vertices.len());
        components.push(Component {
            surface: Surface { mesh, corners, openings: Vec::new() },
            inverted,
            vertex,
        });
    }
    go_on()?;
    for mut opening in openings {
        let Range { start, end } = opening.cap;
        let first = triangle_name[start as usize];
        opening.centre = vertex_name[opening.centre as usize];
        opening.rim.iter_mut().for_each(|v| *v = vertex_name[*v as usize]);
        // A fan's triangles follow each other, and keep their order.
        opening.cap = first..first + (end - start);
        components[component[start as usize] as usize].surface.openings.push(opening);
    }
    Ok(components)
}

/// Each triangle's component, and each component's triangles in ascending order.
fn component_triangles(opposite: &[u32], count: usize) -> (Vec<u32>, Vec<Vec<u32>>) {
    let mut component = vec![NONE; count];
    let mut found = 0;
    let mut queue = Vec::new();
    for seed in 0..count {
        if component[seed] != NONE {
            continue;
        }
        component[seed] = found;
        queue.push(seed as u32);
        while let Some(t) = queue.pop() {
            for h in 3 * t..3 * t + 3 {
                let other = (opposite[h as usize] / 3) as usize;
                if component[other] == NONE {
                    component[other] = found;
                    queue.push(other as u32);
                }
            }
        }
        found += 1;
    }
    let mut sizes = vec![0; found as usize];
    component.iter().for_each(|&c| sizes[c as usize] += 1);
    let mut members: Vec<Vec<u32>> = sizes.into_iter().map(Vec::with_capacity).collect();
    for (t, &c) in component.iter().enumerate() {
        members[c as usize].push(t as u32);
    }
    (component, members)
}

/// Turns every triangle over; returns the opposites in the new half-edge numbers.
fn invert(mesh: &mut TriangleMesh, opposite: &[u32]) -> Vec<u32> {
    // [a, b, c] becomes [a, c, b]: half-edges 0, 1, 2 come to lie at 2, 1, 0.
    let renamed = |h: u32| 3 * (h / 3) + (2 - h % 3);
    let mut turned = vec![NONE; opposite.len()];
    for (h, &o) in opposite.iter().enumerate() {
        turned[renamed(h as u32) as usize] = renamed(o);
    }
    mesh.triangles.iter_mut().for_each(|t| t.swap(1, 2));
    turned
}
