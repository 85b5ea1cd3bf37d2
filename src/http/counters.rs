//! What is counted of requests, for `/metrics`.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use super::exposition::Exposition;
use crate::jobs::Histogram;

/// Upper bounds of the buckets of request times, seconds.
const BOUNDS: [f64; 8] = [0.001, 0.005, 0.02, 0.1, 0.5, 2.0, 10.0, 60.0];

/// Method, route and status of a request: few, since none is the client's text.
type Label = (&'static str, String, u16);

/// Counters; clones share them.
#[derive(Clone, Default)]
pub struct Counters(Arc<Inner>);

#[derive(Default)]
struct Inner {
    requests: Mutex<BTreeMap<Label, u64>>,
    times: Mutex<BTreeMap<String, Histogram>>,
    received: AtomicU64,
    uploaded: AtomicU64,
    results: AtomicU64,
}

/// Lines of the log that could not be written, or not in time; clones share the count.
#[derive(Debug, Clone, Default)]
pub struct LostLines(Arc<AtomicU64>);

impl LostLines {
    /// One more.
    pub fn add(&self) {
        self.0.fetch_add(1, Ordering::Relaxed);
    }

    pub fn count(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }
}

impl Counters {
    pub(super) fn request(&self, method: &'static str, route: &str, status: u16, took: Duration) {
        let mut requests = self.0.requests.lock().unwrap_or_else(PoisonError::into_inner);
        *requests.entry((method, route.to_owned(), status)).or_default() += 1;
        drop(requests);
        let mut times = self.0.times.lock().unwrap_or_else(PoisonError::into_inner);
        times.entry(route.to_owned()).or_insert_with(|| Histogram::new(&BOUNDS)).add(took);
    }

    /// Bytes of a mesh came in, whatever becomes of it.
    pub(super) fn received(&self, bytes: usize) {
        self.0.received.fetch_add(bytes as u64, Ordering::Relaxed);
    }

    /// A mesh of these bytes became a job.
    pub(super) fn uploaded(&self, bytes: u64) {
        self.0.uploaded.fetch_add(bytes, Ordering::Relaxed);
    }

    /// Bytes of a result went out.
    pub(super) fn sent(&self, bytes: usize) {
        self.0.results.fetch_add(bytes as u64, Ordering::Relaxed);
    }

    pub(super) fn write(&self, text: &mut Exposition) {
        text.counter("http_requests_total", "Requests that were answered.");
        let requests = self.0.requests.lock().unwrap_or_else(PoisonError::into_inner).clone();
        for ((method, route, status), count) in requests {
            text.sample(&[("method", method), ("route", &route), ("status", &status.to_string())], count);
        }
        text.histogram("http_request_seconds", "Time until an answer began.");
        let times = self.0.times.lock().unwrap_or_else(PoisonError::into_inner).clone();
        for (route, times) in times {
            text.times(&[("route", &route)], &times);
        }
        for (name, help, count) in [
            ("received_bytes_total", "Bytes of meshes that came in, also of refused ones.", &self.0.received),
            ("upload_bytes_total", "Bytes of the meshes that became jobs.", &self.0.uploaded),
            ("result_bytes_total", "Bytes of results that went out.", &self.0.results),
        ] {
            text.counter(name, help);
            text.sample(&[], count.load(Ordering::Relaxed));
        }
    }
}
