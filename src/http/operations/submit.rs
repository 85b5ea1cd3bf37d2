//! `POST /v1/jobs`

use std::time::Duration;

use axum::Json;
use axum::extract::{Request, State};
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};

use super::super::document::{self, SubmitProblems};
use super::super::representation::{StatusDocument, job_path};
use super::super::upload::{self, Received};
use super::super::{App, Problem, prefer};
use super::status::{RETRY_AFTER, tagged};
use crate::jobs::{FormatHint, Job, JobSpec, ParameterValues};

/// Submit a mesh
///
/// The mesh is streamed to disk, read once to see that it is one, and answered with 201 when the job is
/// durable: from then on it runs, whatever happens to the service. Its format is found from the content; the
/// content type is a hint.
///
/// A form has the parts `mesh` and, before or after it, `parameters`: a JSON object with the names of the query
/// parameters, which override the query's.
#[utoipa::path(
    post,
    path = "/v1/jobs",
    operation_id = "submitJob",
    tag = document::JOBS,
    params(document::SubmitQuery, document::PreferHeader),
    responses(document::Created, SubmitProblems)
)]
pub async fn submit(State(app): State<App>, request: Request) -> Result<Response, Problem> {
    let wait = prefer::wait(request.headers(), app.limits().wait);
    let job = accept(&app, upload::receive(&app, request).await?).await?;
    let job = match wait {
        Some(limit) => until_ended(&app, job, limit).await,
        None => job,
    };
    Ok(created(&job, wait))
}

/// Checks the mesh and makes the job durable.
async fn accept(app: &App, received: Received) -> Result<Job, Problem> {
    let Received { upload, asked, hint } = received;
    let turn = app.validator().turn().await?;
    let bytes = upload.read().await?;
    let format = app.validator().check(turn, bytes, hint).await?;
    let spec = JobSpec {
        // What the content was found to be settles what a second reading could doubt.
        hint: FormatHint { extension: Some(format.name().to_owned()), content_type: None },
        name: asked.name,
        units: asked.units,
        parameters: ParameterValues::from(&asked.parameters),
    };
    Ok(app.jobs().submit(upload, spec).await?)
}

/// The job once it has ended, after `limit`, or when the service shuts down, whichever is first.
///
/// The job is accepted by now, so nothing that fails here may turn the answer into an error.
async fn until_ended(app: &App, job: Job, limit: Duration) -> Job {
    tokio::select! {
        ended = app.jobs().wait(job.id, limit) => ended.unwrap_or(job),
        () = app.closing().cancelled() => app.jobs().status(job.id).await.unwrap_or(job),
    }
}

fn created(job: &Job, wait: Option<Duration>) -> Response {
    let mut response = (StatusCode::CREATED, Json(StatusDocument::from(job))).into_response();
    let headers = response.headers_mut();
    if let Ok(location) = HeaderValue::try_from(job_path(job)) {
        headers.insert(header::LOCATION, location);
    }
    if job.status.is_active() {
        headers.insert(header::RETRY_AFTER, RETRY_AFTER);
    }
    if let Some(wait) = wait {
        headers.insert(prefer::PREFERENCE_APPLIED, prefer::applied(wait));
    }
    tagged(response, job.id)
}
