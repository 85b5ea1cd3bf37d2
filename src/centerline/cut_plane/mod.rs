//! The optimal cut plane of every vertex and its centerline point (IV.B, eqs. 4 and 8-10).

pub mod bulges;
pub mod cross_sections;
pub mod dome;
pub mod dome_wall;
pub mod march;
pub mod normal_lines;
pub mod ownership;
pub mod section;
pub mod stubs;
pub mod wall_fit;
pub mod wall_shape;

use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

use crate::centerline::control::{Control, Stage};
use crate::centerline::cut_plane::normal_lines::NormalLines;
use crate::centerline::thinning::covariance::Moments;
use crate::centerline::tips::geodesic::EdgeGraph;
use crate::centerline::{CancelToken, ExtractError};

/// The iteration of eq. 4 stops when the normal turns by less than this sine (half a degree) ...
const SETTLED: f64 = 0.0087;
/// ... or after this many steps.
const MOST_STEPS: usize = 16;
/// Steps with the narrowest band, after which the local radius is known well enough to widen it.
const NARROW_STEPS: usize = 4;
/// Bounds of the band's half width: this share of the local radius, so many local edge lengths.
const WIDEST_IN_RADII: f64 = 0.5;
const WIDEST_IN_EDGES: f64 = 3.0;
/// A vertex farther from the plane's own vertex than this many local radii is not of the same section.
const REACH_IN_RADII: f64 = 3.5;
/// The most vertices that one band may take in.
const MOST_IN_BAND: usize = 16_384;

/// An oriented surface and its segments: what the planes are cut from.
#[derive(Debug, Clone, Copy)]
pub struct OrientedVertices<'a> {
    /// Length n, in the input's unit.
    pub positions: &'a [Point3<f64>],
    /// Length n, unit vectors out of the lumen.
    pub normals: &'a [Vector3<f64>],
    pub graph: &'a EdgeGraph,
    /// Length n: the segment of each vertex.
    pub segment: &'a [u32],
}

/// A centerline point with its plane: the paper's `c = (x_cp, v_cp)`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CenterlinePoint {
    /// `x_cp` (eq. 10), in the input's unit.
    pub position: Point3<f64>,
    /// `v_cp` (eqs. 4, 8, 9), a unit vector; its sign has no meaning.
    pub normal: Vector3<f64>,
    /// Mean distance of the plane's vertices from the line through `position` along `normal`.
    pub radius: f64,
    /// The normal lines of the plane's vertices, for re-centering.
    pub lines: NormalLines,
}

/// The optimal cut plane and centerline point of every vertex.
///
/// `directions[i]` starts the iteration at vertex `i` once its part along the normal is taken off, as
/// `v_cp . v_i = 0` asks; where nothing is left, any perpendicular will do. `d_cut` is the largest half width
/// of a band, in the input's unit. `O(n)` times the vertices of a band. Parallel over vertices.
///
/// # Errors
/// [`ExtractError::Cancelled`].
pub fn centerline_points(
    surface: OrientedVertices<'_>,
    directions: &[Vector3<f64>],
    d_cut: f64,
    control: &Control<'_>,
) -> Result<Vec<CenterlinePoint>, ExtractError> {
    const BLOCK: usize = 4096;
    let edges = local_edges(surface.graph);
    let count = surface.positions.len();
    let mut points = Vec::with_capacity(count);
    for block in (0..count).step_by(BLOCK) {
        control.report(Stage::CutPlanes, block as f64 / count as f64)?;
        let one = |walker: &mut Walker<'_>, i: usize| {
            control.cancel.check()?;
            Ok(walker.settle(i as u32, directions[i], edges[i], d_cut))
        };
        let range = block..(block + BLOCK).min(count);
        let found: Result<Vec<_>, ExtractError> =
            range.into_par_iter().with_min_len(64).map_init(|| Walker::new(surface), one).collect();
        points.extend(found?);
    }
    control.report(Stage::CutPlanes, 1.0)?;
    Ok(points)
}

/// The direction in which a function on the surface grows, per vertex, by least squares over its edges.
pub fn gradients(
    positions: &[Point3<f64>],
    graph: &EdgeGraph,
    function: &[f64],
    cancel: &CancelToken,
) -> Result<Vec<Vector3<f64>>, ExtractError> {
    cancel.check()?;
    let one = |i: usize| {
        let links = graph.neighbours(i as u32).iter();
        let pull = |&(j, length): &(u32, f32)| {
            let slope =
                (function[j as usize] - function[i]) / f64::from(length * length).max(f64::MIN_POSITIVE);
            (positions[j as usize] - positions[i]) * slope
        };
        links.map(pull).sum()
    };
    Ok((0..positions.len()).into_par_iter().map(one).collect())
}

/// Eq. 9: the direction that the normals vary least along, the eigenvector of the least eigenvalue of their
/// covariance matrix. (The printed factor 2 off the diagonal counts the symmetric entries twice.)
pub fn plane_normal(normals: impl IntoIterator<Item = Vector3<f64>>) -> Vector3<f64> {
    Moments::of(normals).principal_axes().least()
}

/// Mean edge length around each vertex, over its neighbours' means too.
fn local_edges(graph: &EdgeGraph) -> Vec<f64> {
    let mean = |v: u32| {
        let links = graph.neighbours(v);
        links.iter().map(|&(_, length)| f64::from(length)).sum::<f64>() / links.len().max(1) as f64
    };
    let around = |v: u32| {
        let links = graph.neighbours(v);
        links.iter().map(|&(u, _)| mean(u)).sum::<f64>() / links.len().max(1) as f64
    };
    (0..graph.vertices() as u32).into_par_iter().map(around).collect()
}

/// Walks the mesh from a vertex around the vessel, within a band of a plane. One a thread.
struct Walker<'a> {
    surface: OrientedVertices<'a>,
    /// Round in which each vertex was last seen.
    seen: Vec<u32>,
    round: u32,
    /// The vertices of the last band, the first being the plane's own.
    band: Vec<u32>,
}

/// Half width of a band and how far from its vertex it may go.
#[derive(Clone, Copy)]
struct Reach {
    width: f64,
    radius: f64,
}

impl<'a> Walker<'a> {
    fn new(surface: OrientedVertices<'a>) -> Self {
        Self { surface, seen: vec![0; surface.positions.len()], round: 0, band: Vec::new() }
    }

    /// The iteration of eq. 4 at one vertex, first with the narrowest band that closes around the vessel,
    /// then with the widest that the local radius, the local edge length and `d_cut` allow.
    fn settle(&mut self, vertex: u32, direction: Vector3<f64>, edge: f64, d_cut: f64) -> CenterlinePoint {
        let mut normal = start_normal(direction, self.surface.normals[vertex as usize]);
        let mut reach = Reach { width: edge, radius: f64::INFINITY };
        let mut point = None;
        for step in 0..MOST_STEPS {
            self.walk(vertex, normal, reach);
            let next = plane_normal(self.band.iter().map(|&v| self.surface.normals[v as usize]));
            let still = next.cross(&normal).norm() < SETTLED;
            normal = next;
            if step + 1 == NARROW_STEPS || (still && point.is_none()) {
                self.walk(vertex, normal, reach);
                let found = self.point(normal);
                let widest = (WIDEST_IN_RADII * found.radius).min(WIDEST_IN_EDGES * edge).min(d_cut);
                reach = Reach { width: widest.max(edge), radius: REACH_IN_RADII * found.radius.max(edge) };
                point = Some(found);
            } else if still {
                break;
            }
        }
        self.walk(vertex, normal, reach);
        self.point(normal)
    }

    /// Fills `band` with the vertices of the same segment that a walk within the band reaches.
    fn walk(&mut self, vertex: u32, normal: Vector3<f64>, reach: Reach) {
        self.round += 1;
        let OrientedVertices { positions, graph, segment, .. } = self.surface;
        let (origin, own) = (positions[vertex as usize], segment[vertex as usize]);
        self.seen[vertex as usize] = self.round;
        self.band.clear();
        self.band.push(vertex);
        let mut next = 0;
        while next < self.band.len() && self.band.len() < MOST_IN_BAND {
            for &(u, _) in graph.neighbours(self.band[next]) {
                let offset = positions[u as usize] - origin;
                let inside = offset.dot(&normal).abs() <= reach.width && offset.norm() <= reach.radius;
                if inside && segment[u as usize] == own && self.seen[u as usize] != self.round {
                    self.seen[u as usize] = self.round;
                    self.band.push(u);
                }
            }
            next += 1;
        }
    }

    /// Eq. 10 over the band.
    fn point(&self, normal: Vector3<f64>) -> CenterlinePoint {
        let OrientedVertices { positions, normals, .. } = self.surface;
        let own = positions[self.band[0] as usize];
        let mut lines = NormalLines::default();
        for &v in &self.band {
            lines.add(positions[v as usize], normals[v as usize]);
        }
        let farthest = self.band.iter().map(|&v| (positions[v as usize] - own).norm()).fold(0.0, f64::max);
        // The lines of a nearly flat patch may meet far off: no vessel is wider than its own section.
        let position = match lines.nearest_point() {
            Some(found) if (found - own).norm() <= farthest => found,
            _ => self.mean(),
        };
        let away = |&v: &u32| (positions[v as usize] - position).cross(&normal).norm();
        let radius = self.band.iter().map(away).sum::<f64>() / self.band.len() as f64;
        CenterlinePoint { position, normal, radius, lines }
    }

    fn mean(&self) -> Point3<f64> {
        let sum: Vector3<f64> = self.band.iter().map(|&v| self.surface.positions[v as usize].coords).sum();
        Point3::from(sum / self.band.len() as f64)
    }
}

/// `v_cp^0`: perpendicular to the vertex normal, as near to `direction` as that allows.
fn start_normal(direction: Vector3<f64>, vertex_normal: Vector3<f64>) -> Vector3<f64> {
    let across = direction - vertex_normal * vertex_normal.dot(&direction);
    let least = vertex_normal.iamin();
    across.try_normalize(1e-9 * direction.norm()).unwrap_or_else(|| {
        let mut axis = Vector3::zeros();
        axis[least] = 1.0;
        vertex_normal.cross(&axis).normalize()
    })
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;
    use crate::centerline::shapes::torus;
    use crate::centerline::test_surfaces::{capsule, closed_surface};
    use crate::centerline::tips::geodesic::geodesic;
    use crate::mesh::preparation::Surface;

    fn points_of(
        surface: &Surface,
        normals: &[Vector3<f64>],
        directions: &[Vector3<f64>],
        d_cut: f64,
    ) -> Vec<CenterlinePoint> {
        let graph = EdgeGraph::new(&surface.mesh.vertices, &surface.corners);
        let segment = vec![0; normals.len()];
        let vertices =
            OrientedVertices { positions: &surface.mesh.vertices, normals, graph: &graph, segment: &segment };
        centerline_points(vertices, directions, d_cut, &Control::silent()).unwrap()
    }

    fn ring_centre(position: &Point3<f64>, ring: f64) -> Vector3<f64> {
        Vector3::new(position.x, position.y, 0.0).normalize() * ring
    }

    #[test]
    fn the_normals_of_one_section_give_its_axis_and_its_centre() {
        // The section of a cone at one height: its normals lean along the axis, all by the same angle.
        let axis = Vector3::new(1.0, 2.0, -2.0) / 3.0;
        let (u, w) = (Vector3::new(2.0, 1.0, 2.0) / 3.0, Vector3::new(2.0, -2.0, -1.0) / 3.0);
        for lean in [0.0, 0.3] {
            let radial = |k: i32| {
                let angle = TAU * f64::from(k) / 30.0;
                u * angle.cos() + w * angle.sin()
            };
            let normal = |k: i32| (radial(k) + axis * lean).normalize();
            let found = plane_normal((0..30).map(normal));
            assert!(found.cross(&axis).norm() < 1e-9, "{found}");
            let mut lines = NormalLines::default();
            let centre = Point3::new(5.0, 6.0, 7.0);
            (0..30).for_each(|k| lines.add(centre + radial(k) * 2.0, normal(k)));
            let off = (lines.nearest_point().unwrap() - centre).cross(&axis).norm();
            assert!(off < 1e-9, "{off}");
        }
    }

    #[test]
    fn points_of_a_cylinder_lie_on_its_axis() {
        let surface = closed_surface(&capsule(2.0, 30.0, 32));
        let positions = &surface.mesh.vertices;
        let normals: Vec<_> =
            positions.iter().map(|p| (p - Point3::new(0.0, 0.0, p.z.clamp(0.0, 30.0))).normalize()).collect();
        let skewed = vec![Vector3::new(0.6, -0.2, 1.0); normals.len()];
        let points = points_of(&surface, &normals, &skewed, 1.0);
        let mut checked = 0;
        for (point, position) in points.iter().zip(positions) {
            if (8.0..22.0).contains(&position.z) {
                assert!(point.normal.z.abs() > 1.0 - 1e-9);
                assert!(point.position.x.hypot(point.position.y) < 1e-9, "{}", point.position);
                assert!((point.position.z - position.z).abs() < 0.5);
                assert!((point.radius - 2.0).abs() < 1e-9);
                checked += 1;
            }
        }
        assert!(checked > 500);
        // On the half spheres they stay inside.
        assert!(points.iter().all(|point| point.position.x.hypot(point.position.y) < 1.0));
    }

    #[test]
    fn points_of_a_ring_lie_on_its_circle_and_the_far_side_stays_out() {
        let surface = closed_surface(&torus(4.0, 1.0, 150, 40));
        let positions = &surface.mesh.vertices;
        let graph = EdgeGraph::new(positions, &surface.corners);
        let cancel = CancelToken::new();
        let distances = geodesic(&graph, &[0], &cancel).unwrap().distance;
        let directions = gradients(positions, &graph, &distances, &cancel).unwrap();
        let normals: Vec<_> =
            positions.iter().map(|p| (p.coords - ring_centre(p, 4.0)).normalize()).collect();
        let points = points_of(&surface, &normals, &directions, 0.3);
        let off: Vec<f64> = points
            .iter()
            .zip(positions)
            .map(|(point, own)| (point.position.coords - ring_centre(own, 4.0)).norm())
            .collect();
        let far = off.iter().filter(|&&off| off > 0.25).count();
        assert!(far * 20 < off.len(), "{far} of {} points are off", off.len());
        assert!(off.iter().sum::<f64>() / (off.len() as f64) < 0.1);
    }

    #[test]
    fn the_start_is_perpendicular_even_along_the_normal() {
        for normal in [Vector3::x(), Vector3::new(1.0, 1.0, 1.0).normalize()] {
            for direction in [normal, Vector3::zeros(), Vector3::new(0.3, -2.0, 0.1)] {
                let start = start_normal(direction, normal);
                assert!((start.norm() - 1.0).abs() < 1e-12 && start.dot(&normal).abs() < 1e-9);
            }
        }
    }
}
