//! The request log: what was asked by route, never the path or query as sent, which may hold patient data.

use std::time::Instant;

use axum::extract::{MatchedPath, Request, State};
use axum::http::Method;
use axum::middleware::Next;
use axum::response::Response;
use percent_encoding::percent_decode_str;

use super::counters::Counters;
use crate::jobs::{JobId, Span, SpanKind, Spans, TRACEPARENT};

/// Logs every request once its answer begins.
pub async fn log(
    State((counters, spans)): State<(Counters, Spans)>,
    mut request: Request,
    next: Next,
) -> Response {
    let begin = Instant::now();
    let method = method(request.method());
    let matched = request.extensions().get::<MatchedPath>().cloned();
    let route = matched.as_ref().map_or("-", MatchedPath::as_str).to_owned();
    let job = job_in_path(request.uri().path());
    let span = begin_span(&spans, method, &route, &request);
    request.extensions_mut().insert(span.clone());
    let response = next.run(request).await;
    let job = job.or_else(|| response.extensions().get::<JobId>().copied());
    let job = job.map(tracing::field::display);
    let status = response.status().as_u16();
    counters.request(method, &route, status, begin.elapsed());
    end_span(&span, status, job.as_ref().map(ToString::to_string));
    let micros = u64::try_from(begin.elapsed().as_micros()).unwrap_or(u64::MAX);
    match route.as_str() {
        "/healthz" | "/readyz" if status == 200 => tracing::debug!(method, route, status, micros),
        _ => tracing::info!(method, route, status, micros, job, "request"),
    }
    response
}

/// Probes and scrapes have none: they would drown the others.
fn begin_span(spans: &Spans, method: &'static str, route: &str, request: &Request) -> Span {
    if !spans.are_on() || matches!(route, "/healthz" | "/readyz" | "/metrics") {
        return Span::default();
    }
    let caller = request.headers().get(TRACEPARENT).and_then(|value| value.to_str().ok());
    let span = spans.begin(format!("{method} {route}"), SpanKind::Server, caller);
    span.set("http.request.method", method);
    span.set("http.route", route.to_owned());
    span
}

fn end_span(span: &Span, status: u16, job: Option<String>) {
    span.set("http.response.status_code", i64::from(status));
    if let Some(job) = job {
        span.set("rosaline.job.id", job);
    }
    if status >= 500 {
        span.fail();
    }
}

/// A made-up method is the client's text: it is not repeated.
fn method(method: &Method) -> &'static str {
    match method.as_str() {
        "GET" => "GET",
        "HEAD" => "HEAD",
        "POST" => "POST",
        "DELETE" => "DELETE",
        "OPTIONS" => "OPTIONS",
        "PUT" => "PUT",
        "PATCH" => "PATCH",
        _ => "other",
    }
}

/// Only what is a well-formed id, as the routes read it: its characters may be written by their percent codes
/// (RFC 3986, section 6.2.2.2).
pub(super) fn job_in_path(path: &str) -> Option<JobId> {
    let id = path.strip_prefix("/v1/jobs/")?.split('/').next()?;
    percent_decode_str(id).decode_utf8().ok()?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_id_is_the_same_however_it_is_spelled() {
        let id: JobId = "019aa8b6-7a42-7d52-8d53-2f8ad3a2b9c1".parse().unwrap();
        for path in [
            "/v1/jobs/019aa8b6-7a42-7d52-8d53-2f8ad3a2b9c1",
            "/v1/jobs/%3019aa8b6%2d7a42-7d52-8d53-2f8ad3a2b9c1/results/centerline",
        ] {
            assert_eq!(job_in_path(path), Some(id), "{path}");
        }
        for path in ["/v1/jobs", "/v1/jobs/%ff", "/v1/jobs/patient", "/v1/limits"] {
            assert_eq!(job_in_path(path), None, "{path}");
        }
    }
}
