//! `GET /v1/limits`

use axum::Json;
use axum::extract::State;
use axum::http::header;
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use utoipa::ToSchema;

use super::super::App;
use super::super::document::{self, LimitsProblems};
use super::super::limits::Limits;
use crate::mesh::format;

/// Every bound that a client can meet.
#[derive(Debug, Serialize, ToSchema)]
#[schema(title = "Limits", as = Limits)]
pub struct LimitsDocument {
    /// Bytes of one mesh.
    #[schema(example = 1_073_741_824_u64)]
    upload_bytes: u64,
    /// Bytes of a form's part `parameters`.
    parameters_bytes: usize,
    /// Vertices of one mesh.
    vertices: usize,
    /// Triangles of one mesh, after polygons and strips were split.
    triangles: usize,
    /// Bytes that a mesh's compressed or base64 data may unpack to.
    decoded_bytes: usize,
    /// How many times its file's bytes a mesh's compressed data may unpack to.
    expansion: usize,
    /// Bytes that the compressed data of any small file may unpack to, whatever `expansion` says.
    expansion_free_bytes: usize,
    /// Seconds after which an upload of which too little comes in is cut.
    upload_idle_seconds: u64,
    /// Seconds that a request's head may take.
    head_seconds: u64,
    /// Connections that may be open at the same time; requests on more get a 503.
    connections: usize,
    /// Meshes that are checked at the same time.
    validations: usize,
    /// Uploads that may come in at the same time; more get a 503.
    uploads: usize,
    /// Uploads of one principal, or where no key is needed of one address, that may come in at the same time; more get a
    /// 429.
    uploads_each: usize,
    /// Jobs that may wait; more get a 503.
    queue: u64,
    /// Jobs of one principal that may wait or run; more get a 429.
    jobs_per_principal: u64,
    /// Seconds that one run of a job may take.
    run_seconds: u64,
    /// Bytes of memory that one run of a job may have, beside its threads' stacks.
    #[schema(example = 4_294_967_296_u64)]
    job_memory_bytes: u64,
    /// Seconds that `Prefer: wait` is honoured at most.
    wait_seconds: u64,
    /// Jobs on one page of the list at most.
    page: u32,
    /// Characters of `name`.
    name_chars: usize,
    /// Characters of `client_reference` and of `X-Request-ID`.
    reference_chars: usize,
}

impl From<&Limits> for LimitsDocument {
    fn from(limits: &Limits) -> Self {
        Self {
            upload_bytes: limits.upload_bytes,
            parameters_bytes: limits.parameters_bytes,
            vertices: limits.mesh.vertices,
            triangles: limits.mesh.triangles,
            decoded_bytes: limits.mesh.decoded_bytes,
            expansion: limits.mesh.expansion,
            expansion_free_bytes: format::Limits::EXPANSION_FREE,
            upload_idle_seconds: limits.upload_idle.as_secs(),
            head_seconds: limits.head.as_secs(),
            connections: limits.connections,
            validations: limits.validations,
            uploads: limits.uploads,
            uploads_each: limits.uploads_each,
            queue: limits.queue,
            jobs_per_principal: limits.jobs_per_principal,
            run_seconds: limits.run.as_secs(),
            job_memory_bytes: limits.job_memory,
            wait_seconds: limits.wait.as_secs(),
            page: limits.page_most,
            name_chars: limits.name_chars,
            reference_chars: limits.reference_chars,
        }
    }
}

/// What the service takes at most
#[utoipa::path(
    get,
    path = "/v1/limits",
    operation_id = "getLimits",
    tag = document::SERVICE,
    responses(document::LimitsAnswer, LimitsProblems)
)]
pub async fn limits(State(app): State<App>) -> Response {
    ([(header::CACHE_CONTROL, "no-cache")], Json(LimitsDocument::from(app.limits()))).into_response()
}
