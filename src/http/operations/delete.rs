//! `DELETE /v1/jobs/{id}`

use axum::Json;
use axum::extract::State;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};

use super::super::document::{self, DeleteProblems};
use super::super::problem::PRECONDITION_FAILED;
use super::super::representation::StatusDocument;
use super::super::{App, Problem};
use super::status::represent;
use super::{Asked, Id};
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
    params(document::JobPath, document::IfMatchHeader),
    responses(document::Deleted, DeleteProblems)
)]
pub async fn delete(State(app): State<App>, Id(id): Id, asked: Asked) -> Result<Response, Problem> {
    if asked.headers.contains_key(header::IF_MATCH) {
        let (_, etag) = represent(&app.jobs().status(id).await?);
        if !etag.allows(&asked.headers) {
            let detail = "the job has changed since; get its status and decide again";
            return Err(Problem::new(&PRECONDITION_FAILED, detail).about(id));
        }
    }
    Ok(match app.jobs().remove(id).await? {
        Removed::Dismissed(job) => Json(StatusDocument::from(job.as_ref())).into_response(),
        Removed::Purged => StatusCode::NO_CONTENT.into_response(),
    })
}
