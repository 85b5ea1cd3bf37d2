//! Places where a vessel narrows or widens within about a diameter.

use std::f64::consts::FRAC_PI_3;

use nalgebra::{Point3, Vector3};
use rosaline::centerline::Branch;
use rosaline::mesh::TriangleMesh;

use crate::lines::{ends_and_junctions, line_of, moved, points};
use crate::surfaces::{Ends, from_segment, implicit, mapped, straight, sweep, turn};

const LENGTH: f64 = 40.0;

/// What a bump of height 1 at `at` has at `z`.
fn bump(z: f64, at: f64, width: f64) -> f64 {
    (-((z - at) / width).powi(2)).exp()
}

/// A tube along z.
fn tube(radius: impl Fn(f64) -> f64) -> TriangleMesh {
    let section = |share: f64, angle: f64| {
        let radius = radius(LENGTH * share);
        [radius * angle.cos(), radius * angle.sin()]
    };
    sweep(straight(LENGTH), section, [241, 32], Ends::Flat)
}

/// Largest relative error of the radii from those of the largest spheres in a tube, away from its ends.
fn error(branch: &Branch, radius: impl Fn(f64) -> f64) -> f64 {
    let fits =
        |z: f64| (0..=1600).map(|k| f64::from(k) / 40.0).map(|w| radius(w).hypot(w - z)).fold(9.0, f64::min);
    let inner = branch.points.iter().zip(&branch.radii).filter(|(p, _)| (3.0..LENGTH - 3.0).contains(&p.z));
    inner.map(|(point, told)| (told / fits(point.z) - 1.0).abs()).fold(0.0, f64::max)
}

#[test]
fn a_throat_before_a_widening_is_told_as_well_and_the_line_never_turns_back() {
    for (throat, wide) in [(16.0, 22.0), (17.0, 20.5), (20.0, 24.0)] {
        let radius = |z: f64| 2.0 - bump(z, throat, 1.0) + 1.8 * bump(z, wide, 2.0);
        let found = line_of(&tube(radius)).centerline;
        let branch = &found.branches[0];
        assert!(error(branch, radius) < 0.12, "{throat}, {wide}: {}", error(branch, radius));
        let up = branch.points[branch.points.len() - 1].z > branch.points[0].z;
        assert!(branch.points.windows(2).all(|pair| (pair[1].z > pair[0].z) == up), "{throat}, {wide}");
        let ends = [(branch.from, 0), (branch.to, branch.points.len() - 1)];
        for (node, place) in ends.map(|(node, place)| (&found.nodes[node], place)) {
            assert_eq!((node.position, node.radius), (branch.points[place], branch.radii[place]));
        }
    }
}

/// A tube of radius 2 whose throat, of radius 1, lies aside.
fn aside(by: f64, step: f64) -> TriangleMesh {
    let field = |p: &Point3<f64>| {
        let near = bump(p.z, 20.3, 2.0);
        ((p.x - by * near).hypot(p.y) - (2.0 - near)).max(-p.z).max(p.z - LENGTH)
    };
    implicit([-3.01, -3.013, -1.017], [3.0, 3.0, LENGTH + 1.0], step, field)
}

#[test]
fn the_line_runs_through_a_throat_that_lies_aside() {
    const ASIDE: f64 = 0.8;
    for step in [0.25, 0.4] {
        let found = line_of(&aside(ASIDE, step)).centerline;
        let throat = points(&found).min_by(|a, b| a.1.total_cmp(&b.1)).unwrap();
        assert!((throat.1 - 1.0).abs() < 0.05 && (throat.0.z - 20.3).abs() < 0.3, "{step}: {throat:?}");
        assert!((throat.0.x - ASIDE).hypot(throat.0.y) < 0.05, "{step}: {}", throat.0);
        let off = |p: &Point3<f64>| (p.x - ASIDE * bump(p.z, 20.3, 2.0)).hypot(p.y);
        let farthest = points(&found).map(|(point, _)| off(point)).fold(0.0, f64::max);
        assert!(farthest < 0.25, "{step}: {farthest}");
    }
}

#[test]
fn unit_and_direction_change_no_throat() {
    let mesh = aside(0.8, 0.4);
    let found = line_of(&mesh);
    let place = |p: &Point3<f64>| turn() * (p * 1e-3);
    let mut expected = found.clone();
    for node in &mut expected.centerline.nodes {
        node.position = place(&node.position);
        node.radius *= 1e-3;
        node.equivalent_radius *= 1e-3;
    }
    for branch in &mut expected.centerline.branches {
        branch.points.iter_mut().for_each(|point| *point = place(point));
        branch.radii.iter_mut().chain(&mut branch.equivalent_radii).for_each(|radius| *radius *= 1e-3);
    }
    let other = line_of(&mapped(&mesh, place));
    let moved = moved(&expected, &other);
    assert!(moved.is_some_and(|moved| moved < 1e-3 * 1e-6 * LENGTH), "{moved:?}");
}

/// A throat of half the radius in one branch of a fork, from two and a half radii of the joint on.
#[test]
fn a_throat_beside_a_fork_is_told_and_the_fork_stays() {
    let joint = Point3::new(0.0, 0.0, 16.0);
    let out = |side: f64| Vector3::new(side * (FRAC_PI_3 / 2.0).sin(), 0.0, (FRAC_PI_3 / 2.0).cos());
    let side = |p: &Point3<f64>, side: f64, throat: f64| {
        let along = (p - joint).dot(&out(side));
        from_segment(p, joint, joint + out(side) * 18.0) - 1.6 * (1.0 - 0.5 * throat * bump(along, 6.5, 1.5))
    };
    let field = |p: &Point3<f64>| {
        let trunk = from_segment(p, Point3::new(0.0, 0.0, 0.0), joint) - 2.0;
        trunk.min(side(p, 1.0, 1.0)).min(side(p, -1.0, 0.0))
    };
    let found = line_of(&implicit([-13.0, -3.0, -3.0], [13.01, 3.01, 35.0], 0.35, field)).centerline;
    assert_eq!(ends_and_junctions(&found), (3, 1));
    let least = |side: f64| {
        let of_side = points(&found).filter(|(p, _)| p.x * side > 2.0 && p.z < 28.0);
        of_side.map(|(_, radius)| radius).fold(f64::INFINITY, f64::min)
    };
    assert!((least(1.0) / 0.8 - 1.0).abs() < 0.1, "{}", least(1.0));
    assert!((least(-1.0) / 1.6 - 1.0).abs() < 0.03, "{}", least(-1.0));
}

/// Told anew, the line of a narrow throat may come off the middle of its vessel. Then it stays as it was, and what it misses is told.
#[test]
fn a_line_that_misses_a_tight_throat_is_told() {
    for (depth, width, by, step, most) in [
        (0.85, 1.25, 0.9, 0.17, 0.7),
        (0.8, 1.5, 2.16, 0.2, 0.4),
        (0.9, 1.25, 0.9, 0.2, 1.5),
        // Moved, it would lie 2.3 radii off.
        (0.85, 1.25, 2.16, 0.18, 0.8),
    ] {
        let field = |p: &Point3<f64>| {
            let near = bump(p.z, 14.0, width);
            ((p.x - by * near).hypot(p.y) - 3.0 * (1.0 - depth * near)).max(1.0 - p.z).max(p.z - 27.0)
        };
        let found = line_of(&implicit([-3.61, -3.613, 0.617], [3.7 + by, 3.7, 28.0], step, field));
        let branch = &found.centerline.branches[0];
        let middle = |p: &Point3<f64>| {
            let near = bump(p.z, 14.0, width);
            (p.x - by * near).hypot(p.y) / (3.0 * (1.0 - depth * near))
        };
        let off = branch.points.iter().map(middle).fold(0.0, f64::max);
        let told = found.warnings.iter().any(|w| ["off-center", "outside", "radius"].contains(&w.code));
        assert!(off < most && (off < 0.5 || told), "{depth} {width} {by} {step}: {off} {:?}", found.warnings);
    }
}

/// A vessel that is wide again past a throat, as it was nowhere before it.
#[test]
fn a_throat_of_half_the_radius_bridges_nothing() {
    for (depth, width) in [(0.5, 1.5), (0.4, 1.0), (0.3, 1.5)] {
        let field = |p: &Point3<f64>| {
            (p.x.hypot(p.y) - 3.0 * (1.0 - depth * bump(p.z, 20.0, width))).max(-p.z).max(p.z - LENGTH)
        };
        let found = line_of(&implicit([-3.61, -3.613, -0.917], [3.7, 3.7, LENGTH + 1.0], 0.3, field));
        let off = found.centerline.branches[0].points.iter().map(|p| p.x.hypot(p.y)).fold(0.0, f64::max);
        assert!(off < 0.1 && found.warnings.is_empty(), "{depth} {width}: {off} {:?}", found.warnings);
    }
}

/// Between the joint of a narrow fork and a throat just behind where its walls part no section shows the branch alone: its
/// radius went on as narrow as in the throat.
#[test]
fn a_throat_close_behind_a_narrow_fork_is_not_told_before_it() {
    for (half, at, depth) in [(0.28_f64, 6.4, 0.64), (0.26, 7.4, 0.6), (0.28, 7.9, 0.64)] {
        let along = |side: f64, way: f64| Point3::new(side * half.sin() * way, 0.0, half.cos() * way);
        let radius = |way: f64| 1.55 * (1.0 - depth * bump(way, at, 1.3));
        let field = |point: &Point3<f64>| {
            let trunk = from_segment(point, Point3::new(0.0, 0.0, -14.0), Point3::origin()) - 2.0;
            let other = from_segment(point, Point3::origin(), along(-1.0, 22.0)) - 1.5;
            let way = (point - Point3::origin()).dot(&along(1.0, 1.0).coords).clamp(0.0, 22.0);
            ((point - along(1.0, way)).norm() - radius(way)).min(other).min(trunk)
        };
        let line = line_of(&implicit([-9.3, -2.9, -16.9], [9.3, 2.9, 24.2], 0.3, field));
        assert_eq!(ends_and_junctions(&line.centerline), (3, 1), "{half} {at}");
        for way in (1..=20).map(f64::from) {
            let away = |(point, _): &(&Point3<f64>, f64)| (*point - along(1.0, way)).norm();
            let (_, told) = points(&line.centerline).min_by(|a, b| away(a).total_cmp(&away(b))).unwrap();
            let share = told / radius(way);
            assert!((0.6..1.35).contains(&share), "{half} {at}: {share} of the radius at {way}");
        }
    }
}
