//! Ends that were cut aslant: the line stays on the axis and reaches the middle of the cut.

use nalgebra::{Point3, Vector3};
use rosaline::centerline::{Control, Extraction, Parameters, extract};
use rosaline::mesh::TriangleMesh;
use rosaline::mesh::preparation::{Opening, prepare};

use crate::lines::{ends_and_junctions, line_of, points};
use crate::surfaces::{Ends, Random, implicit, sweep};

const LENGTH: f64 = 30.0;

/// A tube of radius 2 along z, its ends turned by `degrees` toward each other.
fn cut(degrees: f64, radius: impl Fn(f64) -> f64, ends: Ends) -> TriangleMesh {
    let axis = |share: f64| Point3::new(0.0, 0.0, LENGTH * share);
    let section = |share: f64, angle: f64| [radius(share) * angle.cos(), radius(share) * angle.sin()];
    let mut mesh = sweep(axis, section, [61, 32], ends);
    let slope = degrees.to_radians().tan();
    for vertex in &mut mesh.vertices {
        vertex.z += slope * vertex.x * (2.0 * vertex.z / LENGTH - 1.0);
    }
    mesh
}

/// `most`: distance of a point from the axis, relative error of a radius, distance of an end from the middle of its cut.
fn check(found: &Extraction, radius: impl Fn(f64) -> f64, most: [f64; 3], what: &str) {
    assert_eq!(ends_and_junctions(&found.centerline), (2, 0), "{what}");
    let aside = |point: &Point3<f64>| point.x.hypot(point.y);
    let off = points(&found.centerline).map(|(point, _)| aside(point)).fold(0.0, f64::max);
    assert!(off < most[0], "{what}: {off} off the axis");
    for end in [0.0, LENGTH] {
        let away = |node: &Point3<f64>| (node - Point3::new(0.0, 0.0, end)).norm();
        let missed = found.centerline.nodes.iter().map(|node| away(&node.position)).fold(f64::MAX, f64::min);
        assert!(missed < most[2], "{what}: the cut at {end} is missed by {missed}");
    }
    let error = |(point, found): (&Point3<f64>, f64)| (found / radius(point.z / LENGTH) - 1.0).abs();
    let error = points(&found.centerline).map(error).fold(0.0, f64::max);
    assert!(error < most[1], "{what}: a radius is {error} off");
}

fn openings(mesh: &TriangleMesh) -> Vec<Opening> {
    prepare(mesh).unwrap().components.remove(0).openings
}

#[test]
fn a_cut_aslant_is_reached_in_its_middle() {
    for ends in [Ends::Open, Ends::Flat] {
        for degrees in [0.0, 20.0, 30.0, 45.0, 60.0] {
            check(
                &line_of(&cut(degrees, |_| 2.0, ends)),
                |_| 2.0,
                [0.05, 0.02, 0.15],
                &format!("{ends:?}, {degrees} degrees"),
            );
        }
    }
}

#[test]
fn past_a_steep_cut_no_wall_is_without_line() {
    for degrees in [60.0, 70.0] {
        let found = line_of(&cut(degrees, |_| 2.0, Ends::Open));
        assert!(found.warnings.is_empty(), "{degrees} degrees: {:?}", found.warnings);
    }
}

#[test]
fn a_vessel_that_narrows_may_be_cut_aslant_too() {
    let radius = |share: f64| 2.5 - share;
    for ends in [Ends::Open, Ends::Flat] {
        // What turns the cut turns the rings behind it: the vessel narrows a little aslant.
        check(&line_of(&cut(45.0, radius, ends)), radius, [0.1, 0.05, 0.15], &format!("{ends:?}"));
    }
}

#[test]
fn a_flat_cap_aslant_is_taken_for_a_cut_that_was_closed() {
    let mesh = cut(45.0, |_| 2.0, Ends::Flat);
    let found = openings(&mesh);
    assert_eq!(found.len(), 2);
    assert!(found.iter().all(|opening| opening.was_closed && opening.rim.len() == 32));
    // It is told of as what the mesh has.
    assert_eq!(line_of(&mesh).surface.openings, 0);
    assert!(openings(&cut(45.0, |_| 2.0, Ends::Open)).iter().all(|opening| !opening.was_closed));
    // So is one of a surface that is inside out.
    let mut inverted = mesh;
    inverted.triangles.iter_mut().for_each(|triangle| triangle.swap(0, 1));
    assert_eq!(openings(&inverted).len(), 2);
}

#[test]
fn a_hole_that_touches_a_cap_leaves_each_vertex_one_fan() {
    let mut mesh = cut(45.0, |_| 2.0, Ends::Flat);
    // Of the last row of the wall, the first: one of its corners is on the rim.
    mesh.triangles.remove(59 * 32 * 2);
    let prepared = prepare(&mesh).unwrap();
    let corners = &prepared.components[0].corners;
    let fans: usize = (0..corners.vertices() as u32).map(|v| corners.star(v).count()).sum();
    assert_eq!(fans, corners.half_edges());
    for opening in &prepared.components[0].openings {
        let mut rim = opening.rim.clone();
        rim.sort_unstable();
        rim.dedup();
        assert_eq!(rim.len(), opening.rim.len(), "a rim passes a vertex once");
    }
}

#[test]
fn what_is_flat_and_no_cut_stays() {
    let box_of = |sides: usize| {
        let axis = |share: f64| Point3::new(0.0, 0.0, 8.0 * share);
        sweep(axis, |_, angle| [2.0 * angle.cos(), 2.0 * angle.sin()], [9, sides], Ends::Flat)
    };
    for sides in [4, 6, 8] {
        assert_eq!(openings(&box_of(sides)), [], "a square cut of {sides} sides is seen for what it is");
    }
    // A wide trunk with a flattened side that is cut from it aslant to nothing.
    let mut flattened = cut(0.0, |_| 4.0, Ends::Flat);
    flattened.vertices.iter_mut().for_each(|vertex| vertex.x = vertex.x.min(3.0 + 0.05 * (vertex.z - 15.0)));
    assert_eq!(openings(&flattened), []);
}

/// A tube of radius 2 along z, cut at `degrees` and closed as marching tetrahedra of side `step` do.
fn marched(degrees: f64, step: f64) -> TriangleMesh {
    let (slope, reach) = (degrees.to_radians().tan(), 5.0);
    let beyond = |p: &Point3<f64>, end: f64| (slope * p.x + (p.z - end)) * degrees.to_radians().cos();
    let field = |p: &Point3<f64>| (p.x.hypot(p.y) - 2.0).max(beyond(p, LENGTH)).max(-beyond(p, 0.0));
    // Off the lattice, so that no vertex of it lies on a plane.
    let low = [-3.03, -3.07, -reach - 0.11];
    implicit(low, [3.0, 3.0, LENGTH + reach], step, field)
}

#[test]
fn a_cap_that_marching_cubes_rounded_is_known_from_the_line() {
    for (degrees, step) in [(40.0, 1.0), (50.0, 1.0), (50.0, 0.6), (60.0, 0.6), (60.0, 0.4)] {
        let found = line_of(&marched(degrees, step));
        check(&found, |_| 2.0, [0.2, 0.1, 0.4], &format!("{degrees} degrees, {step}"));
        assert!(found.warnings.is_empty(), "{degrees} degrees, {step}: {:?}", found.warnings);
        assert_eq!(found.surface.openings, 0);
    }
}

/// Every vertex moved by up to `most` along each axis.
fn noisy(mut mesh: TriangleMesh, most: f64) -> TriangleMesh {
    let mut random = Random(7);
    let mut number = || most * (random.below(2001) as f64 / 1000.0 - 1.0);
    mesh.vertices.iter_mut().for_each(|vertex| *vertex += Vector3::from_fn(|_, _| number()));
    mesh
}

#[test]
fn a_noisy_cap_is_known_from_the_line() {
    // Each triangle of the caps leans by its own noise.
    for (degrees, most) in [(50.0, 0.06), (50.0, 0.12), (60.0, 0.06)] {
        let found = line_of(&noisy(cut(degrees, |_| 2.0, Ends::Flat), most));
        check(&found, |_| 2.0, [0.2, 0.1, 0.4], &format!("{degrees} degrees, {most}"));
        assert!(found.warnings.is_empty(), "{degrees} degrees, {most}: {:?}", found.warnings);
    }
}

#[test]
fn a_picked_end_is_kept_when_its_cut_is_opened() {
    let mesh = marched(50.0, 0.6);
    let mut parameters = Parameters::default();
    parameters.set("root", "2,0,28").unwrap();
    let found = extract(&mesh, &parameters, &Control::silent()).unwrap();
    check(&found, |_| 2.0, [0.2, 0.1, 0.4], "with a root");
    assert!(found.centerline.nodes[0].position.z > 29.0, "{:?}", found.centerline.nodes);
}

/// Marching cubes leaves a chamfer around a flat cap, and the wall beside the rim faces half outward: an opening was taken
/// for a hole, where no vessel was cut.
#[test]
fn a_cap_of_marching_cubes_that_was_taken_off_leaves_an_opening() {
    let tube = |p: &Point3<f64>| (p.x.hypot(p.y) - 3.0).max(p.z.abs() - 12.0);
    let mut mesh = implicit([-4.0, -4.1, -13.0], [4.0, 4.0, 13.0], 0.304, tube);
    let TriangleMesh { vertices, triangles } = &mut mesh;
    triangles.retain(|corners| corners.iter().any(|&v| vertices[v as usize].z.abs() < 11.999));
    let found = extract(&mesh, &Parameters::default(), &Control::silent()).unwrap();
    assert_eq!(found.surface.openings, 2, "{:?}", found.warnings);
    assert!(found.warnings.iter().all(|warning| warning.code != "holes-closed"), "{:?}", found.warnings);
}
