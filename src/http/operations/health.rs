//! `GET /healthz` and `GET /readyz`

use axum::Json;
use axum::extract::State;
use axum::http::header;
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use utoipa::ToSchema;

use super::super::App;
use super::super::access::Gate;
use super::super::document::{self, PlainProblems, ReadyProblems};
use super::super::problem::{NOT_READY, Problem};
use crate::jobs::Unready;
use crate::outbound::webhooks;

/// Seconds after which to ask again.
const RETRY_AFTER: u32 = 5;

/// A service that answers.
#[derive(Debug, Serialize, ToSchema)]
pub struct Health {
    /// `ok`, or `ready` where it was asked whether it is.
    #[schema(example = "ok")]
    status: &'static str,
    /// Version of Rosaline.
    #[schema(example = "0.1.0")]
    version: &'static str,
    /// What the operator should see to although jobs are taken; not there where there is nothing.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    #[schema(required = false)]
    warnings: Vec<String>,
}

impl Health {
    fn response(status: &'static str, warnings: Vec<String>) -> Response {
        let body = Json(Self { status, version: env!("CARGO_PKG_VERSION"), warnings });
        ([(header::CACHE_CONTROL, "no-store")], body).into_response()
    }
}

/// Whether the process is alive
///
/// Touches neither the store nor the workers: when this fails, restart the service.
#[utoipa::path(
    get,
    path = "/healthz",
    operation_id = "getHealth",
    tag = document::SERVICE,
    responses(document::Healthy, PlainProblems)
)]
pub async fn healthz() -> Response {
    Health::response("ok", Vec::new())
}

/// Whether the service takes jobs
///
/// Tries the job store, the disk and its free space, and the files of keys and webhook targets. When this fails, send no
/// requests; the problem's `reasons` say why. A clock that
/// cannot be trusted, and a TLS certificate that is about to expire, are `warnings`: jobs are taken all the same.
#[utoipa::path(
    get,
    path = "/readyz",
    operation_id = "getReadiness",
    tag = document::SERVICE,
    responses(document::Healthy, ReadyProblems)
)]
pub async fn readyz(State(app): State<App>) -> Result<Response, Problem> {
    let mut reasons = app.jobs().ready().await.err().map_or_else(Vec::new, |unready| unready.reasons);
    reasons.extend(unreadable(&app).await.into_iter().map(str::to_owned));
    if reasons.is_empty() {
        return Ok(Health::response("ready", warnings(&app)));
    }
    let unready = Unready { reasons };
    Err(Problem::new(&NOT_READY, unready.to_string())
        .with("reasons", unready.reasons)
        .header(header::RETRY_AFTER, RETRY_AFTER))
}

/// The operator's files that cannot be read. Anyone may ask: where they are and what is in them is for the log.
async fn unreadable(app: &App) -> Vec<&'static str> {
    let mut found = Vec::new();
    if let Some(Err(error)) = app.gate().map(Gate::check) {
        tracing::error!(%error, "not ready");
        found.push("the file of the keys cannot be read; `rosaline doctor` and the log say why");
    }
    if let Some(settings) = app.webhooks()
        && let Err(error) = webhooks::check(settings, app.jobs()).await
    {
        tracing::error!(%error, "not ready");
        found.push("the file of the webhook targets cannot be read; `rosaline doctor` and the log say why");
    }
    found
}

fn warnings(app: &App) -> Vec<String> {
    let clock = app.jobs().clock_doubt().map(|doubt| doubt.to_string());
    let certificate = app.tls().and_then(|tls| tls.expiry()).and_then(|expiry| expiry.warning());
    clock.into_iter().chain(certificate).collect()
}
