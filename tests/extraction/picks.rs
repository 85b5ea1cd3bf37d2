//! Ends that are asked for, ends that are not wanted, and the root.

use nalgebra::{Point3, Vector3};
use rosaline::centerline::{
    Control, ExtractError, Extraction, NodeKind, POINTS, Parameters, Preset, extract,
};
use rosaline::mesh::TriangleMesh;
use rosaline::phantom::{Kind, Settings, generate};

use crate::lines::*;
use crate::surfaces::*;

const PRESETS: [Preset; 2] = [Preset::Default, Preset::Paper];

fn picked(
    mesh: &TriangleMesh,
    preset: Preset,
    picks: &[(&str, Point3<f64>)],
) -> Result<Extraction, ExtractError> {
    let mut parameters = Parameters::of(preset);
    for (name, point) in picks {
        parameters.set(name, &format!("{},{},{}", point.x, point.y, point.z)).unwrap();
    }
    extract(mesh, &parameters, &Control::silent())
}

/// The ends of a line.
fn ends(found: &Extraction) -> Vec<Point3<f64>> {
    let nodes = found.centerline.nodes.iter().filter(|node| node.kind == NodeKind::End);
    nodes.map(|node| node.position).collect()
}

#[track_caller]
fn assert_sound(found: &Extraction) {
    let quality = found.quality.unwrap();
    assert!(quality.homotopy.equal && quality.thinness, "{quality:?}");
}

fn codes(found: &Extraction) -> Vec<&str> {
    found.warnings.iter().map(|warning| warning.code).collect()
}

fn tube() -> TriangleMesh {
    sweep(straight(20.0), round(1.0), [80, 24], Ends::Flat)
}

#[test]
fn a_point_on_the_side_of_a_tube_becomes_an_end_and_the_axis_stays() {
    let side = Point3::new(1.0, 0.0, 20.0 * 36.0 / 79.0);
    for preset in PRESETS {
        let found = picked(&tube(), preset, &[("include", side), ("include", side)]).unwrap();
        assert_eq!(ends_and_junctions(&found.centerline), (3, 1), "{preset}");
        assert_sound(&found);
        let apart = |end: &Point3<f64>| (end - side).norm();
        let nearest = ends(&found).iter().map(apart).fold(f64::INFINITY, f64::min);
        assert!(nearest < 0.1, "{preset}: the nearest end is {nearest} away");
        let joint = found.centerline.nodes.iter().find(|node| node.kind == NodeKind::Junction).unwrap();
        assert!(joint.position.x.hypot(joint.position.y) < 0.15, "{preset}: {}", joint.position);
    }
}

#[test]
fn an_end_that_is_there_already_is_not_told_twice() {
    for preset in PRESETS {
        let plain = extracted(&tube(), preset).unwrap();
        for place in [Point3::new(0.3, 0.2, 20.0), Point3::new(1.0, 0.0, 0.2)] {
            let found = picked(&tube(), preset, &[("include", place)]).unwrap();
            assert_eq!(found.centerline, plain.centerline, "{preset}, {place}");
        }
    }
}

#[test]
fn a_stump_too_low_for_a_branch_is_one_when_it_is_asked_for() {
    let capsule = |p: &Point3<f64>, a: Point3<f64>, b: Point3<f64>, radius: f64| {
        let share = ((p - a).dot(&(b - a)) / (b - a).norm_squared()).clamp(0.0, 1.0);
        (p - (a + (b - a) * share)).norm() - radius
    };
    // Its top lies 0.4 over the wall, less than its radius of 0.5.
    let stump = implicit([-1.3, -1.3, -1.3], [1.7, 1.3, 13.3], 0.12, |p| {
        let trunk = capsule(p, Point3::origin(), Point3::new(0.0, 0.0, 12.0), 1.0);
        trunk.min(capsule(p, Point3::new(0.0, 0.0, 6.0), Point3::new(0.9, 0.0, 6.0), 0.5))
    });
    let top = Point3::new(1.4, 0.0, 6.0);
    for preset in PRESETS {
        assert_eq!(ends(&extracted(&stump, preset).unwrap()).len(), 2, "{preset}");
        let found = picked(&stump, preset, &[("include", top)]).unwrap();
        assert_eq!(ends_and_junctions(&found.centerline), (3, 1), "{preset}");
        assert_sound(&found);
        assert!(ends(&found).iter().any(|end| (end - top).norm() < 0.3), "{preset}: {:?}", ends(&found));
    }
}

#[test]
fn an_end_that_is_not_wanted_goes_with_its_branch() {
    let mesh = generate(Kind::Bifurcation, 4, &Settings::of(Kind::Bifurcation)).unwrap().mesh;
    for preset in PRESETS {
        let plain = ends(&extracted(&mesh, preset).unwrap());
        assert_eq!(plain.len(), 3);
        for end in &plain {
            let found = picked(&mesh, preset, &[("exclude", *end)]).unwrap();
            assert_eq!(ends_and_junctions(&found.centerline), (2, 0), "{preset}");
            assert_sound(&found);
            // All of one radius or less: what is left lies many of them away.
            assert!(ends(&found).iter().all(|left| (left - end).norm() > 5.0), "{preset}");
        }
    }
}

#[test]
fn a_ring_keeps_its_loop_when_all_its_ends_go() {
    let mesh = generate(Kind::Loop, 2, &Settings::of(Kind::Loop)).unwrap().mesh;
    let plain = ends(&line_of(&mesh));
    let picks: Vec<_> = plain.iter().map(|end| ("exclude", *end)).collect();
    let found = picked(&mesh, Preset::Default, &picks).unwrap();
    assert_eq!(parts_and_loops(&found.centerline), (1, 1));
    assert_eq!(ends(&found).len(), 0);
    assert_sound(&found);
}

#[test]
fn a_tube_keeps_both_ends_and_says_that_nothing_was_excluded() {
    for preset in PRESETS {
        let plain = extracted(&tube(), preset).unwrap();
        let found = picked(&tube(), preset, &[("exclude", Point3::new(0.0, 0.0, 20.0))]).unwrap();
        assert_eq!(found.centerline, plain.centerline, "{preset}");
        assert_eq!(codes(&found), ["nothing-excluded"]);
        assert!(found.warnings[0].detail.ends_with("point 1 of exclude"), "{}", found.warnings[0].detail);
    }
}

#[test]
fn the_line_is_told_from_its_root_outward() {
    let mesh = generate(Kind::Tree, 2, &Settings::of(Kind::Tree)).unwrap().mesh;
    for preset in PRESETS {
        let plain = ends(&extracted(&mesh, preset).unwrap());
        for root in plain.iter().step_by(3) {
            let found = picked(&mesh, preset, &[("root", *root)]).unwrap();
            let line = &found.centerline;
            assert!((line.nodes[0].position - root).norm() < 0.2, "{preset}: {}", line.nodes[0].position);
            assert_eq!(line.nodes[0].kind, NodeKind::End);
            assert_eq!(ends(&found).len(), plain.len(), "{preset}");
            assert_sound(&found);
            // A walk that only ever goes from a branch's start to its end meets them all, in order.
            let mut seen = vec![0];
            for branch in &line.branches {
                assert!(seen.contains(&branch.from), "{preset}: a branch starts where no other has ended");
                assert_eq!(branch.points[0], line.nodes[branch.from].position);
                assert_eq!(branch.points[branch.points.len() - 1], line.nodes[branch.to].position);
                assert_eq!(branch.equivalent_radii[0], line.nodes[branch.from].equivalent_radius);
                seen.push(branch.to);
            }
            assert!(seen.is_sorted(), "{preset}: {seen:?}");
        }
    }
}

#[test]
fn the_component_of_the_root_comes_first() {
    let other = mapped(&tube(), |point| point + Vector3::new(6.0, 0.0, 0.0));
    let both = together(&[tube(), other]);
    for x in [0.0, 6.0] {
        let root = Point3::new(x, 0.0, 20.0);
        let found = picked(&both, Preset::Default, &[("root", root)]).unwrap();
        assert_eq!(found.centerline.nodes.len(), 4);
        assert!((found.centerline.nodes[0].position - root).norm() < 0.05);
        assert_eq!(found.centerline.branches[0].from, 0);
    }
}

#[test]
fn a_point_off_the_surface_is_refused_by_its_number() {
    let on = Point3::new(1.0, 0.0, 9.0);
    for spec in POINTS {
        let far = Point3::new(5.0, 0.0, 0.0);
        let mut picks = vec![(spec.name, on); spec.most.min(2) - 1];
        picks.push((spec.name, far));
        let error = picked(&tube(), Preset::Default, &picks).unwrap_err();
        let ExtractError::OffSurface { name, number, distance, .. } = error else { panic!("{error}") };
        assert_eq!((name, number), (spec.name, picks.len()));
        assert!((distance - 4.0).abs() < 1e-9, "{distance}");
    }
}

/// The stump's own front counts on it; the peak that is raised for the point stands on the way to the root.
#[test]
fn a_point_beside_a_short_wide_leg_becomes_an_end_as_well() {
    let (from, to) = (Point3::new(-16.0, 0.0, 0.0), Point3::new(16.0, 0.0, 0.0));
    let field = |point: &Point3<f64>| {
        let leg = from_segment(point, Point3::origin(), Point3::new(0.0, 0.0, 5.2));
        from_segment(point, from, to).min(leg) - 2.0
    };
    let mesh = implicit([-19.1, -3.1, -3.1], [19.0, 3.0, 8.0], 0.5, field);
    for place in [-9.0, -4.0, 4.0, 9.0] {
        let found = picked(&mesh, Preset::Default, &[("include", Point3::new(place, 0.0, -2.0))]).unwrap();
        assert_eq!(ends(&found).len(), 4, "{place}");
        let away =
            |at: Point3<f64>| ends(&found).iter().map(|end| (end - at).norm()).fold(f64::INFINITY, f64::min);
        assert!(
            away(Point3::new(0.0, 0.0, 7.2)) < 0.4 && away(Point3::new(place, 0.0, -2.0)) < 0.4,
            "{place}"
        );
        assert_sound(&found);
    }
}
