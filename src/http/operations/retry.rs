//! `POST /v1/jobs/{id}/retry`

use axum::Json;
use axum::extract::State;
use axum::http::header;
use axum::response::{IntoResponse, Response};

use super::super::document::{self, RetryProblems};
use super::super::representation::StatusDocument;
use super::super::{App, Problem};
use super::Id;
use super::status::RETRY_AFTER;

/// Run a failed job again
///
/// It waits for a worker as it did at first, with the same mesh, parameters and priority.
#[utoipa::path(
    post,
    path = "/v1/jobs/{id}/retry",
    operation_id = "retryJob",
    tag = document::JOBS,
    params(document::JobPath),
    responses(document::Retried, RetryProblems)
)]
pub async fn retry(State(app): State<App>, Id(id): Id) -> Result<Response, Problem> {
    let job = app.jobs().retry(id).await?;
    let mut response = Json(StatusDocument::from(&job)).into_response();
    if job.status.is_active() {
        response.headers_mut().insert(header::RETRY_AFTER, RETRY_AFTER);
    }
    Ok(response)
}
