//! The whole extraction of a phantom tree, without reading and writing: both presets, three sizes.
//!
//! `cargo bench --bench extract`
#![allow(clippy::panic, reason = "a bench")]

use std::hint::black_box;
use std::time::Duration;

use criterion::{BenchmarkId, Criterion, SamplingMode, Throughput, criterion_group, criterion_main};
use rosaline::centerline::{Control, Parameters, Preset, extract};
use rosaline::phantom::{Kind, Settings, generate};

/// Sides of a voxel in mm; half the side makes four times the vertices.
const VOXELS: [f64; 3] = [0.8, 0.4, 0.2];

fn extraction(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("extract");
    group.sampling_mode(SamplingMode::Flat).sample_size(10);
    group.warm_up_time(Duration::from_secs(1)).measurement_time(Duration::from_secs(5));
    for voxel in VOXELS {
        let settings = Settings { voxel, ..Settings::of(Kind::Tree) };
        let mesh = match generate(Kind::Tree, 7, &settings) {
            Ok(phantom) => phantom.mesh,
            Err(error) => panic!("no phantom: {error}"),
        };
        let vertices = mesh.vertices.len();
        group.throughput(Throughput::Elements(vertices as u64));
        for preset in [Preset::Default, Preset::Paper] {
            let parameters = Parameters::of(preset);
            group.bench_with_input(BenchmarkId::new(preset.name(), vertices), &mesh, |bencher, mesh| {
                bencher.iter(|| extract(black_box(mesh), &parameters, &Control::silent()));
            });
        }
    }
    group.finish();
}

criterion_group!(benches, extraction);
criterion_main!(benches);
