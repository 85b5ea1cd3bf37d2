//! The kept inputs of the fuzz targets (`scripts/fuzz`), each as it is and damaged in a way that a seed decides.
#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use rosaline::mesh::TriangleMesh;
use rosaline::mesh::format::{Format, write_stl_binary};
use rosaline::phantom::{Kind, Settings, generate};

#[path = "common/damage.rs"]
mod damage;
#[path = "../fuzz/harness/mod.rs"]
mod harness;

use damage::Random;

/// What one input may take, and far more than that on a busy machine.
const LONGEST: Duration = Duration::from_secs(60);

fn folder(target: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/corpus").join(target)
}

/// Replays a target's corpus, and each input damaged so many times.
fn replay(target: &str, damages: usize, run: impl Fn(&[u8])) {
    let mut files: Vec<_> =
        std::fs::read_dir(folder(target)).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.sort();
    assert!(!files.is_empty(), "{target} has no corpus");
    for file in files {
        let bytes = std::fs::read(&file).unwrap();
        let mut random = Random(bytes.len() as u64);
        for number in 0..=damages {
            let mut input = bytes.clone();
            if number > 0 {
                random.damage(&mut input);
            }
            let begin = Instant::now();
            run(&input);
            assert!(begin.elapsed() < LONGEST, "{}, damage {number}: {:?}", file.display(), begin.elapsed());
        }
    }
}

#[test]
fn readers_stand_their_corpus() {
    for (target, format) in [
        ("stl_binary", Format::StlBinary),
        ("stl_ascii", Format::StlAscii),
        ("obj", Format::Obj),
        ("ply", Format::Ply),
        ("gltf", Format::Gltf),
        ("glb", Format::Glb),
        ("vtp", Format::Vtp),
        ("vtk", Format::Vtk),
        ("off", Format::Off),
    ] {
        replay(target, 20, |bytes| harness::reader(format, bytes));
    }
    replay("read", 20, harness::read);
}

#[test]
fn parameters_stand_their_corpus() {
    replay("parameters", 50, harness::parameters);
}

#[test]
fn the_method_stands_its_corpus() {
    replay("extract", 2, harness::extract);
}

/// Writes the first inputs of `extract`, `parameters` and `stl_binary`, from the project's phantoms and writers:
/// `cargo test --test fuzz_corpus -- --ignored`.
#[test]
#[ignore = "writes into fuzz/corpus"]
fn seeds() {
    for (number, kind) in Kind::ALL.into_iter().enumerate() {
        let settings = Settings { voxel: 4.0 * kind.voxel(), open: number % 2 == 0, ..Settings::of(kind) };
        let Ok(phantom) = generate(kind, 1, &settings) else { continue };
        println!("{kind}: {} vertices", phantom.mesh.vertices.len());
        if phantom.mesh.vertices.len() > 1000 {
            continue;
        }
        for choice in [0, 4, 8 | 16, 32 | 64] {
            keep("extract", &format!("{kind}-{choice}"), &harness::Case::encode(&phantom.mesh, choice));
        }
    }
    let mut stl = Vec::new();
    write_stl_binary(&tetrahedron(), &mut stl).unwrap();
    keep("stl_binary", "tetrahedron", &stl);
    keep("read", "stl", &[&[0], &stl[..]].concat());
    keep("extract", "tetrahedron", &harness::Case::encode(&tetrahedron(), 0));
    let json =
        br#" {"units": "mm", "preset": "paper", "omega": 0.8, "smoothing": true, "include": ["1,2,3"]}"#;
    keep("parameters", "form", json);
    let query = "!units=cm&preset=paper&mu=0.5&exclude=1,2,3&exclude=4,5,6&name=a%20b.stl&client_reference=x\
                 &priority=urgent&dry_run=true";
    keep("parameters", "query", query.as_bytes());
}

fn tetrahedron() -> TriangleMesh {
    TriangleMesh {
        vertices: [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
            .map(Into::into)
            .to_vec(),
        triangles: vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
    }
}

fn keep(target: &str, name: &str, bytes: &[u8]) {
    std::fs::create_dir_all(folder(target)).unwrap();
    std::fs::write(folder(target).join(name), bytes).unwrap();
}
