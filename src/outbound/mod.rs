//! Requests that the service itself sends: only to addresses that its operator set, never to one from a request.

mod client;
mod names;
pub mod webhooks;

pub use client::{Answer, Client, OutboundError, Url};
