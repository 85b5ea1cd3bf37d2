//! Ends that were cut aslant: the line stays on the axis and reaches the middle of the cut.

use nalgebra::Point3;
use rosaline::centerline::Extraction;
use rosaline::mesh::TriangleMesh;
use rosaline::mesh::preparation::{Opening, prepare};

use crate::lines::{ends_and_junctions, line_of, points};
use crate::surfaces::{Ends, sweep};

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

/// `most`: distance of a point from the axis, relative error of a radius.
fn check(found: &Extraction, radius: impl Fn(f64) -> f64, most: [f64; 2], what: &str) {
    assert_eq!(ends_and_junctions(&found.centerline), (2, 0), "{what}");
    let aside = |point: &Point3<f64>| point.x.hypot(point.y);
    let off = points(&found.centerline).map(|(point, _)| aside(point)).fold(0.0, f64::max);
    assert!(off < most[0], "{what}: {off} off the axis");
    for end in [0.0, LENGTH] {
        let away = |node: &Point3<f64>| (node - Point3::new(0.0, 0.0, end)).norm();
        let missed = found.centerline.nodes.iter().map(|node| away(&node.position)).fold(f64::MAX, f64::min);
        assert!(missed < 0.15, "{what}: the cut at {end} is missed by {missed}");
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
                [0.05, 0.02],
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
        check(&line_of(&cut(45.0, radius, ends)), radius, [0.1, 0.05], &format!("{ends:?}"));
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
