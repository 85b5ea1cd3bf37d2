//! Files that lie, are cut or are damaged: always a typed error or a sound mesh, in bounded time
//! and memory. One test, alone in its process, so that the process's memory is that of the readers.
#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

use std::panic;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use rosaline::mesh::format::{Hint, Limits, ReadErrorKind, read};

#[path = "common/damage.rs"]
mod damage;

use damage::Random;

/// Kibibytes of address space that may be taken beyond what two readings of good files took: room
/// for heaps to grow, and far below the gigabytes that the files declare.
const MOST_MEMORY: u64 = 128 * 1024;

const MUTATIONS_PER_FILE: u64 = 1500;

static PANICS: AtomicUsize = AtomicUsize::new(0);

fn peers() -> Vec<(PathBuf, Vec<u8>)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/peers");
    let mut files: Vec<_> = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.retain(|path| path.extension().is_some_and(|extension| extension != "py"));
    files.sort();
    files.into_iter().map(|path| (path.clone(), std::fs::read(path).unwrap())).collect()
}

/// The most address space that the process ever had, in KiB; `None` where the system does not tell.
fn peak_memory() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmPeak:"))?;
    line.split_whitespace().nth(1)?.parse().ok()
}

/// Reads with the extension as a hint, and checks what every reader promises.
fn try_read(path: &Path, bytes: &[u8]) -> Option<ReadErrorKind> {
    let hint =
        Hint { extension: path.extension().and_then(|extension| extension.to_str()), content_type: None };
    let began = Instant::now();
    let result = read(bytes, hint, &Limits::default());
    assert!(began.elapsed() < Duration::from_secs(5), "{}: {:?}", path.display(), began.elapsed());
    match result {
        Ok((mesh, _)) => {
            let vertices = mesh.vertices.len();
            assert!(!mesh.triangles.is_empty());
            assert!(mesh.triangles.iter().flatten().all(|&index| (index as usize) < vertices));
            assert!(mesh.vertices.iter().all(|vertex| vertex.iter().all(|number| number.is_finite())));
            None
        }
        Err(error) => {
            let text = error.to_string();
            assert!(text.len() < 400 && text.is_ascii(), "{text}");
            Some(error.kind())
        }
    }
}

fn cut_everywhere(path: &Path, bytes: &[u8]) {
    for length in (0..bytes.len()).step_by(bytes.len().div_ceil(300)) {
        let kind = try_read(path, &bytes[..length]);
        assert!(length > 0 || kind == Some(ReadErrorKind::Empty));
    }
}

/// Small files that declare a gigabyte and more, each with the kinds of error it may get.
fn liars() -> Vec<(&'static str, Vec<u8>)> {
    let stl = |count: u32| [&[0; 80][..], &count.to_le_bytes(), &[0; 120]].concat();
    let ply = |encoding: &str, elements: &str| {
        format!("ply\nformat {encoding} 1.0\n{elements}end_header\n0 0 0\n0 0 0\n").into_bytes()
    };
    let xyz = "property float x\nproperty float y\nproperty float z\n";
    let list = "property list int int vertex_indices\n";
    let glb = |length: u32| {
        [b"glTF\x02\0\0\0".as_slice(), &length.to_le_bytes(), &length.to_le_bytes(), b"JSON{}"].concat()
    };
    let gltf = |buffer: &str, accessor: &str| {
        format!("{{\"asset\":{{\"version\":\"2.0\"}},\"buffers\":[{{{buffer}}}],\"bufferViews\":[{{\"buffer\":0,\"byteLength\":1000000000}}],\"accessors\":[{{{accessor},\"componentType\":5126,\"type\":\"VEC3\"}}],\"meshes\":[{{\"primitives\":[{{\"attributes\":{{\"POSITION\":0}}}}]}}]}}").into_bytes()
    };
    vec![
        ("stl", stl(20_000_000)),
        ("stl", stl(u32::MAX)),
        ("ply", ply("ascii", &format!("element vertex 20000000\n{xyz}"))),
        ("ply", ply("binary_little_endian", &format!("element vertex 20000000\n{xyz}"))),
        (
            "ply",
            ply("ascii", &format!("element vertex 1\n{xyz}element face 1\n{list}"))
                .into_iter()
                .chain(*b"1000000000 1")
                .collect(),
        ),
        ("ply", ply("binary_big_endian", &format!("element vertex 0\n{xyz}element face 1\n{list}"))),
        ("ply", ply("ascii", "element nothing 4000000000\n")),
        ("off", b"OFF\n20000000 40000000 0\n0 0 0\n".to_vec()),
        ("off", b"OFF\n1 1 0\n0 0 0\n1000000000 0 0\n".to_vec()),
        ("obj", b"v 0 0 0\nf 1000000000 1 1\n".to_vec()),
        ("glb", glb(1_000_000_000)),
        ("glb", glb(u32::MAX)),
        ("gltf", gltf("\"byteLength\":1000000000", "\"bufferView\":0,\"count\":20000000")),
        ("gltf", gltf("\"byteLength\":0", "\"count\":20000000")),
        (
            "gltf",
            gltf(
                "\"byteLength\":1000000000,\"uri\":\"data:;base64,AAAA\"",
                "\"bufferView\":0,\"count\":20000000",
            ),
        ),
    ]
}

/// The same of VTK's formats.
fn vtk_liars() -> Vec<(&'static str, Vec<u8>)> {
    let vtk = |kind: &str, section: &str| {
        format!("# vtk DataFile Version 5.1\n\n{kind}\nDATASET POLYDATA\n{section}\n0 0 0 0 0 0 0 0\n")
            .into_bytes()
    };
    let vtp = |attributes: &str, array: &str| {
        format!("<VTKFile type=\"PolyData\" {attributes}><PolyData><Piece NumberOfPoints=\"20000000\" NumberOfPolys=\"20000000\"><Points><DataArray type=\"Float64\" {array}</DataArray></Points></Piece></PolyData></VTKFile>").into_bytes()
    };
    vec![
        ("vtk", vtk("ASCII", "POINTS 20000000 double")),
        ("vtk", vtk("BINARY", "POINTS 20000000 double")),
        ("vtk", vtk("BINARY", "POLYGONS 20000000 1000000000\nOFFSETS vtktypeint64")),
        ("vtk", vtk("ASCII", "LINES 20000000 1000000000\nOFFSETS vtktypeint64")),
        ("vtp", vtp("", "format=\"ascii\">0 0 0")),
        ("vtp", vtp("", "format=\"binary\">AAAAQAAAAAA=")),
        ("vtp", vtp("header_type=\"UInt64\"", "format=\"binary\">////////////////////AAAA")),
        (
            "vtp",
            vtp(
                "compressor=\"vtkZLibDataCompressor\"",
                "format=\"binary\">AQAAAAAAAEAAAAAACAAAAA==eJwDAAAAAAE=",
            ),
        ),
        (
            "vtp",
            vtp(
                "compressor=\"vtkZLibDataCompressor\"",
                "format=\"binary\">AAAAQAAAAEAAAAAACAAAAA==eJwDAAAAAAE=",
            ),
        ),
    ]
}

#[test]
fn hostile_files_are_answered_in_bounded_time_and_memory() {
    let report = panic::take_hook();
    // The glTF reader contains panics of its crate: they are counted here all the same.
    panic::set_hook(Box::new(move |info| {
        PANICS.fetch_add(1, Ordering::Relaxed);
        report(info);
    }));
    // One thread: each further one would take address space for a heap of its own.
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    pool.install(try_all);
    assert_eq!(PANICS.load(Ordering::Relaxed), 0);
}

fn try_all() {
    let files = peers();
    for (path, bytes) in files.iter().chain(&files) {
        try_read(path, bytes);
    }
    let memory = peak_memory();

    for (extension, bytes) in liars().into_iter().chain(vtk_liars()) {
        let path = PathBuf::from(format!("liar.{extension}"));
        assert!(try_read(&path, &bytes).is_some(), "{}", String::from_utf8_lossy(&bytes));
    }
    for (path, bytes) in &files {
        cut_everywhere(path, bytes);
        let mut random = Random(bytes.len() as u64);
        for _ in 0..MUTATIONS_PER_FILE {
            let mut damaged = bytes.clone();
            random.damage(&mut damaged);
            try_read(path, &damaged);
        }
    }

    match (memory, peak_memory()) {
        (Some(before), Some(after)) => assert!(after - before < MOST_MEMORY, "{} KiB", after - before),
        _ => println!("skipped: this system does not tell a process's memory"),
    }
}
