//! What an extraction costs against what nobody can do without: reading and welding the file, and one run of
//! Dijkstra's algorithm over the mesh. All three in one process, of a phantom of 93,000 vertices.
//!
//! `cargo bench --bench reference`
#![allow(clippy::panic, reason = "a bench")]

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::hint::black_box;
use std::time::Duration;

use criterion::{Criterion, SamplingMode, criterion_group, criterion_main};
use rosaline::centerline::{Control, Parameters, extract};
use rosaline::mesh::TriangleMesh;
use rosaline::mesh::format::{Hint, Limits, read, write_stl_binary};
use rosaline::phantom::{Kind, Settings, generate};

/// Distance over the edges from vertex 0 to each: the textbook's, with edges in compressed rows.
fn dijkstra(mesh: &TriangleMesh) -> Vec<f64> {
    // On a closed surface each edge is in two triangles, once in either direction.
    let edges = || mesh.triangles.iter().flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a)]);
    let mut start = vec![0_usize; mesh.vertices.len() + 1];
    edges().for_each(|(from, _)| start[from as usize + 1] += 1);
    (1..start.len()).for_each(|v| start[v] += start[v - 1]);
    let mut links = vec![(0_u32, 0.0_f64); start[start.len() - 1]];
    let mut next = start.clone();
    for (from, to) in edges() {
        let length = (mesh.vertices[to as usize] - mesh.vertices[from as usize]).norm();
        links[next[from as usize]] = (to, length);
        next[from as usize] += 1;
    }
    let mut distance = vec![f64::INFINITY; mesh.vertices.len()];
    distance[0] = 0.0;
    // Non-negative doubles sort like their bits.
    let mut heap = BinaryHeap::from([Reverse((0_u64, 0_u32))]);
    while let Some(Reverse((bits, v))) = heap.pop() {
        let reached = f64::from_bits(bits);
        if reached > distance[v as usize] {
            continue;
        }
        for &(to, length) in &links[start[v as usize]..start[v as usize + 1]] {
            if reached + length < distance[to as usize] {
                distance[to as usize] = reached + length;
                heap.push(Reverse(((reached + length).to_bits(), to)));
            }
        }
    }
    distance
}

fn reference(criterion: &mut Criterion) {
    let mesh = match generate(Kind::Bigtree, 7, &Settings::of(Kind::Bigtree)) {
        Ok(phantom) => phantom.mesh,
        Err(error) => panic!("no phantom: {error}"),
    };
    let mut bytes = Vec::new();
    // A vector takes everything.
    let _ = write_stl_binary(&mesh, &mut bytes);
    let mut group = criterion.benchmark_group("reference");
    group.sampling_mode(SamplingMode::Flat).sample_size(10);
    group.warm_up_time(Duration::from_secs(1)).measurement_time(Duration::from_secs(5));
    group.bench_function("read", |bencher| {
        bencher.iter(|| read(black_box(&bytes), Hint::default(), &Limits::default()));
    });
    group.bench_function("dijkstra", |bencher| bencher.iter(|| dijkstra(black_box(&mesh))));
    group.bench_function("extract", |bencher| {
        bencher.iter(|| extract(black_box(&mesh), &Parameters::default(), &Control::silent()));
    });
    group.finish();
}

criterion_group!(benches, reference);
criterion_main!(benches);
