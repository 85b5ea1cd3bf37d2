//! `GET /v1/jobs/{id}/results/centerline`, and with an extension.

use std::ops::Range;

use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, header};
use axum::response::{IntoResponse, Response};
use futures::TryStreamExt;

use super::super::document::{self, ResultProblems};
use super::super::etag::ETag;
use super::super::problem::{NOT_ACCEPTABLE, PRECONDITION_FAILED, Problem, RANGE_NOT_SATISFIABLE};
use super::super::{App, coding, negotiation, range};
use super::status::RETRY_AFTER;
use super::{Asked, Id};
use crate::jobs::blob::{BlobBody, BlobError};
use crate::jobs::{Coding, JobError, JobId, StoredArtifact};
use crate::output::OutputFormat;

/// Results never change under their URL; they may be patient data, so only the client's own cache keeps them.
const CACHE_CONTROL: HeaderValue = HeaderValue::from_static("private, max-age=31536000, immutable");

/// What the answer under the URL without an extension depends on.
const NEGOTIATED_BY: &str = "accept, accept-encoding";

/// A job's centerline in the form that `Accept` asks for
///
/// JSON where the client has no preference. The line lies in the mesh's own unit and frame. Once it is there it
/// never changes: it has a strong `ETag` and may be kept.
#[utoipa::path(
    get,
    path = "/v1/jobs/{id}/results/centerline",
    operation_id = "getCenterline",
    tag = document::RESULTS,
    params(document::JobPath, document::AcceptHeader, document::ConditionHeaders),
    responses(document::AnyResult, ResultProblems)
)]
pub async fn negotiated(State(app): State<App>, Id(id): Id, asked: Asked) -> Result<Response, Problem> {
    // First whether there is a result at all: that does not depend on the form.
    let forms = app.jobs().result_forms(id).await.map_err(unavailable)?;
    let offers: Vec<&str> = forms.iter().map(|format| format.media_type()).collect();
    let choice = negotiation::preferred(&asked.headers, &offers);
    let Some(format) = choice.and_then(|place| forms.get(place)) else {
        let detail = format!("the centerline is there as {}", offers.join(", "));
        return Err(Problem::new(&NOT_ACCEPTABLE, detail)
            .with("available", offers)
            .header(header::VARY, "accept")
            .about(id));
    };
    let answered = answer(&app, id, *format, &asked).await;
    let mut response = answered.map_err(|problem| problem.header(header::VARY, NEGOTIATED_BY))?;
    response.headers_mut().insert(header::VARY, HeaderValue::from_static(NEGOTIATED_BY));
    if let Ok(location) =
        HeaderValue::try_from(format!("/v1/jobs/{id}/results/centerline.{}", format.extension()))
    {
        response.headers_mut().insert(header::CONTENT_LOCATION, location);
    }
    Ok(response)
}

/// A job's centerline as JSON
#[utoipa::path(
    get,
    path = "/v1/jobs/{id}/results/centerline.json",
    operation_id = "getCenterlineJson",
    tag = document::RESULTS,
    params(document::JobPath, document::ConditionHeaders),
    responses(document::JsonResult, ResultProblems)
)]
pub async fn json(State(app): State<App>, Id(id): Id, asked: Asked) -> Result<Response, Problem> {
    answer(&app, id, OutputFormat::Json, &asked).await
}

/// A job's centerline as glTF
///
/// A line strip for each branch with a `_RADIUS` attribute, in the mesh's own frame; buffers are embedded.
#[utoipa::path(
    get,
    path = "/v1/jobs/{id}/results/centerline.gltf",
    operation_id = "getCenterlineGltf",
    tag = document::RESULTS,
    params(document::JobPath, document::ConditionHeaders),
    responses(document::GltfResult, ResultProblems)
)]
pub async fn gltf(State(app): State<App>, Id(id): Id, asked: Asked) -> Result<Response, Problem> {
    answer(&app, id, OutputFormat::Gltf, &asked).await
}

/// A job's centerline as binary glTF
///
/// A line strip for each branch with a `_RADIUS` attribute, in the mesh's own frame.
#[utoipa::path(
    get,
    path = "/v1/jobs/{id}/results/centerline.glb",
    operation_id = "getCenterlineGlb",
    tag = document::RESULTS,
    params(document::JobPath, document::ConditionHeaders),
    responses(document::GlbResult, ResultProblems)
)]
pub async fn glb(State(app): State<App>, Id(id): Id, asked: Asked) -> Result<Response, Problem> {
    answer(&app, id, OutputFormat::Glb, &asked).await
}

/// A job's centerline as VTK XML PolyData
///
/// For ParaView, 3D Slicer and those who work with VMTK: a polyline for each branch with `MaximumInscribedSphereRadius`, in
/// the mesh's own frame. Results of versions before this form are not there in it.
#[utoipa::path(
    get,
    path = "/v1/jobs/{id}/results/centerline.vtp",
    operation_id = "getCenterlineVtp",
    tag = document::RESULTS,
    params(document::JobPath, document::ConditionHeaders),
    responses(document::VtpResult, ResultProblems)
)]
pub async fn vtp(State(app): State<App>, Id(id): Id, asked: Asked) -> Result<Response, Problem> {
    answer(&app, id, OutputFormat::Vtp, &asked).await
}

async fn answer(app: &App, id: JobId, format: OutputFormat, asked: &Asked) -> Result<Response, Problem> {
    let codings = coding::accepted(&asked.headers);
    let artifact = match app.jobs().result_in(id, format, &codings).await {
        Err(JobError::NoSuchResult { .. }) if app.jobs().result_forms(id).await?.contains(&format) => {
            return Err(not_in_coding(id, format));
        }
        found => found.map_err(unavailable)?,
    };
    let etag = ETag::of_digest(&artifact.sha256);
    let headers = &asked.headers;
    if !etag.allows(headers) {
        let detail = "the result is not the one that If-Match names, in this form and coding; leave it out, or take the ETag of this";
        return Err(Problem::new(&PRECONDITION_FAILED, detail).about(id));
    }
    let mut response = if etag.is_known_to(headers) {
        StatusCode::NOT_MODIFIED.into_response()
    } else {
        present(app, id, app.jobs().check_result(&artifact).await).await?;
        let part = asked_part(headers, &etag, artifact.size);
        match (&asked.method, part) {
            (&Method::HEAD, _) => described(StatusCode::OK, &artifact, artifact.size, Body::empty()),
            (_, range::Asked::Whole) => whole(app, id, &artifact).await?,
            (_, range::Asked::Part(part)) => partial(app, id, &artifact, part).await?,
            (_, range::Asked::Unsatisfiable) => return Err(unsatisfiable(id, artifact.size)),
        }
    };
    response.headers_mut().insert(header::CACHE_CONTROL, CACHE_CONTROL);
    response.headers_mut().insert(header::VARY, HeaderValue::from_static("accept-encoding"));
    if let Some(etag) = etag.header() {
        response.headers_mut().insert(header::ETAG, etag);
    }
    Ok(response)
}

fn asked_part(headers: &HeaderMap, etag: &ETag, length: u64) -> range::Asked {
    match headers.get(header::RANGE).and_then(|value| value.to_str().ok()) {
        Some(value) if etag.allows_range(headers) => range::asked(value, length),
        _ => range::Asked::Whole,
    }
}

/// A result that is purged while it is asked for is a job that is not there.
async fn present<T>(app: &App, id: JobId, found: Result<T, JobError>) -> Result<T, Problem> {
    match found {
        Err(error @ JobError::Blob(BlobError::NotFound { .. })) => {
            app.jobs().status(id).await?;
            Err(error.into())
        }
        found => Ok(found?),
    }
}

async fn open(
    app: &App,
    id: JobId,
    artifact: &StoredArtifact,
    part: Option<Range<u64>>,
) -> Result<BlobBody<'static>, Problem> {
    present(app, id, app.jobs().open_result(artifact, part).await).await
}

async fn whole(app: &App, id: JobId, artifact: &StoredArtifact) -> Result<Response, Problem> {
    let blob = open(app, id, artifact, None).await?;
    Ok(described(StatusCode::OK, artifact, artifact.size, counted(app, id, blob)))
}

async fn partial(
    app: &App,
    id: JobId,
    artifact: &StoredArtifact,
    part: Range<u64>,
) -> Result<Response, Problem> {
    let blob = open(app, id, artifact, Some(part.clone())).await?;
    let length = part.end - part.start;
    let mut response = described(StatusCode::PARTIAL_CONTENT, artifact, length, counted(app, id, blob));
    if let Ok(value) = HeaderValue::try_from(range::content_range(&part, artifact.size)) {
        response.headers_mut().insert(header::CONTENT_RANGE, value);
    }
    Ok(response)
}

/// A result's bytes, counted as they go out. Where they end in an error the connection is cut: the client sees that its
/// answer is not whole.
fn counted(app: &App, id: JobId, body: BlobBody<'static>) -> Body {
    let counters = app.counters().clone();
    let told = body.inspect_ok(move |chunk| counters.sent(chunk.len()));
    Body::from_stream(
        told.inspect_err(move |error| tracing::error!(job = %id, %error, "a result was cut short")),
    )
}

fn described(status: StatusCode, artifact: &StoredArtifact, length: u64, body: Body) -> Response {
    let mut response = (status, body).into_response();
    let headers = response.headers_mut();
    headers.insert(header::CONTENT_TYPE, HeaderValue::from_static(artifact.format.media_type()));
    if artifact.coding != Coding::Identity {
        headers.insert(header::CONTENT_ENCODING, HeaderValue::from_static(artifact.coding.name()));
    }
    headers.insert(header::CONTENT_LENGTH, HeaderValue::from(length));
    headers.insert(header::ACCEPT_RANGES, HeaderValue::from_static("bytes"));
    headers.insert(header::X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
    response
}

fn unsatisfiable(id: JobId, length: u64) -> Problem {
    Problem::new(&RANGE_NOT_SATISFIABLE, format!("the result has {length} bytes; ask for some of those"))
        .with("length", length)
        .header(header::CONTENT_RANGE, range::content_range_unsatisfied(length))
        .header(header::ACCEPT_RANGES, "bytes")
        .about(id)
}

/// The client rules out the result as it is (RFC 9110, section 12.5.3), and there is no other.
fn not_in_coding(id: JobId, format: OutputFormat) -> Problem {
    let compressed = "and only JSON and glTF that get smaller by it are there by gzip and zstd as well";
    let todo = "leave identity;q=0 and *;q=0 out of Accept-Encoding, or accept gzip or zstd for JSON or glTF";
    let detail = format!("the {} is there as it is (identity), {compressed}; {todo}", format.extension());
    Problem::new(&NOT_ACCEPTABLE, detail).header(header::VARY, "accept-encoding").about(id)
}

/// Of an active job: when to ask again.
fn unavailable(error: JobError) -> Problem {
    let is_early = matches!(error, JobError::NotReady { .. });
    let problem = Problem::from(error);
    if is_early { problem.header(header::RETRY_AFTER, RETRY_AFTER) } else { problem }
}
