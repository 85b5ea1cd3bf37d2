//! `GET /metrics`

use axum::extract::State;
use axum::http::header;
use axum::response::{IntoResponse, Response};

use super::super::document::{self, MetricsProblems};
use super::super::exposition::{Exposition, MEDIA_TYPE};
use super::super::{App, Problem};
use crate::jobs::{DeliveryCounts, JobError, Load};

/// What the service does, for Prometheus
///
/// Jobs by state, the queue's age, workers and threads, the times of the method's stages by preset, bytes of meshes
/// and results, and requests by route and status with their times. Labels are never a client's text.
#[utoipa::path(
    get,
    path = "/metrics",
    operation_id = "getMetrics",
    tag = document::SERVICE,
    responses(document::Metrics, MetricsProblems)
)]
pub async fn metrics(State(app): State<App>) -> Result<Response, Problem> {
    let mut text = Exposition::default();
    write_load(&mut text, &app.jobs().load().await?);
    write_deliveries(&mut text, app.jobs().delivery_counts().await.map_err(JobError::from)?);
    write_warnings(&mut text, &app);
    app.counters().write(&mut text);
    let headers = [(header::CONTENT_TYPE, MEDIA_TYPE), (header::CACHE_CONTROL, "no-store")];
    Ok((headers, text.into_text()).into_response())
}

fn write_load(text: &mut Exposition, load: &Load) {
    let counts = &load.counts;
    text.gauge("jobs", "Jobs that are kept, by state.");
    for (state, jobs) in [
        ("accepted", counts.accepted),
        ("running", counts.running),
        ("successful", counts.successful),
        ("failed", counts.failed),
        ("dismissed", counts.dismissed),
    ] {
        text.sample(&[("state", state)], jobs);
    }
    text.counter("jobs_ended_total", "Jobs that ended since the start, by how.");
    for (state, jobs) in &load.ends {
        text.sample(&[("state", state.name())], jobs);
    }
    for (name, help, value) in [
        ("queue_age_seconds", "How long the oldest waiting job has waited.", load.queue_age.as_secs_f64()),
        ("workers", "Jobs that may run at once.", load.workers as f64),
        ("workers_busy", "Workers whose run goes on.", load.busy as f64),
        ("workers_held", "Workers that wait for a run which does not stop.", load.held as f64),
        ("threads", "Threads that compute, over all workers.", load.threads as f64),
        ("threads_busy", "Those of them that a run has.", load.busy_threads as f64),
        ("run_processes_resting", "Processes that wait for a next run.", load.resting as f64),
    ] {
        text.gauge(name, help);
        text.sample(&[], value);
    }
    text.histogram("stage_seconds", "Time of a run in each of its stages, by preset.");
    for row in &load.stages {
        text.times(&[("preset", row.preset), ("stage", row.stage)], &row.times);
    }
}

fn write_deliveries(text: &mut Exposition, counts: DeliveryCounts) {
    text.gauge("webhooks", "Webhooks that were not delivered yet, or given up.");
    text.sample(&[("state", "waiting")], counts.waiting as f64);
    text.sample(&[("state", "dead")], counts.dead as f64);
}

fn write_warnings(text: &mut Exposition, app: &App) {
    text.gauge("clock_doubted", "1 while the clock cannot be trusted and nothing is removed for its age.");
    text.sample(&[], u8::from(app.jobs().clock_doubt().is_some()));
    text.gauge("connections", "Connections that are open, within the limit and past it.");
    text.sample(&[("limit", "within")], app.connections().seated());
    text.sample(&[("limit", "past")], app.connections().standing());
    text.counter("log_lines_lost_total", "Lines of the log that could not be written, or not in time.");
    text.sample(&[], app.lost_lines().count());
    if let Some(expiry) = app.tls().and_then(|tls| tls.expiry()) {
        let help = "When the TLS certificate expires, in seconds since 1970.";
        text.gauge("tls_certificate_expiry_timestamp_seconds", help);
        text.sample(&[], expiry.0.unix_timestamp());
    }
}
