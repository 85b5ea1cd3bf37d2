//! `GET /v1/jobs/{id}`

use axum::Json;
use axum::extract::State;
use axum::http::{HeaderValue, header};
use axum::response::{IntoResponse, Response};

use super::super::document::{self, JobProblems};
use super::super::representation::StatusDocument;
use super::super::{App, Problem};
use super::Id;
use crate::jobs::JobId;

/// Seconds after which a client should ask again for an active job.
pub(super) const RETRY_AFTER: HeaderValue = HeaderValue::from_static("1");

/// A job's status
#[utoipa::path(
    get,
    path = "/v1/jobs/{id}",
    operation_id = "getJob",
    tag = document::JOBS,
    params(document::JobPath),
    responses(document::Status, JobProblems)
)]
pub async fn status(State(app): State<App>, Id(id): Id) -> Result<Response, Problem> {
    let job = app.jobs().status(id).await?;
    let mut response = Json(StatusDocument::from(&job)).into_response();
    response.headers_mut().insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
    if job.status.is_active() {
        response.headers_mut().insert(header::RETRY_AFTER, RETRY_AFTER);
    }
    Ok(response)
}

/// Tells the log which job a response is about, where the path does not.
pub(super) fn tagged(mut response: Response, job: JobId) -> Response {
    response.extensions_mut().insert(job);
    response
}
