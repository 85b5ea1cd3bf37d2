//! The real service over real sockets, with real faults.
#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

#[path = "../common/mod.rs"]
mod common;
#[path = "../common/gltf_checker.rs"]
mod gltf_checker;
#[path = "../common/issuer.rs"]
mod issuer;
#[path = "../common/meshes.rs"]
mod meshes;
#[path = "../common/mix.rs"]
mod mix;
#[path = "../common/receiver.rs"]
mod receiver;
#[path = "../common/service.rs"]
mod service;
#[path = "../common/small_disk.rs"]
mod small_disk;
#[path = "../common/wire.rs"]
mod wire;

mod admission;
mod bombs;
mod busy;
mod changes;
mod crowd;
mod damage;
mod deletion;
mod discovery;
mod displaced;
mod dry_run;
mod events;
#[cfg(debug_assertions)]
mod faults;
mod isolation;
mod issuer_file;
mod keys;
mod listing;
mod load;
mod log;
mod metrics;
mod operator_files;
mod readiness;
mod refusals;
mod resend;
mod restarts;
mod results;
mod retention;
mod setup;
mod shared_meshes;
mod soak;
mod stalls;
mod storage_faults;
mod submission;
mod tls;
mod tokens;
mod traces;
mod trail;
mod turns;
mod uploads;
mod webhook_targets;
mod webhooks;
