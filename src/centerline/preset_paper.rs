//! The preset `paper`: each stage as printed, with the corrections that docs/method.md lists.

use nalgebra::{Point3, Rotation3, Vector3};
use rayon::prelude::*;

use crate::mesh::normals::vertex_normals;
use crate::mesh::preparation::Surface;

use crate::centerline::component::ComponentGraph;
use crate::centerline::connection::Connection;
use crate::centerline::control::{Control, Stage};
use crate::centerline::cut_plane::normal_lines::NormalLines;
use crate::centerline::cut_plane::{CenterlinePoint, OrientedVertices, centerline_points, gradients};
use crate::centerline::median::median;
use crate::centerline::point_grid::PointGrid;
use crate::centerline::preset_default::refuse_blob;
use crate::centerline::recentering::joint_collapse::Joints;
use crate::centerline::recentering::recenter;
use crate::centerline::segmentation::{DistanceField, distance_fields, segment};
use crate::centerline::thinning::linearity::linearities;
use crate::centerline::thinning::point_cloud::PointCloud;
use crate::centerline::thinning::{Thinning, thin};
use crate::centerline::tips::critical_points::{self, Tip, vertex_areas};
use crate::centerline::tips::geodesic::EdgeGraph;
use crate::centerline::tips::picks::Picks;
use crate::centerline::tips::root::Among;
use crate::centerline::tips::skeleton::skeleton;
use crate::centerline::tips::xie_beni::best_count;
use crate::centerline::triangle_grid::TriangleGrid;
use crate::centerline::{ExtractError, Parameters, laplacian_smoothing};

/// Passes of the Laplacian smoothing: enough that a point hears of those half a local radius away, within
/// these bounds.
const PASSES: (f64, f64) = (4.0, 64.0);
/// Radius of the neighbourhood for the linearity, in local radii.
const LINEARITY_REACH: f64 = 2.0;
/// Radius of the "small neighbourhood" of re-centering, in local radii.
const RECENTERING_REACH: f64 = 0.25;
/// The most tips that the clustering starts from: its cost and memory grow with them.
const MOST_CENTRES: usize = 96;

/// The centerline of one component. `diagonal` is `L`, that of the whole input's bounding box.
///
/// # Errors
/// [`ExtractError::NotTubular`] for a blob, [`ExtractError::Cancelled`].
pub fn extract_component(
    surface: &Surface,
    diagonal: f64,
    parameters: &Parameters,
    picks: &Picks,
    control: &Control<'_>,
) -> Result<ComponentGraph, ExtractError> {
    control.report(Stage::Tips, 0.0)?;
    let frame = Frame::of(&surface.mesh.vertices);
    let mut result = extract_in_frame(&frame.seen(surface), diagonal, parameters, picks, control)?;
    let back = |point: &mut Point3<f64>| *point = frame.back(point);
    result.nodes.iter_mut().for_each(|node| back(&mut node.position));
    result.branches.iter_mut().flat_map(|branch| &mut branch.points).for_each(back);
    Ok(result)
}

/// The centerline of a component in its own frame.
fn extract_in_frame(
    surface: &Surface,
    diagonal: f64,
    parameters: &Parameters,
    picks: &Picks,
    control: &Control<'_>,
) -> Result<ComponentGraph, ExtractError> {
    let positions = &surface.mesh.vertices;
    let graph = EdgeGraph::new(positions, &surface.corners);
    let (_, distances) = critical_points::root(&graph, &control.cancel)?;
    let areas = vertex_areas(positions, &surface.mesh.triangles);
    let tips = critical_points::tips(&graph, &distances, &areas, parameters.tip_height());
    let (seeds, fields) = seeds(&graph, &tips, parameters, control)?;
    control.report(Stage::Tips, 0.5)?;
    // The way to the Reeb graph is part of this stage here.
    let (reeb, branching) =
        skeleton(surface, parameters.tip_height(), picks, Among::LongEnds, &control.quiet())?;
    let segments = segment(positions, &graph, &seeds, fields, (parameters.m(), parameters.mu()), control)?;

    let normals = vertex_normals(&surface.mesh);
    let directions = gradients(positions, &graph, &reeb.function, &control.cancel)?;
    let oriented =
        OrientedVertices { positions, normals: &normals, graph: &graph, segment: &segments.segment };
    let planes = centerline_points(oriented, &directions, parameters.d_cut() * diagonal, control)?;
    let refined = refine(&graph, &planes, parameters, control)?;

    let Refined { points, radii, joint } = &refined;
    let connection = Connection {
        grid: &TriangleGrid::new(surface),
        reeb: &reeb,
        chains: &branching.chains,
        excluded: &branching.excluded,
        points,
        radii,
        joint,
    };
    let joints = Joints::new(points, joint, radii, &planes);
    let wall = Wall::new(positions, radii);
    let mut result = connection.connect(
        |at, radius| joints.centre(at, radius),
        |at, radius| wall.distance(at, radius),
        control,
    )?;
    result.warnings.extend(branching.warning());
    refuse_blob(surface, &result)?;
    Ok(result)
}

/// A component's own frame: cells of points lie in it, so that a vessel that lies otherwise falls into the same ones.
struct Frame {
    first: Point3<f64>,
    /// From the first vertex: differences of vertices lose no digits, wherever the vessel lies.
    middle: Vector3<f64>,
    axes: Rotation3<f64>,
}

impl Frame {
    /// From the mean of the vertices to the first (see [`crate::mesh::preparation`]: the outermost), and from that
    /// axis to the vertex farthest from it.
    fn of(positions: &[Point3<f64>]) -> Self {
        let Some(&first) = positions.first() else {
            return Self { first: Point3::origin(), middle: Vector3::zeros(), axes: Rotation3::identity() };
        };
        let sum: Vector3<f64> = positions.iter().map(|point| point - first).sum();
        let middle = sum / positions.len() as f64;
        let along = (-middle).try_normalize(0.0).unwrap_or_else(Vector3::z);
        let across = |point: &Point3<f64>| {
            let offset = (point - first) - middle;
            offset - along * offset.dot(&along)
        };
        let farthest = |best: Vector3<f64>, point: &Point3<f64>| {
            let offset = across(point);
            if offset.norm_squared() > best.norm_squared() { offset } else { best }
        };
        let mut side = positions.iter().fold(Vector3::zeros(), farthest);
        if side.norm_squared() == 0.0 {
            side = Vector3::ith(along.iamin(), 1.0);
        }
        Self { first, middle, axes: Rotation3::face_towards(&along, &side) }
    }

    /// The surface in this frame.
    fn seen(&self, surface: &Surface) -> Surface {
        let mut own = surface.clone();
        for point in &mut own.mesh.vertices {
            *point = Point3::from(self.axes.inverse_transform_vector(&((*point - self.first) - self.middle)));
        }
        own
    }

    /// A point of this frame in the input's.
    fn back(&self, point: &Point3<f64>) -> Point3<f64> {
        self.first + (self.middle + self.axes * point.coords)
    }
}

/// Tips as the clustering's first centres, as many as the validity index wants, with the distances from them (IV.A).
fn seeds(
    graph: &EdgeGraph,
    tips: &[Tip],
    parameters: &Parameters,
    control: &Control<'_>,
) -> Result<(Vec<u32>, Vec<DistanceField>), ExtractError> {
    let mut seeds: Vec<u32> = tips.iter().take(MOST_CENTRES).map(|tip| tip.vertex).collect();
    let mut fields = distance_fields(graph, &seeds, &control.cancel)?;
    let count = best_count(&fields, &seeds, parameters.m(), &control.cancel)?;
    seeds.truncate(count);
    fields.truncate(count);
    Ok((seeds, fields))
}

/// The centerline points as the last stage takes them, one a vertex.
struct Refined {
    points: Vec<Point3<f64>>,
    /// Local radius, in the input's unit.
    radii: Vec<f64>,
    joint: Vec<bool>,
}

/// Laplacian smoothing, linearity, thinning and re-centering of the branches' points (IV.C, IV.D).
fn refine(
    graph: &EdgeGraph,
    planes: &[CenterlinePoint],
    parameters: &Parameters,
    control: &Control<'_>,
) -> Result<Refined, ExtractError> {
    let radii = local_radii(graph, planes);
    let mut points: Vec<Point3<f64>> = planes.iter().map(|plane| plane.position).collect();
    laplacian_smoothing::smooth(&mut points, graph, passes(graph, &radii), control)?;
    let cloud = PointCloud::new(&points, &radii);
    let reach = |i: usize| LINEARITY_REACH * radii[i];
    let joint: Vec<bool> = linearities(&points, &cloud, reach, control)?
        .iter()
        .map(|beta| *beta <= parameters.omega())
        .collect();

    // From here on the branches' points alone.
    let branch: Vec<usize> = (0..points.len()).filter(|&i| !joint[i]).collect();
    let of = |values: &[f64]| -> Vec<f64> { branch.iter().map(|&i| values[i]).collect() };
    let (own, own_radii): (Vec<_>, _) = (branch.iter().map(|&i| points[i]).collect(), of(&radii));
    let thinning = Thinning { h: parameters.h(), eps_h: parameters.eps_h(), delta_h: parameters.delta_h() };
    let cloud = PointCloud::new(&own, &own_radii);
    let thinned = thin(&own, &cloud, &own_radii, thinning, control)?;
    let cloud = PointCloud::new(&thinned, &own_radii);
    let lines: Vec<NormalLines> = branch.iter().map(|&i| planes[i].lines).collect();
    let reach: Vec<f64> = own_radii.iter().map(|radius| RECENTERING_REACH * radius).collect();
    let recentered = recenter(&thinned, &cloud, &lines, &reach, control)?;
    for (&i, point) in branch.iter().zip(&recentered) {
        points[i] = *point;
    }
    Ok(Refined { points, radii, joint })
}

/// The cut planes' radii, each the median over its vertex and the neighbours.
fn local_radii(graph: &EdgeGraph, planes: &[CenterlinePoint]) -> Vec<f64> {
    let one = |v: usize| {
        let around = graph.neighbours(v as u32).iter().map(|&(u, _)| planes[u as usize].radius);
        median(around.chain([planes[v].radius]).collect())
    };
    (0..planes.len()).into_par_iter().map(one).collect()
}

/// How many passes carry a point's influence half a local radius far: each spreads it by half an edge.
fn passes(graph: &EdgeGraph, radii: &[f64]) -> usize {
    let one = |v: usize| {
        let links = graph.neighbours(v as u32);
        let edge =
            links.iter().map(|&(_, length)| f64::from(length)).sum::<f64>() / links.len().max(1) as f64;
        if edge > 0.0 { radii[v] / edge } else { 0.0 }
    };
    let ratio = median((0..radii.len()).map(one).collect());
    (0.25 * ratio * ratio).clamp(PASSES.0, PASSES.1) as usize
}

/// The vertices of the wall, for the radius of the largest sphere inside.
struct Wall {
    grid: PointGrid,
}

impl Wall {
    /// The sphere touches the wall somewhere: the mean over so many nearest vertices, for noise's sake.
    const TOUCHED: usize = 6;

    fn new(positions: &[Point3<f64>], radii: &[f64]) -> Self {
        Self { grid: PointGrid::new(positions.to_vec(), median(radii.to_vec())) }
    }

    /// Distance from `point` to the nearest wall, about `expected`.
    fn distance(&self, point: &Point3<f64>, expected: f64) -> f64 {
        let mut reach = 1.2 * expected;
        for _ in 0..8 {
            let mut found = Vec::new();
            self.grid.for_each_within(point, reach, |_, distance| found.push(distance));
            if found.len() >= Self::TOUCHED {
                found.sort_by(f64::total_cmp);
                return found[..Self::TOUCHED].iter().sum::<f64>() / Self::TOUCHED as f64;
            }
            reach *= 1.5;
        }
        expected
    }
}

#[cfg(test)]
mod tests {
    use std::time::{Duration, Instant};

    use super::*;
    use crate::centerline::shapes::torus;
    use crate::centerline::test_surfaces::{capsule, voxels};
    use crate::centerline::{CancelToken, Centerline, Preset, Progress, extract};
    use crate::mesh::TriangleMesh;

    fn line_of(mesh: &TriangleMesh) -> Centerline {
        extract(mesh, &Parameters::of(Preset::Paper), &Control::silent()).unwrap().centerline
    }

    /// A trunk along z with one branch along x and a shorter one along -y, of voxels.
    fn tree() -> TriangleMesh {
        let near = |p: Vector3<f64>, a: Vector3<f64>, b: Vector3<f64>| {
            let along = ((p - a).dot(&(b - a)) / (b - a).norm_squared()).clamp(0.0, 1.0);
            (p - a - (b - a) * along).norm() < 3.2
        };
        voxels([-5, -26, -5], [34, 5, 60], |p| {
            near(p, Vector3::zeros(), Vector3::new(0.0, 0.0, 55.0))
                || near(p, Vector3::new(0.0, 0.0, 18.0), Vector3::new(30.0, 0.0, 24.0))
                || near(p, Vector3::new(0.0, 0.0, 38.0), Vector3::new(0.0, -22.0, 44.0))
        })
    }

    #[test]
    fn a_tube_has_one_line_on_its_axis_from_cap_to_cap() {
        let line = line_of(&capsule(1.5, 24.0, 24));
        assert_eq!((line.nodes.len(), line.branches.len()), (2, 1));
        let branch = &line.branches[0];
        assert!((branch.length() - 27.0).abs() < 0.3, "length {}", branch.length());
        for (point, radius) in branch.points.iter().zip(&branch.radii) {
            assert!(point.x.hypot(point.y) < 0.02 * 1.5, "{point}");
            assert!((radius / 1.5 - 1.0).abs() < 0.05, "{radius} at {point}");
        }
    }

    #[test]
    fn a_ring_is_one_loop_on_its_circle() {
        let line = line_of(&torus(10.0, 1.5, 160, 24));
        assert_eq!((line.nodes.len(), line.branches.len()), (1, 1));
        assert_eq!(line.branches[0].from, line.branches[0].to);
        for point in &line.branches[0].points {
            let off = (point.x.hypot(point.y) - 10.0).hypot(point.z);
            assert!(off < 0.1 * 1.5, "{off} at {point}");
        }
    }

    #[test]
    fn a_tree_of_stairs_has_its_ends_and_junctions_and_no_more() {
        let line = line_of(&tree());
        let degrees: Vec<usize> = (0..line.nodes.len()).map(|node| line.degree(node)).collect();
        assert_eq!(degrees.iter().filter(|&&degree| degree == 1).count(), 4, "{degrees:?}");
        assert_eq!(line.branches.len(), line.nodes.len() - 1, "a tree has no loop");
        for joint in [Vector3::new(0.0, 0.0, 18.0), Vector3::new(0.0, 0.0, 38.0)] {
            let near = |node: usize| (line.nodes[node].position.coords - joint).norm() < 4.0;
            assert!(
                (0..degrees.len()).any(|node| degrees[node] == 3 && near(node)),
                "no junction at {joint}"
            );
        }
    }

    #[test]
    fn the_unit_and_the_place_do_not_matter() {
        let millimetres = line_of(&tree());
        // A power of two keeps every digit; a shift loses some, and flat steps of stairs then fall on
        // either side of a band's border.
        for (scale, shift, tolerance) in [(1024.0, 0.0, 1e-9), (1.0, 512.0, 0.1)] {
            let mut mesh = tree();
            let shift = Vector3::repeat(shift);
            mesh.vertices.iter_mut().for_each(|point| *point = (*point + shift) / scale);
            let other = line_of(&mesh);
            assert_eq!(millimetres.nodes.len(), other.nodes.len());
            for (a, b) in millimetres.nodes.iter().zip(&other.nodes) {
                let moved = (b.position * scale - shift - a.position).norm();
                assert!(moved < tolerance, "{moved} at {}, scale {scale}", a.position);
            }
        }
    }

    #[test]
    fn any_number_of_threads_gives_the_same_line() {
        let mesh = tree();
        let with = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| line_of(&mesh))
        };
        assert_eq!(with(1), with(3));
    }

    #[test]
    fn it_obeys_a_cancellation_in_every_stage() {
        let mesh = torus(10.0, 1.5, 240, 36);
        for stage in Stage::ALL {
            let cancel = CancelToken::new();
            let asked = std::sync::Mutex::new(None);
            let progress = |progress: Progress| {
                if progress.stage == stage {
                    cancel.cancel();
                    asked.lock().unwrap().get_or_insert_with(Instant::now);
                }
            };
            let control = Control::new(cancel.clone(), &progress);
            let result = extract(&mesh, &Parameters::of(Preset::Paper), &control);
            if let Some(asked) = *asked.lock().unwrap() {
                assert_eq!(result, Err(ExtractError::Cancelled), "{stage:?}");
                // The limit is 100 ms on an optimised build; tests run without and beside each other.
                assert!(
                    asked.elapsed() < Duration::from_millis(1000),
                    "{stage:?} took {:?}",
                    asked.elapsed()
                );
            } else {
                assert_eq!(stage, Stage::SmoothingFilter, "the stage was never reported");
            }
        }
    }
}
