//! `GET /metrics`

use std::fmt::Write;

use axum::extract::State;
use axum::http::header;
use axum::response::{IntoResponse, Response};

use super::super::document::{self, MetricsProblems};
use super::super::{App, Problem};
use crate::jobs::Load;

/// Prometheus' text format.
const MEDIA_TYPE: &str = "text/plain; version=0.0.4; charset=utf-8";

/// What the service does, for Prometheus
///
/// Jobs by state, the queue's age, workers, uploaded bytes, and requests by route and status with their times.
#[utoipa::path(
    get,
    path = "/metrics",
    operation_id = "getMetrics",
    tag = document::SERVICE,
    responses(document::Metrics, MetricsProblems)
)]
pub async fn metrics(State(app): State<App>) -> Result<Response, Problem> {
    let mut text = String::new();
    // Writing to a String does not fail.
    let _ = write_load(&mut text, &app.jobs().load().await?);
    app.counters().write(&mut text);
    Ok(([(header::CONTENT_TYPE, MEDIA_TYPE), (header::CACHE_CONTROL, "no-store")], text).into_response())
}

fn write_load(text: &mut String, load: &Load) -> std::fmt::Result {
    let counts = &load.counts;
    writeln!(text, "# HELP rosaline_jobs Jobs that are kept, by state.\n# TYPE rosaline_jobs gauge")?;
    for (state, jobs) in [
        ("accepted", counts.accepted),
        ("running", counts.running),
        ("successful", counts.successful),
        ("failed", counts.failed),
        ("dismissed", counts.dismissed),
    ] {
        writeln!(text, "rosaline_jobs{{state=\"{state}\"}} {jobs}")?;
    }
    for (name, help, value) in [
        ("queue_age_seconds", "How long the oldest waiting job has waited.", load.queue_age.as_secs_f64()),
        ("workers", "Jobs that may run at once.", load.workers as f64),
        ("workers_held", "Workers that wait for a run which does not stop.", load.held as f64),
    ] {
        writeln!(
            text,
            "# HELP rosaline_{name} {help}\n# TYPE rosaline_{name} gauge\nrosaline_{name} {value}"
        )?;
    }
    Ok(())
}
