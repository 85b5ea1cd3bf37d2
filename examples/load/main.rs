//! Load on the real service in release mode; `scripts/load` builds both and runs this.
//!
//!     load status [CLIENTS] [SECONDS]    polls of jobs, first with idle workers, then with busy ones
//!     load uploads [CLIENTS] [RINGS]     meshes of 1000 × RINGS vertices posted at the same time; peak memory
//!     load mix [CLIENTS] [SECONDS]       uploads, polls, downloads, cancels, slow and broken connections at once
//!     load upload [RINGS]                one mesh of 500 × RINGS vertices to its 201, beside a file that is synced
//!     load beside [LARGE] [RINGS]        dry runs of a small mesh beside none to LARGE of 1000 × RINGS vertices
//!     load jobs [JOBS] [CLIENTS]         small jobs to their end, beside the same work in a loop; memory
#![allow(clippy::unwrap_used, clippy::panic, reason = "a tool for developers")]

use std::time::Duration;

mod beside;
mod jobs;
#[path = "../../tests/common/meshes.rs"]
#[allow(dead_code, reason = "shared with the tests, which use all of it")]
mod meshes;
#[path = "../../tests/common/mix.rs"]
mod mix;
mod mixed;
mod service;
mod status;
mod upload;
mod uploads;
#[path = "../../tests/common/wire.rs"]
mod wire;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let number =
        |place: usize, default: u32| arguments.get(place).map_or(default, |text| text.parse().unwrap());
    match arguments.first().map(String::as_str) {
        Some("status") => status::run(number(1, 64), Duration::from_secs(number(2, 10).into())),
        Some("uploads") => uploads::run(number(1, 8), number(2, 1000)),
        Some("mix") => mixed::run(number(1, 200), Duration::from_secs(number(2, 300).into())),
        Some("upload") => upload::run(number(1, 1000)),
        Some("beside") => beside::run(number(1, 2), number(2, 1000)),
        Some("jobs") => jobs::run(number(1, 1000), number(2, 16)),
        _ => println!("load status|uploads|mix|upload|beside|jobs, with numbers as in examples/load/main.rs"),
    }
}

/// Binary STL of an open tube along a quarter of a circle.
fn tube_stl(rings: u32, sides: u32) -> Vec<u8> {
    meshes::stl(&meshes::tube(rings, sides))
}
