//! Phantoms whose line was told with a wrong or doubled branch once.

use nalgebra::{Point3, Vector3};
use rosaline::centerline::{Node, NodeKind};
use rosaline::mesh::TriangleMesh;
use rosaline::phantom::{Kind, Settings, generate};

use crate::lines::{ends_and_junctions, line_of, parts_and_loops};
use crate::surfaces::{Ends, from_segment, implicit, sweep};

/// Ends, joints, parts and loops are those of the known line, and the line is thin and without `not-thin`.
fn check(kind: Kind, seed: u64, settings: &Settings) {
    let phantom = generate(kind, seed, settings).unwrap();
    let (found, known) = (line_of(&phantom.mesh), phantom.centerline);
    let counts = |line| (ends_and_junctions(line), parts_and_loops(line));
    assert_eq!(counts(&found.centerline), counts(&known), "{kind:?} {seed}");
    assert!(found.quality.is_some_and(|quality| quality.thinness), "{kind:?} {seed}");
    assert!(found.warnings.iter().all(|warning| warning.code != "not-thin"), "{kind:?} {seed}");
}

#[test]
fn a_trunk_whose_short_wide_end_a_front_came_to_aslant_is_passed_once() {
    check(Kind::Mixed, 65, &Settings::of(Kind::Mixed));
    check(Kind::Mixed, 108, &Settings { stair: true, ..Settings::of(Kind::Mixed) });
}

#[test]
fn joints_that_the_fit_brings_together_are_one() {
    check(Kind::Trifurcation, 3, &Settings { noise: 0.3, ..Settings::of(Kind::Trifurcation) });
}

#[test]
fn a_sac_that_the_front_along_its_vessel_climbs_is_kept() {
    check(Kind::Aneurysm, 304, &Settings { noise: 0.3, ..Settings::of(Kind::Aneurysm) });
}

/// A vessel of radius 2 along x, and legs of such radii on it, from places along x to their tips' middles; closed.
fn with_legs(legs: &[(f64, Point3<f64>, f64)], shift: f64) -> TriangleMesh {
    let field = |point: &Point3<f64>| {
        let vessel = from_segment(point, Point3::new(-16.0, 0.0, 0.0), Point3::new(16.0, 0.0, 0.0)) - 2.0;
        let away = |&(place, tip, radius): &(f64, Point3<f64>, f64)| {
            from_segment(point, Point3::new(place, 0.0, 0.0), tip) - radius
        };
        legs.iter().map(away).fold(vessel, f64::min)
    };
    let [low, high] = [[-19.1, -9.1, -9.1], [19.0, 9.0, 9.0]];
    implicit(low.map(|border| border - shift), high, 0.5, field)
}

/// There is an end within 0.2 radii of each leg's pole, and of both poles of the vessel; no other, and no warning.
fn has_its_legs(legs: &[(f64, Point3<f64>, f64)], shift: f64) {
    let found = line_of(&with_legs(legs, shift));
    let (ends, _) = ends_and_junctions(&found.centerline);
    assert_eq!((ends, parts_and_loops(&found.centerline)), (legs.len() + 2, (1, 0)), "{legs:?} {shift}");
    let pole = |&(place, tip, radius): &(f64, Point3<f64>, f64)| {
        tip + (tip - Point3::new(place, 0.0, 0.0)).normalize() * radius
    };
    let poles = legs.iter().map(pole).chain([-18.0, 18.0].map(|x| Point3::new(x, 0.0, 0.0)));
    for pole in poles {
        let away = found.centerline.nodes.iter().map(|node| (node.position - pole).norm());
        assert!(away.fold(f64::INFINITY, f64::min) < 0.4, "no end near {pole} of {legs:?}, {shift}");
    }
    assert!(found.warnings.is_empty(), "{legs:?} {shift}: {:?}", found.warnings);
}

/// A front along the vessel leaves no more of each than its far corner: by how the voxels fell they were missing, or a
/// second branch ran down the vessel.
#[test]
fn a_short_closed_leg_as_wide_as_its_vessel_is_a_branch() {
    for shift in [0.0, 0.13, 0.29] {
        has_its_legs(&[(0.0, Point3::new(0.0, 0.0, 4.6), 2.0)], shift);
        has_its_legs(&[(0.0, Point3::new(0.0, 0.0, 6.0), 2.0)], shift);
        has_its_legs(&[(0.0, Point3::new(3.0, 0.0, 5.2), 2.0)], shift);
    }
}

#[test]
fn several_short_closed_legs_are_branches_each() {
    let legs = [
        (-8.0, Point3::new(-8.0, 0.0, 5.6), 2.0),
        (0.0, Point3::new(0.0, 5.4, 0.0), 1.6),
        (8.0, Point3::new(8.0, 0.0, -5.6), 2.0),
    ];
    for shift in [0.0, 0.13, 0.29] {
        has_its_legs(&legs, shift);
    }
}

/// A T or Y of flat-capped vessels of such radii and lengths from its middle, the first two of one vessel.
fn capped_fork(legs: &[(Vector3<f64>, f64)], [step, shift]: [f64; 2]) -> TriangleMesh {
    let field = |point: &Point3<f64>| {
        let leg = |(tip, radius): &(Vector3<f64>, f64)| {
            let (axis, length) = (tip.normalize(), tip.norm());
            let along = point.coords.dot(&axis);
            ((point.coords - axis * along).norm() - radius).max(-along).max(along - length)
        };
        legs.iter().map(leg).fold(point.coords.norm() - legs[0].1, f64::min)
    };
    let far = legs
        .iter()
        .map(|(tip, radius)| tip.abs().add_scalar(*radius))
        .fold(Vector3::zeros(), |a, b| a.sup(&b));
    let [low, high] = [-1.0, 1.0].map(|side| (far * side).add_scalar(side * 1.1 * step - shift));
    implicit(low.into(), high.add_scalar(2.0 * shift).into(), step, field)
}

/// The same, cut open where it was capped.
fn open_fork(legs: &[(Vector3<f64>, f64)], [step, shift]: [f64; 2]) -> TriangleMesh {
    let mut mesh = capped_fork(legs, [step, shift]);
    let is_past = |point: &Point3<f64>, tip: &Vector3<f64>| {
        point.coords.dot(&tip.normalize()) > tip.norm() - 0.5 * step
    };
    let vertices = &mesh.vertices;
    mesh.triangles.retain(|corners| {
        let past = |tip| corners.iter().all(|&v| is_past(&vertices[v as usize], tip));
        !legs.iter().any(|(tip, _)| past(tip))
    });
    mesh
}

/// Where legs are as short as they are wide a front climbs each while it passes it, and no end of the three is seen as it
/// is, the root's neither.
#[test]
fn a_fork_of_wide_short_legs_has_an_end_a_leg() {
    let lean = |degrees: f64, length: f64| {
        let (sin, cos) = degrees.to_radians().sin_cos();
        Vector3::new(length * cos, 0.0, length * sin)
    };
    for (trunk, [degrees, length, radius], step) in [
        ([9.0, 9.0], [90.0, 9.0, 3.0], 0.4),
        ([12.0, 12.0], [90.0, 7.5, 3.0], 0.4),
        ([12.0, 10.5], [50.0, 11.0, 2.2], 0.4),
        ([15.0, 12.0], [45.0, 14.0, 2.0], 0.5),
    ] {
        let [behind, ahead] = trunk;
        let legs = [(lean(180.0, behind), 3.0), (lean(0.0, ahead), 3.0), (lean(degrees, length), radius)];
        for (shift, is_open) in [(0.0, false), (0.13, false), (0.29, false), (0.0, true), (0.21, true)] {
            let mesh = if is_open { open_fork } else { capped_fork };
            let found = line_of(&mesh(&legs, [step, shift]));
            let case =
                format!("{trunk:?} {degrees} {length} {radius} {shift} {is_open}: {:?}", found.warnings);
            assert_eq!(found.surface.openings, if is_open { 3 } else { 0 }, "{case}");
            assert_eq!(ends_and_junctions(&found.centerline), (3, 1), "{case}");
            for (tip, radius) in &legs {
                let away = found.centerline.nodes.iter().map(|node| (node.position.coords - tip).norm());
                assert!(away.fold(f64::INFINITY, f64::min) < 0.2 * radius, "no end near {tip} of {case}");
            }
        }
    }
}

/// A front comes to a branch that was cut close to its vessel aslant: no level set of it lies before the rim.
#[test]
fn a_branch_that_was_cut_close_to_its_vessel_meets_it_where_their_axes_do() {
    for (trunk, [degrees, out, radius]) in [
        ([12.0, 8.0], [97.0, 4.0, 1.8]),
        ([11.4, 14.0], [112.0, 2.1, 1.1]),
        ([13.0, 8.0], [134.0, 5.6, 2.7]),
        ([14.0, 9.0], [60.0, 3.6, 1.5]),
        ([9.0, 13.0], [118.0, 5.4, 2.3]),
    ] {
        let (sin, cos) = f64::to_radians(degrees).sin_cos();
        let leg = Vector3::new(cos, 0.0, sin) * (3.0 / sin + out);
        let legs = [(Vector3::x() * -trunk[0], 3.0), (Vector3::x() * trunk[1], 3.0), (leg, radius)];
        for shift in [0.0, 0.13] {
            let found = line_of(&open_fork(&legs, [0.2 * radius, shift]));
            let case = format!("{trunk:?} {degrees} {out} {radius} {shift}: {:?}", found.warnings);
            assert_eq!(ends_and_junctions(&found.centerline), (3, 1), "{case}");
            assert!(found.warnings.is_empty(), "{case}");
            let joint = found.centerline.nodes.iter().find(|node| node.kind == NodeKind::Junction).unwrap();
            assert!(joint.position.coords.norm() < 0.3, "{} of {case}", joint.position);
            let end = |node: &&Node| (node.position.coords - leg).norm() < 0.2 * radius;
            let end = found.centerline.nodes.iter().find(end).unwrap_or_else(|| panic!("no end of {case}"));
            assert!((end.radius / radius - 1.0).abs() < 0.08, "{} of {case}", end.radius);
        }
    }
}

/// A twentieth of the trunk's section and cut two of its own radii out of the wall: no hole of the trunk's.
#[test]
fn a_thin_branch_that_was_cut_close_to_a_wide_vessel_has_its_end() {
    let (sin, cos) = f64::to_radians(70.0).sin_cos();
    for (radius, out) in [(0.4, 0.8), (0.4, 1.2), (0.5, 1.0)] {
        let leg = Vector3::new(cos, 0.0, sin) * (2.0 / sin + out);
        let legs = [(Vector3::x() * -6.0, 2.0), (Vector3::x() * 7.0, 2.0), (leg, radius)];
        for shift in [0.0, 0.07] {
            let found = line_of(&open_fork(&legs, [0.2, shift]));
            let case = format!("{radius} {out} {shift}: {:?}", found.warnings);
            assert_eq!(ends_and_junctions(&found.centerline), (3, 1), "{case}");
            let away = found.centerline.nodes.iter().map(|node| (node.position.coords - leg).norm());
            assert!(away.fold(f64::INFINITY, f64::min) < 0.5 * radius, "{case}");
        }
    }
}

/// A dome little longer than it is wide: by how the voxels fall it shows a corner alone, too little for a line. Then it is
/// told.
#[test]
fn a_short_leg_on_coarse_voxels_is_a_branch_or_told() {
    let (mut told, mut found) = (0, 0);
    for (tip, radius) in [(2.96, 2.4), (3.0, 1.0), (2.7, 1.0), (3.6, 1.0), (2.98, 1.4), (3.19, 1.7)] {
        for shift in [0.0, 0.11, 0.22, 0.33] {
            let leg = (0.0, Point3::new(0.0, 0.0, tip), radius);
            let line = line_of(&with_legs(&[leg], shift));
            let (ends, _) = ends_and_junctions(&line.centerline);
            let warning = line.warnings.iter().find(|warning| warning.code == "short-branch");
            assert_eq!(ends, if warning.is_some() { 2 } else { 3 }, "{leg:?} {shift}: {:?}", line.warnings);
            let Some(warning) = warning else {
                found += 1;
                continue;
            };
            let places = warning.detail.split(['[', ']']).nth(1).unwrap();
            let place: Vec<f64> = places.split(", ").map(|number| number.parse().unwrap()).collect();
            let away = (Point3::new(place[0], place[1], place[2]) - Point3::new(0.0, 0.0, tip)).norm();
            assert!(away < 1.2 * radius, "{leg:?} {shift}: {}", warning.detail);
            told += 1;
        }
    }
    assert!(told > 0 && found > 0, "{told} told, {found} found");
}

/// A U of two straight legs and half a circle, radius 1, with a throat some way behind the middle of the bend.
fn bent_with_throat(bend: f64, depth: f64, width: f64, behind: f64) -> TriangleMesh {
    const LEG: f64 = 8.0;
    let turn = std::f64::consts::PI * bend;
    let length = turn + 2.0 * LEG;
    let axis = |share: f64| {
        let along = share * length;
        if along < LEG {
            return Point3::new(-bend, 0.0, along - LEG);
        }
        if along > LEG + turn {
            return Point3::new(bend, 0.0, LEG + turn - along);
        }
        let (sin, cos) = ((along - LEG) / bend).sin_cos();
        Point3::new(-bend * cos, 0.0, bend * sin)
    };
    let section = |share: f64, angle: f64| {
        let away = (share - 0.5) * length - behind;
        let radius = 1.0 - depth * (-(away / width).powi(2)).exp();
        [radius * angle.cos(), radius * angle.sin()]
    };
    sweep(axis, section, [500, 32], Ends::Flat)
}

/// The front comes to the throat along the inside of the bend, and leaves a pocket of the outside in front of it for later:
/// it was taken for a branch as high as the throat is wide, or for a short wide one.
#[test]
fn the_wall_in_front_of_a_throat_on_a_bend_is_no_branch() {
    for (bend, depth, width, behind) in [
        (3.0, 0.6, 0.3, 1.5),
        (2.5, 0.6, 0.5, 0.0),
        (2.0, 0.7, 0.5, 1.5),
        (2.5, 0.7, 1.2, 3.0),
        (4.0, 0.7, 0.5, 0.0),
    ] {
        let found = line_of(&bent_with_throat(bend, depth, width, behind));
        let (ends, junctions) = ends_and_junctions(&found.centerline);
        assert_eq!((ends, junctions), (2, 0), "{bend} {depth} {width} {behind}: {:?}", found.warnings);
    }
}
