//! What is counted of requests, for `/metrics`.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// Upper bounds of the buckets of request times, seconds.
const BUCKETS: [f64; 8] = [0.001, 0.005, 0.02, 0.1, 0.5, 2.0, 10.0, 60.0];

/// Method, route and status of a request: few, since none is the client's text.
type Label = (&'static str, String, u16);

/// Counters; clones share them.
#[derive(Clone, Default)]
pub struct Counters(Arc<Inner>);

#[derive(Default)]
struct Inner {
    requests: Mutex<BTreeMap<Label, u64>>,
    times: Mutex<BTreeMap<String, Times>>,
    uploaded: AtomicU64,
}

#[derive(Default)]
struct Times {
    /// Requests that took no longer than each of [`BUCKETS`], not counted in the one before.
    buckets: [u64; BUCKETS.len()],
    count: u64,
    seconds: f64,
}

impl Counters {
    pub(super) fn request(&self, method: &'static str, route: &str, status: u16, took: Duration) {
        let mut requests = self.0.requests.lock().unwrap_or_else(PoisonError::into_inner);
        *requests.entry((method, route.to_owned(), status)).or_default() += 1;
        drop(requests);
        let mut times = self.0.times.lock().unwrap_or_else(PoisonError::into_inner);
        let times = times.entry(route.to_owned()).or_default();
        let seconds = took.as_secs_f64();
        if let Some(bucket) = BUCKETS.iter().position(|bound| seconds <= *bound) {
            times.buckets[bucket] += 1;
        }
        times.count += 1;
        times.seconds += seconds;
    }

    pub(super) fn uploaded(&self, bytes: u64) {
        self.0.uploaded.fetch_add(bytes, Ordering::Relaxed);
    }

    /// The counters in the text format of Prometheus.
    pub(super) fn write(&self, text: &mut String) {
        // Writing to a String does not fail.
        let _ = self.try_write(text);
    }

    fn try_write(&self, text: &mut String) -> std::fmt::Result {
        writeln!(text, "# HELP rosaline_http_requests_total Requests that were answered.")?;
        writeln!(text, "# TYPE rosaline_http_requests_total counter")?;
        for ((method, route, status), count) in
            self.0.requests.lock().unwrap_or_else(PoisonError::into_inner).iter()
        {
            let labels = format!("method=\"{method}\",route=\"{route}\",status=\"{status}\"");
            writeln!(text, "rosaline_http_requests_total{{{labels}}} {count}")?;
        }
        writeln!(text, "# HELP rosaline_http_request_seconds Time until an answer began.")?;
        writeln!(text, "# TYPE rosaline_http_request_seconds histogram")?;
        for (route, times) in self.0.times.lock().unwrap_or_else(PoisonError::into_inner).iter() {
            let mut sum = 0;
            for (bound, count) in BUCKETS.iter().zip(times.buckets) {
                sum += count;
                let labels = format!("route=\"{route}\",le=\"{bound}\"");
                writeln!(text, "rosaline_http_request_seconds_bucket{{{labels}}} {sum}")?;
            }
            let count = times.count;
            writeln!(text, "rosaline_http_request_seconds_bucket{{route=\"{route}\",le=\"+Inf\"}} {count}")?;
            writeln!(text, "rosaline_http_request_seconds_sum{{route=\"{route}\"}} {}", times.seconds)?;
            writeln!(text, "rosaline_http_request_seconds_count{{route=\"{route}\"}} {count}")?;
        }
        writeln!(text, "# HELP rosaline_upload_bytes_total Bytes of the meshes that became jobs.")?;
        writeln!(text, "# TYPE rosaline_upload_bytes_total counter")?;
        writeln!(text, "rosaline_upload_bytes_total {}", self.0.uploaded.load(Ordering::Relaxed))
    }
}
