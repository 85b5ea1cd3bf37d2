//! The real service over real sockets, with real faults.
#![allow(clippy::unwrap_used, reason = "tests")]

#[path = "../common/mod.rs"]
mod common;
#[path = "../common/gltf_checker.rs"]
mod gltf_checker;
#[path = "../common/meshes.rs"]
mod meshes;
#[path = "../common/service.rs"]
mod service;

mod busy;
mod changes;
mod deletion;
mod listing;
mod refusals;
mod resend;
mod restarts;
mod results;
mod setup;
mod shared_meshes;
mod stalls;
mod submission;
mod uploads;
