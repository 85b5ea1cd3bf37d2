//! Vessels whose sections are no circles: the radius is that of the sphere that fits in.

use nalgebra::Point3;
use rosaline::centerline::Extraction;

use crate::lines::{ends_and_junctions, line_of, points};
use crate::surfaces::{Ends, straight, sweep};

const LENGTH: f64 = 60.0;

/// The line of a straight open tube with rings 0.8 apart of 48 vertices each, as far from the axis as `wall` says of
/// their angle.
fn tube(wall: impl Fn(f64) -> f64) -> Extraction {
    let section = |_, angle: f64| [wall(angle) * angle.cos(), wall(angle) * angle.sin()];
    line_of(&sweep(straight(LENGTH), section, [76, 48], Ends::Open))
}

/// The line is the axis and has that radius, to a share of it; there is nothing to warn of.
fn check(found: &Extraction, radius: f64, most: f64) {
    assert_eq!(ends_and_junctions(&found.centerline), (2, 0));
    assert!(found.warnings.is_empty(), "{:?}", found.warnings);
    for (point, found) in points(&found.centerline) {
        assert!(point.x.hypot(point.y) < 0.02 * radius, "{point} is off the axis");
        assert!((found / radius - 1.0).abs() < most, "{found} at {point} is not {radius}");
    }
}

#[test]
fn in_a_square_the_sphere_touches_the_sides() {
    // Turned, so that no side is square to an axis of the frame.
    let wall = |angle: f64| {
        let angle = angle + 0.3;
        5.0 / angle.cos().abs().max(angle.sin().abs())
    };
    check(&tube(wall), 5.0, 0.02);
}

#[test]
fn in_a_pentagon_and_a_hexagon_it_does_too() {
    for sides in [5.0, 6.0] {
        let part = std::f64::consts::TAU / sides;
        let wall = |angle: f64| 5.0 / ((angle + 0.2).rem_euclid(part) - 0.5 * part).cos();
        check(&tube(wall), 5.0, 0.02);
    }
}

#[test]
fn a_lumen_of_three_lobes_has_the_sphere_between_its_flat_sides() {
    check(&tube(|angle| 5.0 * (1.0 + 0.06 * (3.0 * angle + 0.4).cos())), 4.7, 0.01);
}

#[test]
fn three_lobes_of_an_ellipse_are_heard_on_top_of_it() {
    let wall = |angle: f64| 5.0 * (1.0 + 0.05 * (2.0 * angle).cos() + 0.04 * (3.0 * angle + 1.0).cos());
    let nearest =
        (0..3600).map(|i| wall(f64::from(i) * std::f64::consts::TAU / 3600.0)).fold(f64::INFINITY, f64::min);
    check(&tube(wall), nearest, 0.01);
}

#[test]
fn what_noise_and_few_vertices_show_are_no_lobes() {
    // A number that looks random, of each vertex its own.
    let random = |share: f64, angle: f64| ((1e4 * share + 7.3 * angle).sin() * 43758.5453).fract();
    let rough = |share: f64, angle: f64| {
        let wall = 5.0 * (1.0 + 0.06 * random(share, angle));
        [wall * angle.cos(), wall * angle.sin()]
    };
    let few = |_, angle: f64| [5.0 * f64::cos(angle), 5.0 * f64::sin(angle)];
    for mesh in [
        sweep(straight(LENGTH), rough, [76, 48], Ends::Open),
        sweep(straight(LENGTH), few, [16, 7], Ends::Open),
    ] {
        for (point, found) in points(&line_of(&mesh).centerline) {
            assert!((found / 5.0 - 1.0).abs() < 0.015, "{found} at {point}");
        }
    }
}

#[test]
fn a_vessel_four_times_as_wide_as_high_misses_no_branch() {
    let wall = |angle: f64| 1.0 / (angle.cos() / 8.0).hypot(angle.sin() / 2.0);
    check(&tube(wall), 2.0, 0.02);
}

#[test]
fn a_plate_whose_faces_have_no_vertices_is_told_of() {
    // Half axes 15 and 1.5, 1 high: the nearest vertices lie at the edges of its faces.
    let axis = |share: f64| Point3::new(0.0, 0.0, share);
    let section = |_, angle: f64| [15.0 * angle.cos(), 1.5 * angle.sin()];
    for [rings, sides] in [[2, 48], [4, 64], [7, 160], [11, 320]] {
        let found = line_of(&sweep(axis, section, [rings, sides], Ends::Flat));
        let codes: Vec<&str> = found.warnings.iter().map(|warning| warning.code).collect();
        let widest = points(&found.centerline).map(|(_, radius)| radius).fold(0.0, f64::max);
        assert!(widest < 0.7 || codes.contains(&"radius"), "{sides} sides: {widest}, {codes:?}");
    }
}
