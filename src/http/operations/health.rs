//! `GET /healthz` and `GET /readyz`

use std::sync::{Mutex, PoisonError};

use axum::Json;
use axum::extract::State;
use axum::http::header;
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use utoipa::ToSchema;

use super::super::App;
use super::super::access::{Gate, GateError, IssuerKeys};
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
/// Tries the job store, the disk and its free space, and the files of keys, an issuer's keys and webhook targets. When this fails, send no
/// requests; the problem's `reasons` say why. So it is where nobody can be let in as the keys of the issuer did not come. A clock that
/// cannot be trusted, a TLS certificate that is about to expire, and an issuer whose keys did not come where there are other keys, are
/// `warnings`: jobs are taken all the same.
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
    let mut faults = gate(app).await;
    if let Some(settings) = app.webhooks()
        && let Err(error) = webhooks::check(settings, app.jobs()).await
    {
        let reason = "the file of the webhook targets cannot be read; `rosaline doctor` and the log say why";
        faults.push((reason, error.to_string()));
    }
    for fault in app.faults().fresh(faults.iter().map(|(_, error)| error)) {
        tracing::error!(error = fault, "not ready");
    }
    faults.into_iter().map(|(reason, _)| reason).collect()
}

/// Why no token is let in.
const NO_ISSUER: &str =
    "the issuer's keys did not come, or it has none, so no token is let in; the log says why";

/// What of the keys cannot be read, and why.
async fn gate(app: &App) -> Vec<(&'static str, String)> {
    let asked = app.clone();
    let checked = tokio::task::spawn_blocking(move || asked.gate().map_or(Ok(()), Gate::check)).await;
    let keys = "the file of the keys cannot be read; `rosaline doctor` and the log say why";
    let issuer = "the file of the issuer's keys cannot be read; `rosaline doctor` and the log say why";
    match checked {
        Ok(Ok(())) if issuer_keys(app) == IssuerKeys::Absent => vec![(NO_ISSUER, NO_ISSUER.to_owned())],
        Ok(Ok(())) => Vec::new(),
        Ok(Err(error @ GateError::Keys(_))) => vec![(keys, error.to_string())],
        Ok(Err(error @ GateError::Issuer(_))) => vec![(issuer, error.to_string())],
        Err(error) => vec![(keys, error.to_string())],
    }
}

fn issuer_keys(app: &App) -> IssuerKeys {
    app.gate().map_or(IssuerKeys::Fine, Gate::issuer_keys)
}

/// Faults that were told in the log: each once as long as it lasts, not at each probe.
#[derive(Debug, Default)]
pub struct Faults(Mutex<Vec<String>>);

impl Faults {
    /// Those of `now` that were not there before.
    fn fresh<'f>(&self, now: impl Iterator<Item = &'f String>) -> Vec<String> {
        let now: Vec<String> = now.cloned().collect();
        let mut told = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let fresh = now.iter().filter(|fault| !told.contains(fault)).cloned().collect();
        *told = now;
        fresh
    }
}

fn warnings(app: &App) -> Vec<String> {
    let clock = app.jobs().clock_doubt().map(|doubt| doubt.to_string());
    let certificate = app.tls().and_then(|tls| tls.expiry()).and_then(|expiry| expiry.warning());
    let issuer = (issuer_keys(app) == IssuerKeys::AbsentBesideKeys).then(|| NO_ISSUER.to_owned());
    clock.into_iter().chain(certificate).chain(issuer).collect()
}
