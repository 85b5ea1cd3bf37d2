//! The time of each stage of an extraction: phantom trees of three sizes with the preset `default`, the smallest of
//! them with `paper`.
//!
//! `cargo bench --bench stages`; a stage's time is that from its first report to the next one's.
#![allow(clippy::panic, reason = "a bench")]

use std::sync::Mutex;
use std::time::{Duration, Instant};

use criterion::{BenchmarkId, Criterion, SamplingMode, Throughput, criterion_group, criterion_main};
use rosaline::centerline::{CancelToken, Control, Parameters, Preset, Progress, Stage, extract};
use rosaline::mesh::TriangleMesh;
use rosaline::phantom::{Kind, Settings, generate};

/// Sides of a voxel in mm; half the side makes four times the vertices.
const VOXELS: [f64; 3] = [0.8, 0.4, 0.2];

/// How long each stage took.
fn spent(mesh: &TriangleMesh, parameters: &Parameters) -> Vec<(Stage, Duration)> {
    let reports: Mutex<Vec<(Stage, Instant)>> = Mutex::default();
    let note = |progress: Progress| {
        if let Ok(mut reports) = reports.lock() {
            reports.push((progress.stage, Instant::now()));
        }
    };
    if let Err(error) = extract(mesh, parameters, &Control::new(CancelToken::new(), &note)) {
        panic!("no line: {error}");
    }
    let end = Instant::now();
    let reports = reports.into_inner().unwrap_or_default();
    let next = reports.iter().skip(1).map(|report| report.1).chain([end]);
    let times: Vec<_> = reports.iter().zip(next).map(|(&(stage, from), to)| (stage, to - from)).collect();
    let of = |stage| times.iter().filter(|time| time.0 == stage).map(|time| time.1).sum();
    Stage::ALL.map(|stage| (stage, of(stage))).to_vec()
}

fn stages(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("stages");
    group.sampling_mode(SamplingMode::Flat).sample_size(10);
    group.warm_up_time(Duration::from_millis(500)).measurement_time(Duration::from_secs(2));
    for voxel in VOXELS {
        let settings = Settings { voxel, ..Settings::of(Kind::Tree) };
        let mesh = match generate(Kind::Tree, 7, &settings) {
            Ok(phantom) => phantom.mesh,
            Err(error) => panic!("no phantom: {error}"),
        };
        let vertices = mesh.vertices.len();
        group.throughput(Throughput::Elements(vertices as u64));
        for preset in [Preset::Default, Preset::Paper] {
            if preset == Preset::Paper && voxel < VOXELS[0] {
                continue;
            }
            let parameters = Parameters::of(preset);
            let used = spent(&mesh, &parameters).into_iter().filter(|(_, time)| !time.is_zero());
            for (place, (stage, _)) in used.enumerate() {
                let id = BenchmarkId::new(format!("{}/{place}-{}", preset.name(), stage.name()), vertices);
                group.bench_with_input(id, &mesh, |bencher, mesh| {
                    let once = || {
                        let all = spent(mesh, &parameters);
                        all.into_iter()
                            .filter(|(other, _)| *other == stage)
                            .map(|(_, time)| time)
                            .sum::<Duration>()
                    };
                    bencher.iter_custom(|count| (0..count).map(|_| once()).sum());
                });
            }
        }
    }
    group.finish();
}

criterion_group!(benches, stages);
criterion_main!(benches);
