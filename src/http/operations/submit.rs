//! `POST /v1/jobs`

use std::time::Duration;

use axum::Json;
use axum::extract::{Request, State};
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};

use super::super::access::{self, Caller, Left};
use super::super::admission::{self, Place};
use super::super::document::{self, SubmitProblems};
use super::super::idempotency::{self, Claim};
use super::super::representation::{StatusDocument, job_path};
use super::super::upload::{self, Received};
use super::super::{App, Problem, prefer};
use super::status::{RETRY_AFTER, tagged};
use crate::jobs::{FormatHint, Job, JobSpec, Origin, ParameterValues, Span};

pub const REQUEST_ID: HeaderName = HeaderName::from_static("x-request-id");

/// Submit a mesh
///
/// The mesh is streamed to disk, read once to see that it is one, and answered with 201 when the job is
/// durable: from then on it runs, whatever happens to the service. Its format is found from the content; the
/// content type is a hint.
///
/// A form has the parts `mesh` and, before or after it, `parameters`: a JSON object with the names of the query
/// parameters, which override the query's.
///
/// With `dry_run=true` no job is made: the answer is a 200 with the surface and every defect of it.
///
/// A raw body with a `Content-Digest` (RFC 9530) of SHA-256 is refused when it has another one.
#[utoipa::path(
    post,
    path = "/v1/jobs",
    operation_id = "submitJob",
    tag = document::JOBS,
    params(document::SubmitQuery, document::PreferHeader, document::OriginHeaders),
    responses(document::Created, SubmitProblems)
)]
pub async fn submit(State(app): State<App>, caller: Caller, request: Request) -> Result<Response, Problem> {
    let wait = prefer::wait(request.headers(), app.limits().wait);
    let request_id = request_id(request.headers(), app.limits().reference_chars);
    let claim = app.in_flight().claim(request.headers(), caller.owner())?;
    admission::room(&app, &caller).await?;
    let place = admission::place(&app, &caller, request.extensions().get())?;
    let span = request.extensions().get::<Span>().cloned().unwrap_or_default();
    let left = request.extensions().get::<Left>().cloned();
    let headers = request.headers().clone();
    let receiving = span.child("receive");
    let mut received = upload::receive(&app, request).await?;
    drop(receiving);
    received.owner = caller.owner().map(str::to_owned);
    if received.asked.dry_run {
        return inspect(&app, received, place).await;
    }
    let job = accept(&app, received, place, request_id, claim.as_ref(), &span).await?;
    // A job may end before its request does, which waits for it then.
    drop(span);
    drop(claim);
    let job = match wait {
        Some(limit) => tokio::select! {
            ended = until_ended(&app, &job, limit, left) => ended.unwrap_or(job),
            // The job was accepted while the key was valid; how it goes on is no longer told.
            _ = access::shut_out(&app, &caller, &headers) => job,
        },
        None => job,
    };
    Ok(created(&job, wait))
}

/// Reads the mesh and says what is wrong with it; nothing of it is kept. What waits for its check has the place of an
/// upload still, also when its client has gone: it lies on the disk.
async fn inspect(
    app: &App,
    Received { upload, asked, hint, .. }: Received,
    place: Place,
) -> Result<Response, Problem> {
    let turn = app.validator().turn(upload.size(), place).await?;
    let bytes = upload.read().await?;
    let inspection =
        app.validator().inspect(turn, bytes, hint, asked.parameters, upload.sha256().to_owned()).await?;
    Ok(([(header::CACHE_CONTROL, "no-store")], Json(inspection)).into_response())
}

/// Checks the mesh and makes the job durable.
async fn accept(
    app: &App,
    received: Received,
    place: Place,
    request_id: Option<String>,
    claim: Option<&Claim>,
    span: &Span,
) -> Result<Job, Problem> {
    let Received { upload, asked, hint, owner } = received;
    let mut spec = JobSpec {
        hint: FormatHint::default(),
        name: asked.name,
        units: asked.units,
        parameters: ParameterValues::from(&asked.parameters),
        origin: Origin {
            request_id,
            client_reference: asked.client_reference,
            traceparent: span.traceparent(),
        },
        idempotency: None,
        priority: asked.priority,
        owner,
    };
    if let Some(claim) = claim {
        let request = claim.of(&spec, upload.sha256());
        if let Some(job) = app.jobs().find(&request.key).await? {
            return idempotency::first(job, &request);
        }
        spec.idempotency = Some(request);
    }
    let checking = span.child("check");
    let turn = app.validator().turn(upload.size(), place).await?;
    let bytes = upload.read().await?;
    let format = app.validator().check(turn, bytes, hint, asked.parameters).await?;
    drop(checking);
    // What the content was found to be settles what a second reading could doubt.
    spec.hint = FormatHint { extension: Some(format.name().to_owned()), content_type: None };
    let committing = span.child("commit");
    let job = app.jobs().submit(upload, spec).await?;
    drop(committing);
    app.counters().uploaded(job.input.size);
    Ok(job)
}

/// What a client or a proxy calls the request; what is no such name is passed over.
fn request_id(headers: &HeaderMap, most: usize) -> Option<String> {
    let text = headers.get(REQUEST_ID)?.to_str().ok()?;
    let fits = (1..=most).contains(&text.len()) && text.bytes().all(|byte| byte.is_ascii_graphic());
    fits.then(|| text.to_owned())
}

/// The job once it has ended, after `limit`, when nobody waits for it, or when the service shuts down, whichever is first;
/// `None` where no more is known of it.
///
/// The job is accepted by now, so nothing that fails here may turn the answer into an error.
async fn until_ended(app: &App, job: &Job, limit: Duration, left: Option<Left>) -> Option<Job> {
    let is_left = async {
        match &left {
            Some(Left(left)) => left.cancelled().await,
            None => std::future::pending().await,
        }
    };
    tokio::select! {
        ended = app.jobs().wait(job.id, limit) => ended.ok(),
        () = is_left => None,
        () = app.closing().cancelled() => app.jobs().status(job.id).await.ok(),
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
