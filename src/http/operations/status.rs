//! `GET /v1/jobs/{id}`

use std::time::Duration;

use axum::extract::State;
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use sha2::{Digest, Sha256};

use super::super::access::{self, Caller};
use super::super::document::{self, JobProblems};
use super::super::etag::ETag;
use super::super::representation::StatusDocument;
use super::super::{App, Problem, prefer};
use super::{Asked, Id};
use crate::jobs::{Job, JobId};

/// Seconds after which a client should ask again for an active job.
pub(super) const RETRY_AFTER: HeaderValue = HeaderValue::from_static("1");

/// A job's status
///
/// With `Prefer: wait` the answer comes when the status changes: send the last answer's `ETag` as `If-None-Match`,
/// and no change is missed between two requests.
#[utoipa::path(
    get,
    path = "/v1/jobs/{id}",
    operation_id = "getJob",
    tag = document::JOBS,
    params(document::JobPath, document::IfNoneMatchHeader, document::ChangeHeader),
    responses(document::Status, JobProblems)
)]
pub async fn status(
    State(app): State<App>,
    Id(id): Id,
    caller: Caller,
    asked: Asked,
) -> Result<Response, Problem> {
    let wait = prefer::wait(&asked.headers, app.limits().wait);
    let mut job = app.jobs().status(id).await?;
    let (mut body, mut etag) = represent(&job);
    let is_news = asked.headers.contains_key(header::IF_NONE_MATCH) && !etag.is_known_to(&asked.headers);
    if let Some(limit) = wait
        && !is_news
    {
        job = tokio::select! {
            changed = changed(&app, job, limit) => changed?,
            refusal = access::shut_out(&app, &caller, &asked.headers) => return Err(refusal),
        };
        (body, etag) = represent(&job);
    }
    let mut response = if etag.is_known_to(&asked.headers) {
        StatusCode::NOT_MODIFIED.into_response()
    } else {
        ([(header::CONTENT_TYPE, HeaderValue::from_static("application/json"))], body).into_response()
    };
    let headers = response.headers_mut();
    headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("private, no-cache"));
    headers.extend(etag.header().map(|etag| (header::ETAG, etag)));
    if job.status.is_active() {
        headers.insert(header::RETRY_AFTER, RETRY_AFTER);
    }
    if let Some(wait) = wait {
        headers.insert(prefer::PREFERENCE_APPLIED, prefer::applied(wait));
    }
    Ok(response)
}

/// The job's JSON and its entity tag.
pub(super) fn represent(job: &Job) -> (Vec<u8>, ETag) {
    // Strings and numbers always serialise.
    let body = serde_json::to_vec(&StatusDocument::from(job)).unwrap_or_default();
    let digest: String = Sha256::digest(&body).iter().map(|byte| format!("{byte:02x}")).collect();
    (body, ETag::of_digest(&digest))
}

/// The job once it is another than `seen`, after `limit`, or when the service shuts down, whichever is first.
async fn changed(app: &App, seen: Job, limit: Duration) -> Result<Job, Problem> {
    tokio::select! {
        job = app.jobs().wait_change(&seen, limit) => Ok(job?),
        () = app.closing().cancelled() => Ok(app.jobs().status(seen.id).await?),
    }
}

/// Tells the log which job a response is about, where the path does not.
pub(super) fn tagged(mut response: Response, job: JobId) -> Response {
    response.extensions_mut().insert(job);
    response
}
