//! Surfaces of known shape, and what can be done to a surface.

use std::collections::HashMap;
use std::f64::consts::TAU;

use nalgebra::{Isometry3, Point3, Vector3};
use rosaline::mesh::TriangleMesh;

/// What closes the two ends of a swept surface.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ends {
    /// Nothing.
    Open,
    /// A fan around a vertex on the axis.
    Flat,
    /// Each other: the axis is a closed curve.
    Ring,
}

/// A surface around `axis` (parameter 0 to 1), swept without twist: `section` gives the place in the plane
/// across the axis at a share of the axis and an angle. Normals point out for a section that runs
/// counter-clockwise.
pub fn sweep(
    axis: impl Fn(f64) -> Point3<f64>,
    section: impl Fn(f64, f64) -> [f64; 2],
    [rings, sides]: [usize; 2],
    ends: Ends,
) -> TriangleMesh {
    let last = if ends == Ends::Ring { rings } else { rings - 1 };
    let share = |ring: usize| ring as f64 / last as f64;
    let mut mesh = TriangleMesh::default();
    let mut across = Vector3::zeros();
    for ring in 0..rings {
        let along = direction(&axis, share(ring), ends == Ends::Ring);
        if ring == 0 {
            across = Vector3::ith(along.iamin(), 1.0);
        }
        across = (across - along * along.dot(&across)).normalize();
        let up = along.cross(&across);
        for side in 0..sides {
            let [x, y] = section(share(ring), TAU * side as f64 / sides as f64);
            mesh.vertices.push(axis(share(ring)) + across * x + up * y);
        }
    }
    let vertex = |ring: usize, side: usize| ((ring % rings) * sides + side % sides) as u32;
    for ring in 0..last {
        for side in 0..sides {
            let (a, b) = (vertex(ring, side), vertex(ring, side + 1));
            let (c, d) = (vertex(ring + 1, side), vertex(ring + 1, side + 1));
            mesh.triangles.extend([[a, b, c], [b, d, c]]);
        }
    }
    if ends == Ends::Flat {
        for (ring, middle, inward) in [(0, axis(0.0), true), (rings - 1, axis(1.0), false)] {
            let centre = mesh.vertices.len() as u32;
            mesh.vertices.push(middle);
            for side in 0..sides {
                let (a, b) = (vertex(ring, side), vertex(ring, side + 1));
                mesh.triangles.push(if inward { [b, a, centre] } else { [a, b, centre] });
            }
        }
    }
    mesh
}

/// Unit direction of an axis by central differences.
fn direction(axis: &impl Fn(f64) -> Point3<f64>, at: f64, ring: bool) -> Vector3<f64> {
    let (low, high) =
        if ring { (at - 1e-5, at + 1e-5) } else { ((at - 1e-5).max(0.0), (at + 1e-5).min(1.0)) };
    (axis(high) - axis(low)).normalize()
}

/// The section of a circle.
pub fn round(radius: f64) -> impl Fn(f64, f64) -> [f64; 2] {
    move |_, angle| [radius * angle.cos(), radius * angle.sin()]
}

/// A straight axis from the origin along z.
pub fn straight(length: f64) -> impl Fn(f64) -> Point3<f64> {
    move |share| Point3::new(0.0, 0.0, share * length)
}

/// A circle in the plane z = 0.
pub fn circle(radius: f64) -> impl Fn(f64) -> Point3<f64> {
    move |share| Point3::new(radius * (TAU * share).cos(), radius * (TAU * share).sin(), 0.0)
}

/// The surface where `field` is zero (negative inside), by marching tetrahedra over a grid of side `step`
/// from `low` to `high`, whose border must lie outside. Manifold, closed, normals out.
pub fn implicit(
    low: [f64; 3],
    high: [f64; 3],
    step: f64,
    field: impl Fn(&Point3<f64>) -> f64,
) -> TriangleMesh {
    let cells = [0, 1, 2].map(|k| ((high[k] - low[k]) / step).ceil() as usize);
    let size = cells.map(|count| count + 1);
    let name = |[x, y, z]: [usize; 3]| (z * size[1] + y) * size[0] + x;
    let place = |index: usize| {
        let at = [index % size[0], index / size[0] % size[1], index / size[0] / size[1]];
        Point3::from([0, 1, 2].map(|k| low[k] + step * at[k] as f64))
    };
    let values: Vec<f64> = (0..size[0] * size[1] * size[2]).map(|index| field(&place(index))).collect();
    let mut mesh = TriangleMesh::default();
    let mut names: HashMap<(usize, usize), u32> = HashMap::new();
    let mut cut = |mesh: &mut TriangleMesh, inside: usize, outside: usize| {
        *names.entry((inside, outside)).or_insert_with(|| {
            let share = (values[inside] / (values[inside] - values[outside])).clamp(1e-3, 1.0 - 1e-3);
            mesh.vertices.push(place(inside) + (place(outside) - place(inside)) * share);
            mesh.vertices.len() as u32 - 1
        })
    };
    // Six tetrahedra around the diagonal of a cell.
    const RING: [usize; 7] = [1, 3, 2, 6, 4, 5, 1];
    for cell in 0..cells[0] * cells[1] * cells[2] {
        let base = [cell % cells[0], cell / cells[0] % cells[1], cell / cells[0] / cells[1]];
        let corner = |k: usize| name([base[0] + (k & 1), base[1] + (k >> 1 & 1), base[2] + (k >> 2)]);
        for pair in RING.windows(2) {
            let tetrahedron = [corner(0), corner(7), corner(pair[0]), corner(pair[1])];
            let (inside, outside): (Vec<usize>, Vec<usize>) =
                tetrahedron.into_iter().partition(|&corner| values[corner] < 0.0);
            let edges: &[(usize, usize)] = match (inside.len(), outside.len()) {
                (1, 3) => &[(0, 0), (0, 1), (0, 2)],
                (3, 1) => &[(0, 0), (1, 0), (2, 0)],
                (2, 2) => &[(0, 0), (0, 1), (1, 1), (1, 0)],
                _ => continue,
            };
            // Which way it faces is told by the edges' middles: those never lie on one line.
            let middle = |&(i, o): &(usize, usize)| nalgebra::center(&place(inside[i]), &place(outside[o]));
            let [a, b, c] = [0, 1, 2].map(|k| middle(&edges[k]));
            let outward = place(outside[0]) - place(inside[0]);
            let turned = (b - a).cross(&(c - a)).dot(&outward) < 0.0;
            let mut polygon: Vec<u32> =
                edges.iter().map(|&(i, o)| cut(&mut mesh, inside[i], outside[o])).collect();
            if turned {
                polygon.reverse();
            }
            for k in 2..polygon.len() {
                mesh.triangles.push([polygon[0], polygon[k - 1], polygon[k]]);
            }
        }
    }
    mesh
}

/// Distance from a segment.
pub fn from_segment(point: &Point3<f64>, from: Point3<f64>, to: Point3<f64>) -> f64 {
    let span = to - from;
    let share = ((point - from).dot(&span) / span.norm_squared()).clamp(0.0, 1.0);
    (point - from - span * share).norm()
}

/// Several surfaces as one soup, in order.
pub fn together(meshes: &[TriangleMesh]) -> TriangleMesh {
    let mut all = TriangleMesh::default();
    for mesh in meshes {
        let base = all.vertices.len() as u32;
        all.vertices.extend(&mesh.vertices);
        all.triangles.extend(mesh.triangles.iter().map(|triangle| triangle.map(|v| v + base)));
    }
    all
}

/// The surface with every vertex moved.
pub fn mapped(mesh: &TriangleMesh, to: impl Fn(&Point3<f64>) -> Point3<f64>) -> TriangleMesh {
    TriangleMesh { vertices: mesh.vertices.iter().map(to).collect(), triangles: mesh.triangles.clone() }
}

/// A motion without symmetry.
pub fn turn() -> Isometry3<f64> {
    Isometry3::new(Vector3::new(3.0, -7.0, 11.0), Vector3::new(0.7, -1.1, 1.9))
}

/// The same surface with vertices and triangles in another order, and other first corners.
pub fn shuffled(mesh: &TriangleMesh, seed: u64) -> TriangleMesh {
    let mut random = Random(seed);
    let names = random.permutation(mesh.vertices.len());
    let mut vertices = mesh.vertices.clone();
    for (old, &new) in names.iter().enumerate() {
        vertices[new] = mesh.vertices[old];
    }
    let order = random.permutation(mesh.triangles.len());
    let triangles = order.iter().enumerate().map(|(place, &old)| {
        let mut triangle = mesh.triangles[old].map(|v| names[v as usize] as u32);
        triangle.rotate_left(place % 3);
        triangle
    });
    TriangleMesh { triangles: triangles.collect(), vertices }
}

/// Numbers by a 64-bit linear congruence (Knuth's constants).
pub struct Random(pub u64);

impl Random {
    pub fn below(&mut self, bound: usize) -> usize {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((self.0 >> 33) as usize) % bound
    }

    pub fn permutation(&mut self, count: usize) -> Vec<usize> {
        let mut places: Vec<usize> = (0..count).collect();
        for last in (1..count).rev() {
            places.swap(last, self.below(last + 1));
        }
        places
    }
}
