//! What holds of every result, over vessels of any seed.

use std::sync::Mutex;

use nalgebra::Point3;
use proptest::prelude::*;
use proptest::test_runner::RngSeed;
use rosaline::centerline::{CancelToken, Control, NodeKind, Parameters, Preset, Progress, Stage, extract};
use rosaline::mesh::TriangleMesh;
use rosaline::phantom::{Kind, Settings, generate};

use crate::lines::*;

/// Solid angle of the surface seen from a point over 4 pi: 1 inside, 0 outside (van Oosterom and Strackee 1983).
fn winding(mesh: &TriangleMesh, point: &Point3<f64>) -> f64 {
    let angle = |triangle: &[u32; 3]| {
        let [a, b, c] = triangle.map(|v| mesh.vertices[v as usize] - point);
        let (x, y, z) = (a.norm(), b.norm(), c.norm());
        let below = x * y * z + a.dot(&b) * z + b.dot(&c) * x + c.dot(&a) * y;
        2.0 * a.dot(&b.cross(&c)).atan2(below)
    };
    mesh.triangles.iter().map(angle).sum::<f64>() / (4.0 * std::f64::consts::PI)
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 16,
        rng_seed: RngSeed::Fixed(5),
        failure_persistence: None,
        ..ProptestConfig::default()
    })]

    #[test]
    fn every_result_is_a_sound_graph_inside_the_lumen(
        kind in prop::sample::select(vec![
            Kind::Tube, Kind::Bifurcation, Kind::Loop, Kind::Stenosis, Kind::Aneurysm, Kind::Parallel,
        ]),
        seed in 1_u64..1000,
        stair in any::<bool>(),
    ) {
        let phantom = generate(kind, seed, &Settings { stair, ..Settings::of(kind) }).unwrap();
        let found = line_of(&phantom.mesh);
        prop_assert_eq!(&found, &line_of(&phantom.mesh), "another run");
        let line = &found.centerline;
        prop_assert_eq!(parts_and_loops(line), (found.surface.components, found.surface.genus));
        let quality = found.quality.unwrap();
        prop_assert!(quality.homotopy.equal && quality.thinness, "{:?}", quality);
        prop_assert!(quality.inside >= 0.999 && quality.coverage > 0.99, "{:?}", quality);
        prop_assert!(quality.centeredness.mean.unwrap() < 0.06, "{:?}", quality);
        for (index, node) in line.nodes.iter().enumerate() {
            prop_assert_eq!(node.kind == NodeKind::End, line.degree(index) == 1, "node {}", index);
            prop_assert!(node.radius.is_finite() && node.radius > 0.0);
        }
        for branch in &line.branches {
            prop_assert_eq!(branch.points.len(), branch.radii.len());
            prop_assert_eq!(branch.points[0], line.nodes[branch.from].position);
            prop_assert_eq!(branch.points[branch.points.len() - 1], line.nodes[branch.to].position);
            prop_assert!(branch.radii.iter().all(|radius| radius.is_finite() && *radius > 0.0));
            prop_assert!(branch.points.windows(2).all(|pair| pair[0] != pair[1]), "a step of no length");
            // Ends lie on the wall itself.
            let inner = &branch.points[1..branch.points.len() - 1];
            for point in inner.iter().step_by(4) {
                prop_assert!(winding(&phantom.mesh, point) > 0.5, "{} is outside", point);
            }
        }
    }
}

/// The stages and fractions that a preset tells of one vessel: in range and never falling.
fn told(preset: Preset) -> Vec<(Stage, f64)> {
    let mesh = generate(Kind::Loop, 2, &Settings::of(Kind::Loop)).unwrap().mesh;
    let told = Mutex::new(Vec::new());
    let hear = |progress: Progress| told.lock().unwrap().push((progress.stage, progress.fraction));
    extract(&mesh, &Parameters::of(preset), &Control::new(CancelToken::new(), &hear)).unwrap();
    let told = told.into_inner().unwrap();
    assert!(told.iter().all(|(_, fraction)| (0.0..=1.0).contains(fraction)), "{told:?}");
    assert!(told.windows(2).all(|pair| pair[0] <= pair[1]), "{told:?}");
    told
}

#[test]
fn progress_never_falls() {
    assert!(told(Preset::Default).len() > 5);
}

#[test]
fn progress_ends_at_one() {
    assert_eq!(told(Preset::Default).last(), Some(&(Stage::Connection, 1.0)));
}

#[test]
fn progress_of_the_paper_never_falls_and_ends_at_one() {
    assert_eq!(told(Preset::Paper).last(), Some(&(Stage::Connection, 1.0)));
}
