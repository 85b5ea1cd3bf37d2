//! Rosaline turns the surface mesh of a blood vessel into its centerline.
//!
//! The method is that of Wei et al., *Centerline Extraction of Vasculature Mesh*,
//! IEEE Access 6 (2018), DOI 10.1109/ACCESS.2018.2802478; `docs/method.md` says where
//! the preset `default` departs from it and why.
//!
//! The rooms, from the inside out; each knows only those before it:
//! [`mesh`] (surfaces and their file formats), [`centerline`] (the method),
//! [`output`] (writers of results), [`phantom`] and [`compare`] (known truth and metrics),
//! [`jobs`] (the durable queue and its worker pool), [`outbound`] (requests that the service sends),
//! [`http`] and [`cli`] (the two doors).

pub mod centerline;
pub mod cli;
pub mod compare;
pub mod http;
pub mod jobs;
pub mod mesh;
pub mod outbound;
pub mod output;
pub mod phantom;

/// Compiles and runs the README's example.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
