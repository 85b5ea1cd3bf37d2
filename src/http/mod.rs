//! The HTTP service: [`router`] is its table of contents, [`operations`] has one file an operation.
//!
//! Conventions and where they come from: jobs and their states from OGC API Processes, errors from RFC 9457,
//! waiting from RFC 7240, conditions, ranges and negotiation from RFC 9110. The async threads never compute:
//! meshes are checked on the threads of [`validation`], jobs run on the workers' pools.

pub mod access;
mod admission;
pub mod audit;
mod coding;
mod connections;
mod cors;
mod counters;
mod crowd;
mod digest;
pub mod document;
mod etag;
mod exposition;
mod host;
mod idempotency;
mod inspection;
pub mod limits;
mod lingering;
mod negotiation;
pub mod operations;
pub mod parameters;
mod prefer;
pub mod problem;
mod range;
mod representation;
pub mod router;
mod server;
mod state;
pub mod tls;
mod trace;
mod upload;
mod validation;

pub use counters::LostLines;
pub use limits::Limits;
pub use problem::Problem;
pub use server::serve;
pub use state::App;
pub use tls::Tls;
