//! A cancelled extraction ends at once, whenever it was cancelled.

use std::time::{Duration, Instant};

use rosaline::centerline::{CancelToken, Control, ExtractError, Parameters, Preset, extract};
use rosaline::mesh::TriangleMesh;
use rosaline::mesh::format::{Hint, Limits, read};
use rosaline::phantom::{Kind, Settings, generate};

/// The promise is 100 ms of an optimised build on a machine of its own; tests run beside each other and, by
/// default, hardly optimised.
const LIMIT: Duration = Duration::from_millis(if cfg!(debug_assertions) { 1000 } else { 100 });

/// The longest time from a cancellation to the end of the extraction, of cancellations at even moments.
fn longest_wait(mesh: &TriangleMesh, preset: Preset, moments: u32) -> Duration {
    let parameters = Parameters::of(preset);
    let run = |control: &Control<'_>| extract(mesh, &parameters, control).map(|_| ());
    let begin = Instant::now();
    run(&Control::silent()).unwrap();
    let whole = begin.elapsed();
    let wait = |moment: u32| {
        let cancel = CancelToken::new();
        let control = Control::new(cancel.clone(), &|_| ());
        std::thread::scope(|scope| {
            let asked = scope.spawn(move || {
                std::thread::sleep(whole * moment / moments);
                cancel.cancel();
                Instant::now()
            });
            let result = run(&control);
            let ended = Instant::now();
            let asked = asked.join().unwrap();
            // It may have been done before it was asked.
            assert!(result == Err(ExtractError::Cancelled) || ended <= asked + LIMIT, "{result:?}");
            ended.saturating_duration_since(asked)
        })
    };
    (0..moments).map(wait).max().unwrap_or_default()
}

#[test]
fn both_presets_obey_at_any_moment() {
    let mesh = generate(Kind::Tree, 2, &Settings::of(Kind::Tree)).unwrap().mesh;
    for preset in [Preset::Default, Preset::Paper] {
        let wait = longest_wait(&mesh, preset, 8);
        println!("{preset}: {wait:?}");
        assert!(wait < LIMIT, "{preset}: {wait:?}");
    }
}

#[test]
fn a_large_tree_obeys_at_any_moment() {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/phantoms/bigtree.stl");
    let Ok(bytes) = std::fs::read(path) else {
        println!("skipped: ../shared is not beside the project");
        return;
    };
    let (mesh, _) = read(&bytes, Hint::default(), &Limits::default()).unwrap();
    let share = if cfg!(debug_assertions) { 4 } else { 1 };
    for (preset, moments) in [(Preset::Default, 24 / share), (Preset::Paper, 8 / share)] {
        let wait = longest_wait(&mesh, preset, moments);
        println!("bigtree {preset}: {wait:?}");
        assert!(wait < LIMIT, "{preset}: {wait:?}");
    }
}
