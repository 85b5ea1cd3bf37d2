//! Unit, place, direction, order of the vertices and number of threads do not matter.

use nalgebra::{Isometry3, Point3, Vector3};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;
use rosaline::centerline::{Extraction, Preset};
use rosaline::mesh::TriangleMesh;
use rosaline::phantom::{Kind, Settings, generate};

use crate::lines::*;
use crate::surfaces::*;

/// Of the diagonal: by how much another unit, place or direction may move the line.
const SAME: f64 = 1e-6;
/// The same for another order of vertices and triangles.
const SHUFFLED: f64 = 1e-3;
/// The same for a turn and the preset `paper`: rounding moves single vertices from one sample to the next, which was
/// seen to move a joint by 3.4e-3.
const PAPER: f64 = 5e-3;

/// What can be done to a surface without making it another vessel.
#[derive(Debug, Clone)]
enum Change {
    Scaled(f64),
    Moved(Isometry3<f64>),
    Shuffled(u64),
}

impl Change {
    fn of(&self, mesh: &TriangleMesh) -> TriangleMesh {
        match self {
            Change::Scaled(scale) => mapped(mesh, |point| point * *scale),
            Change::Moved(motion) => mapped(mesh, |point| motion * point),
            Change::Shuffled(seed) => shuffled(mesh, *seed),
        }
    }

    /// The result of the changed surface, told in the frame and unit of the one before.
    fn undone(&self, mut found: Extraction) -> Extraction {
        let scale = if let Change::Scaled(scale) = self { 1.0 / scale } else { 1.0 };
        let back = |point: &Point3<f64>| match self {
            Change::Moved(motion) => motion.inverse_transform_point(point),
            _ => point * scale,
        };
        for node in &mut found.centerline.nodes {
            node.position = back(&node.position);
            node.radius *= scale;
        }
        for branch in &mut found.centerline.branches {
            branch.points.iter_mut().for_each(|point| *point = back(point));
            branch.radii.iter_mut().for_each(|radius| *radius *= scale);
        }
        found
    }

    fn tolerance(&self) -> f64 {
        if matches!(self, Change::Shuffled(_)) { SHUFFLED } else { SAME }
    }
}

/// The changes that the promise names.
fn changes() -> Vec<Change> {
    let shift = |x, y, z| Change::Moved(Isometry3::translation(x, y, z));
    vec![
        Change::Scaled(1e-3),
        Change::Scaled(1e3),
        shift(1e5, -1e5, 1e5),
        Change::Moved(turn()),
        Change::Shuffled(3),
    ]
}

/// How far, in diagonals, each change moves the line of `mesh`; fails where that is too far.
fn check(name: &str, mesh: &TriangleMesh, preset: Preset, changes: &[Change]) {
    let before = extracted(mesh, preset).unwrap_or_else(|error| panic!("{name}: {error}"));
    for change in changes {
        let changed = extracted(&change.of(mesh), preset);
        let after = change.undone(changed.unwrap_or_else(|error| panic!("{name} {change:?}: {error}")));
        assert_eq!(
            parts_and_loops(&before.centerline),
            parts_and_loops(&after.centerline),
            "{name} {change:?}"
        );
        assert_eq!(before.centerline.nodes.len(), after.centerline.nodes.len(), "{name} {change:?}");
        let far = apart(&before, &after) / before.surface.diagonal;
        println!("{name}, {preset}: {change:?} moves the line by {far:.1e} diagonals");
        let turned = matches!(change, Change::Moved(motion) if motion.rotation.angle() > 0.0);
        let tolerance = match (preset, turned) {
            (Preset::Paper, true) => PAPER,
            _ => change.tolerance(),
        };
        assert!(far <= tolerance, "{name}: {change:?} moves the line by {far:e} diagonals");
    }
}

fn phantom(kind: Kind, seed: u64, settings: Settings) -> TriangleMesh {
    generate(kind, seed, &settings).unwrap().mesh
}

#[test]
fn unit_place_direction_and_order_do_not_matter() {
    let stair = Settings { stair: true, ..Settings::of(Kind::Bifurcation) };
    let open = Settings { open: true, ..Settings::of(Kind::Loop) };
    for (name, mesh) in [
        ("bifurcation", phantom(Kind::Bifurcation, 7, Settings::of(Kind::Bifurcation))),
        ("stairs", phantom(Kind::Bifurcation, 7, stair)),
        ("open loop", phantom(Kind::Loop, 7, open)),
        ("aneurysm", phantom(Kind::Aneurysm, 7, Settings::of(Kind::Aneurysm))),
        ("tree", phantom(Kind::Tree, 7, Settings::of(Kind::Tree))),
        ("open tube", sweep(straight(20.0), round(1.0), [60, 24], Ends::Open)),
        ("capped tube", sweep(straight(20.0), round(1.0), [60, 24], Ends::Flat)),
    ] {
        check(name, &mesh, Preset::Default, &changes());
    }
}

/// Points and radii come back at their places, not only somewhere on the same line.
#[test]
fn a_turned_bifurcation_has_the_same_points() {
    let mesh = phantom(Kind::Bifurcation, 5, Settings::of(Kind::Bifurcation));
    let before = line_of(&mesh);
    for change in changes() {
        let after = change.undone(line_of(&change.of(&mesh)));
        let most = moved(&before, &after).unwrap() / before.surface.diagonal;
        assert!(most <= change.tolerance(), "{change:?}: {most:e}");
    }
}

#[test]
#[ignore = "the line leaves the circle where the fronts meet: what breaks the tie of a symmetric ring moves it"]
fn a_torus_does_not_know_where_its_seam_is() {
    let mesh = sweep(circle(10.0), round(1.5), [120, 24], Ends::Ring);
    check("torus", &mesh, Preset::Default, &changes());
}

#[test]
fn the_preset_paper_does_not_mind_either() {
    for kind in [Kind::Bifurcation, Kind::Aneurysm] {
        check(kind.name(), &phantom(kind, 7, Settings::of(kind)), Preset::Paper, &changes());
    }
}

#[test]
fn any_number_of_threads_and_any_run_gives_the_same_bits() {
    // A ring, and a tree whose joints go side by side.
    for (kind, preset) in
        [(Kind::Loop, Preset::Default), (Kind::Loop, Preset::Paper), (Kind::Bigtree, Preset::Default)]
    {
        let voxel = if kind == Kind::Bigtree { 1.5 * kind.voxel() } else { kind.voxel() };
        let mesh = phantom(kind, 3, Settings { voxel, ..Settings::of(kind) });
        let with = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| extracted(&mesh, preset).unwrap())
        };
        let first = with(1);
        for threads in [1, 2, 4] {
            assert_eq!(first, with(threads), "{kind}, {preset} on {threads} threads");
        }
    }
}

fn any_change() -> impl Strategy<Value = Change> {
    let axis = || (-1.0..1.0, -1.0..1.0, -1.0..1.0).prop_map(|(x, y, z)| Vector3::<f64>::new(x, y, z));
    prop_oneof![
        (-3.0..3.0).prop_map(|exponent| Change::Scaled(10.0_f64.powf(exponent))),
        (axis(), axis()).prop_map(|(shift, turn)| Change::Moved(Isometry3::new(shift * 1e3, turn * 3.0))),
        any::<u64>().prop_map(Change::Shuffled),
    ]
}

proptest! {
    // The same cases in every run: a vessel on the edge of a decision is a fault to mend, not luck.
    #![proptest_config(ProptestConfig {
        cases: 16,
        rng_seed: RngSeed::Fixed(11),
        failure_persistence: None,
        ..ProptestConfig::default()
    })]

    #[test]
    fn no_change_of_frame_moves_the_line_of_any_vessel(
        kind in prop::sample::select(vec![Kind::Tube, Kind::Bifurcation, Kind::Loop, Kind::Aneurysm]),
        seed in 1_u64..1000,
        open in any::<bool>(),
        change in any_change(),
    ) {
        let mesh = phantom(kind, seed, Settings { open, ..Settings::of(kind) });
        let before = line_of(&mesh);
        let after = change.undone(line_of(&change.of(&mesh)));
        let far = apart(&before, &after) / before.surface.diagonal;
        prop_assert!(far <= change.tolerance(), "{far:e} diagonals");
    }
}
