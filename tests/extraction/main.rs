//! What the method promises whatever the mesh: tested against closed forms, on defects, and by properties.
#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

mod cancellation;
mod closed_forms;
mod cuts;
mod defects;
mod focal;
mod invariance;
mod known_ends;
mod lines;
mod picks;
mod properties;
mod sacs;
mod sections;
mod surfaces;
mod topology;
