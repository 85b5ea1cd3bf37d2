//! `DELETE /v1/jobs/{id}`

use axum::Json;
use axum::extract::State;
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};

use super::super::document::{self, JobProblems};
use super::super::representation::StatusDocument;
use super::super::{App, Problem};
use super::Id;
use crate::jobs::Removed;

/// Cancel or purge a job
///
/// An active job is cancelled: it becomes `dismissed`, and its status is answered. A job that has ended is
/// purged with its mesh and results.
#[utoipa::path(
    delete,
    path = "/v1/jobs/{id}",
    operation_id = "deleteJob",
    tag = document::JOBS,
    params(document::JobPath),
    responses(document::Deleted, JobProblems)
)]
pub async fn delete(State(app): State<App>, Id(id): Id) -> Result<Response, Problem> {
    Ok(match app.jobs().remove(id).await? {
        Removed::Dismissed(job) => Json(StatusDocument::from(job.as_ref())).into_response(),
        Removed::Purged => StatusCode::NO_CONTENT.into_response(),
    })
}
