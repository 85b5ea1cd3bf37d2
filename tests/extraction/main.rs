//! What the method promises whatever the mesh: tested against closed forms, on defects, and by properties.
#![allow(clippy::unwrap_used, reason = "tests")]

mod closed_forms;
mod invariance;
mod lines;
mod surfaces;
