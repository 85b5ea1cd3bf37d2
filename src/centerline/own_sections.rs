//! The line's own sections: where the surface, cut perpendicular to the line, shows one vessel alone.
//!
//! At inner points of the branches, half a local radius apart or more where nobody asks for others, the surface is cut.
//! A section is the line's own when it is closed around the point and one vessel's alone:
//!
//! - it is as convex as a vessel's: it fills 0.85 of what its own tangents enclose;
//! - no other branch's inscribed sphere reaches into it, and the same branch does not pass through it twice;
//! - no end lies within one radius of the point: caps are cut aslant.
//!
//! Found on the result and the prepared surface alone, whichever preset made the line.

use nalgebra::{Matrix2, Point2, Point3, Rotation2, Unit, Vector2, Vector3};
use rayon::prelude::*;

use crate::mesh::preparation::Surface;

use crate::centerline::component::ComponentGraph;
use crate::centerline::cut_plane::section::{Frame, Section, any_perpendicular, section, walk_to_plane};
use crate::centerline::equivalent_radius::wall_radius;
use crate::centerline::graph::Branch;
use crate::centerline::line_tree::{LineTree, Segment};
use crate::centerline::median::place_at_share;
use crate::centerline::triangle_grid::TriangleGrid;

/// Fewest sides in a quarter of a section that show a wall; nothing tells of where that is but a few sides, as in a vessel of
/// three edges across.
const SIDES: usize = 4;
/// Sine of a turn that is none: single precision turns the two sides of a face by up to 1e-4, a polygon of 200 corners by 0.03.
const STRAIGHT: f64 = 1e-3;

/// A section that is one branch's own.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OwnSection {
    pub branch: usize,
    /// Number of the point in the branch.
    pub place: usize,
    /// The section's centroid.
    pub middle: Point3<f64>,
    /// Distance of the point from there, in the input's unit.
    pub offset: f64,
    /// Radius of the circle that has the area of the section's polygon.
    pub radius: f64,
    /// The same of the wall, on which the vertices lie.
    pub wall_radius: f64,
    /// Distance of the nearest quarter of the polygon's faces around the point. Infinite where they are so many that they
    /// show the wall.
    pub facets: f64,
    /// The same of the wall: by as much more as its radius is than the polygon's. Infinite where the mesh is too coarse to
    /// tell.
    pub near: f64,
    /// Short half axis of the ellipse that has the wall's area and the section's second moments: the largest circle in an ellipse.
    /// Where the mesh is too coarse, how far the nearest quarter of its vertices there lies from the centroid.
    pub inscribed: f64,
}

/// The own sections of some branches of a component's line, in their order. O(sections x triangles crossed).
pub fn own_sections(
    grid: &TriangleGrid<'_>,
    line: &LineTree,
    graph: &ComponentGraph,
    branches: impl Iterator<Item = usize>,
) -> Vec<OwnSection> {
    let of_branch = |number: usize| {
        let branch = &graph.branches[number];
        let plane = move |place| Some(Plane { branch: number, place, tangent: tangent(branch, place)? });
        places(branch).into_iter().filter_map(plane)
    };
    own_sections_in(grid, line, graph, &branches.flat_map(of_branch).collect::<Vec<Plane>>())
}

/// A plane through a point of the line.
#[derive(Debug, Clone, Copy)]
pub struct Plane {
    pub branch: usize,
    /// Number of the point in the branch.
    pub place: usize,
    /// Its normal.
    pub tangent: Unit<Vector3<f64>>,
}

/// The own sections of a component's line in some planes, in their order. O(planes x triangles crossed).
pub fn own_sections_in(
    grid: &TriangleGrid<'_>,
    line: &LineTree,
    graph: &ComponentGraph,
    planes: &[Plane],
) -> Vec<OwnSection> {
    let surface = grid.surface();
    let mut degree = vec![0; graph.nodes.len()];
    for branch in &graph.branches {
        degree[branch.from] += 1;
        degree[branch.to] += 1;
    }
    let one = |&Plane { branch: number, place, tangent }: &Plane| {
        let branch = &graph.branches[number];
        let (cut, centroid, radius) = section_around(grid, &branch.points[place], tangent)?;
        let ends = [branch.from, branch.to].into_iter().filter(|&node| degree[node] == 1);
        let away = |node: usize| (graph.nodes[node].position - branch.points[place]).norm();
        let clear = ends.into_iter().all(|node| away(node) > radius);
        let own = clear && is_convex(&cut) && !is_shared(&cut, line, (number, place));
        own.then(|| {
            let wall_radius = wall_radius(surface, &cut, &centroid, radius);
            let (middle, sides) = nearest_quarter(cut.sides().map(|(p, q, _)| [p.coords, q.coords]));
            let shows_wall = sides >= SIDES;
            let near = if shows_wall { middle * (wall_radius / radius).max(1.0) } else { f64::INFINITY };
            let inscribed = if shows_wall {
                wall_radius * narrowness(&cut, &centroid)
            } else {
                nearest_vertices(surface, &cut, &centroid)
            };
            let faces = faces(&cut);
            let as_sides = faces.len() == cut.points.len();
            let (facets, count) = if as_sides { (middle, sides) } else { nearest_quarter(faces.into_iter()) };
            let facets = if count < SIDES { facets } else { f64::INFINITY };
            OwnSection {
                branch: number,
                place,
                middle: cut.frame.lift(&centroid),
                offset: centroid.coords.norm(),
                radius,
                wall_radius,
                facets,
                inscribed,
                near,
            }
        })
    };
    planes.par_iter().filter_map(one).collect()
}

/// The inner points of a branch that are looked at.
fn places(branch: &Branch) -> Vec<usize> {
    /// Least way from one to the next, in local radii.
    const STEP: f64 = 0.5;
    let mut way = 0.0;
    let mut found = Vec::new();
    for place in 1..branch.points.len().saturating_sub(1) {
        way += (branch.points[place] - branch.points[place - 1]).norm();
        if found.is_empty() || way >= STEP * branch.radii[place] {
            way = 0.0;
            found.push(place);
        }
    }
    found
}

/// Direction of a branch at an inner point; `None` where it turns back.
pub fn tangent(branch: &Branch, place: usize) -> Option<Unit<Vector3<f64>>> {
    let [before, point, after] = [place - 1, place, place + 1].map(|i| branch.points[i]);
    let directions = [point - before, after - point].map(|step| step.try_normalize(0.0));
    Unit::try_new(directions[0]? + directions[1]?, 1e-6)
}

/// The closed section around a point perpendicular to a direction, with its centroid and the radius of the circle of its area;
/// the point is the origin of its plane.
pub fn section_around(
    grid: &TriangleGrid<'_>,
    point: &Point3<f64>,
    tangent: Unit<Vector3<f64>>,
) -> Option<(Section, Point2<f64>, f64)> {
    let surface = grid.surface();
    let across = any_perpendicular(*tangent);
    let frame = Frame::new(*point, tangent, across);
    // Another try where the first ray ends at a wall that does not go around.
    [frame.u, frame.v, -frame.u, -frame.v].iter().find_map(|direction: &Vector3<f64>| {
        // A plane through vertices may only touch the triangle that the ray meets; it crosses the next.
        let seed = walk_to_plane(surface, &frame, grid.wall_ahead(point, direction)?)?;
        let cut = section(surface, frame, seed)?;
        let measure = cut.measure();
        let around = measure.area > 0.0 && cut.encloses(&Point2::origin());
        around.then(|| (cut, measure.centroid, measure.radius()))
    })
}

/// How far the sides of a section that are nearest to the origin lie from there, by their middles, on a quarter of all the way
/// around it, and how many sides that are.
fn nearest_quarter(sides: impl Iterator<Item = [Vector2<f64>; 2]>) -> (f64, usize) {
    // Of each side the distance of its middle, and the angle that it is seen under.
    let seen = |[p, q]: [Vector2<f64>; 2]| (0.5 * (p + q).norm(), p.perp(&q).atan2(p.dot(&q)).abs());
    let mut sides: Vec<(f64, f64)> = sides.map(seen).collect();
    sides.sort_by(|a, b| a.0.total_cmp(&b.0));
    let reached = place_at_share(sides.iter().map(|side| side.1), 0.25);
    reached.map_or((f64::INFINITY, 0), |last| (sides[last].0, last + 1))
}

/// Short half axis of the ellipse with a section's second moments, over the radius of the circle of its area.
fn narrowness(cut: &Section, centroid: &Point2<f64>) -> f64 {
    let mut moments = Matrix2::zeros();
    for (p, q, _) in cut.sides() {
        let (a, b) = (p - centroid, q - centroid);
        moments += (a * a.transpose() + b * b.transpose() + (a + b) * (a + b).transpose()) * a.perp(&b);
    }
    let axes = moments.symmetric_eigenvalues();
    let [least, most] = [axes.min(), axes.max()];
    if most > 0.0 { (least / most).clamp(0.0, 1.0).sqrt().sqrt() } else { 1.0 }
}

/// Distance from a section's centroid, across its plane, of the nearest quarter of the vertices whose triangles it crosses.
fn nearest_vertices(surface: &Surface, cut: &Section, centroid: &Point2<f64>) -> f64 {
    let distance = |&v: &u32| (cut.frame.flat(&surface.mesh.vertices[v as usize]) - centroid).norm();
    let mut all: Vec<f64> = cut.vertices(surface).iter().map(distance).collect();
    let quarter = all.len() / 4;
    *all.select_nth_unstable_by(quarter, f64::total_cmp).1
}

/// A section's sides; those that go straight on are one, as the two triangles of a flat face show them.
fn faces(cut: &Section) -> Vec<[Vector2<f64>; 2]> {
    let sides: Vec<[Vector2<f64>; 2]> = cut.sides().map(|(p, q, _)| [p.coords, q.coords]).collect();
    let straight =
        |a: &[Vector2<f64>; 2], b: &[Vector2<f64>; 2]| turn(&(a[1] - a[0]), &(b[1] - b[0])).abs() < STRAIGHT;
    let count = sides.len();
    let first = (0..count).find(|&i| !straight(&sides[(i + count - 1) % count], &sides[i])).unwrap_or(0);
    let mut faces: Vec<[Vector2<f64>; 2]> = Vec::with_capacity(count);
    for side in sides[first..].iter().chain(&sides[..first]) {
        match faces.last_mut() {
            Some(last) if straight(last, side) => last[1] = side[1],
            _ => faces.push(*side),
        }
    }
    faces
}

/// Sine of the angle between two sides; of one without length 0.
fn turn(a: &Vector2<f64>, b: &Vector2<f64>) -> f64 {
    a.perp(b) / (a.norm() * b.norm()).max(f64::MIN_POSITIVE)
}

/// Whether a section fills most of what its tangents in a few directions enclose, or has no dent at all: a triangle's corners
/// lie far from those tangents.
fn is_convex(cut: &Section) -> bool {
    const DIRECTIONS: usize = 16;
    const FILLED: f64 = 0.85;
    let turn = std::f64::consts::TAU / DIRECTIONS as f64;
    let step = Rotation2::new(turn);
    let mut direction = step.inverse() * Vector2::x();
    let support: [f64; DIRECTIONS] = std::array::from_fn(|_| {
        direction = step * direction;
        cut.points.iter().map(|point| point.coords.dot(&direction)).fold(f64::NEG_INFINITY, f64::max)
    });
    // Length of each tangent between its neighbours.
    let side = |k: usize| {
        let around = support[(k + 1) % DIRECTIONS] + support[(k + DIRECTIONS - 1) % DIRECTIONS];
        (around - 2.0 * support[k] * turn.cos()) / turn.sin()
    };
    let enclosed: f64 = (0..DIRECTIONS).map(|k| 0.5 * support[k] * side(k)).sum();
    cut.measure().area > FILLED * enclosed || has_no_dent(cut)
}

fn has_no_dent(cut: &Section) -> bool {
    let ways: Vec<Vector2<f64>> = cut.sides().map(|(p, q, _)| q - p).collect();
    let turns = ways.iter().zip(ways.iter().cycle().skip(1)).map(|(a, b)| turn(a, b));
    let [least, most] = turns.fold([0.0_f64; 2], |[least, most], turn| [least.min(turn), most.max(turn)]);
    least > -STRAIGHT || most < STRAIGHT
}

/// Whether the section around a point is another stretch's as well.
fn is_shared(cut: &Section, line: &LineTree, (branch, place): (usize, usize)) -> bool {
    let frame = &cut.frame;
    let reach = cut.points.iter().map(|point| point.coords.norm()).fold(0.0, f64::max);
    line.any_near(&frame.origin, reach, 1.0, |_, segment| {
        if segment.branch == branch {
            let beside = segment.place + 1 == place || segment.place == place;
            return !beside && passes(segment, cut);
        }
        let (point, radius) = segment.nearest(&frame.origin);
        let depth = (point - frame.origin).dot(&frame.t).abs();
        (depth < radius && cut.encloses(&frame.flat(&point))) || passes(segment, cut)
    })
}

/// Whether a segment passes through the section.
fn passes(segment: &Segment, cut: &Section) -> bool {
    let [a, b] = segment.ends.map(|end| (end - cut.frame.origin).dot(&cut.frame.t));
    if (a < 0.0) == (b < 0.0) {
        return false;
    }
    let [p, q] = segment.ends;
    cut.encloses(&cut.frame.flat(&(p + (q - p) * (a / (a - b)))))
}
