//! How much work one extraction is, in numbers that no other program on the machine changes.
//!
//! Seconds say little on a shared machine. Allocations are the same each time; so are instructions, but for a few
//! of the start, where valgrind is there to count them. Either may grow by a quarter before a test fails. Who makes
//! the method do more on purpose, or less, writes the new number here.
#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

use std::fs::{self, File};
use std::io::BufWriter;
use std::process::Command;

use rosaline::centerline::{Control, Parameters, extract};
use rosaline::mesh::format::write_stl_binary;
use rosaline::phantom::{Kind, Phantom, Settings, generate};

/// As measured when they were written here.
const ALLOCATIONS: u64 = 11_953;
/// The most that were held at once.
const BYTES: u64 = 866_425;
const INSTRUCTIONS: u64 = 161_671_124;

fn bifurcation() -> Phantom {
    let settings = Settings { voxel: 1.2, ..Settings::of(Kind::Bifurcation) };
    generate(Kind::Bifurcation, 7, &settings).unwrap()
}

#[track_caller]
fn no_more_than_a_quarter_above(known: u64, found: u64, what: &str) {
    println!("{found} {what}, {known} known");
    assert!(4 * found <= 5 * known, "{found} {what} where there were {known}");
}

#[test]
fn an_extraction_allocates_no_more_than_it_did() {
    let mesh = bifurcation().mesh;
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    // Counted by thread: the pool's only one does all the work. The first time makes what stays.
    let count = || {
        allocation_counter::measure(|| {
            extract(&mesh, &Parameters::default(), &Control::silent()).unwrap();
        })
    };
    pool.install(count);
    let found = pool.install(count);
    no_more_than_a_quarter_above(ALLOCATIONS, found.count_total, "allocations");
    no_more_than_a_quarter_above(BYTES, found.bytes_max, "bytes at once");
}

#[test]
fn an_extraction_takes_no_more_instructions_than_it_did() {
    let folder = tempfile::tempdir().unwrap();
    let mesh = folder.path().join("vessel.stl");
    write_stl_binary(&bifurcation().mesh, &mut BufWriter::new(File::create(&mesh).unwrap())).unwrap();
    let run = Command::new("valgrind")
        .args(["--tool=callgrind", "--callgrind-out-file=/dev/null", env!("CARGO_BIN_EXE_rosaline")])
        .args(["extract", "vessel.stl", "-o", "line.json", "--threads", "1"])
        .current_dir(folder.path())
        .output();
    let Ok(run) = run else {
        println!("valgrind is not here: instructions were not counted");
        return;
    };
    let told = String::from_utf8_lossy(&run.stderr);
    assert!(run.status.success(), "{told}");
    assert!(fs::metadata(folder.path().join("line.json")).unwrap().len() > 0);
    let line = told.lines().find_map(|line| line.split_once("Collected : ")).unwrap().1;
    no_more_than_a_quarter_above(INSTRUCTIONS, line.trim().parse().unwrap(), "instructions");
}
