//! `GET /v1/webhooks/dead` and `POST /v1/webhooks/dead/{id}/resend`

use axum::Json;
use axum::extract::{Path, Request, State};
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use utoipa::ToSchema;

use super::super::App;
use super::super::access::{Caller, Scope};
use super::super::document::{self, DeadProblems, ResendProblems};
use super::super::limits::Limits;
use super::super::parameters::query_pairs;
use super::super::problem::{INVALID_PARAMETER, Problem, UNKNOWN_PARAMETER, WEBHOOK_NOT_FOUND};
use super::super::representation::rfc3339;
use crate::jobs::{Delivery, JobError};

/// A webhook that was given up.
#[derive(Debug, Serialize, ToSchema)]
#[schema(title = "DeadWebhook", as = DeadWebhook)]
pub struct DeadWebhook {
    /// The `webhook-id` of its tries.
    #[schema(example = "msg_5f2b0c9a3d1e4f60718293a4b5c6d7e8")]
    id: String,
    /// The target's name.
    #[schema(example = "pacs")]
    target: String,
    #[serde(rename = "type")]
    #[schema(example = "job.successful")]
    kind: String,
    /// The job that it is about.
    #[schema(format = Uuid)]
    job: String,
    /// When the job ended.
    #[schema(format = DateTime)]
    finished: String,
    /// How often it was tried.
    attempts: u32,
    /// Why the last try failed.
    #[schema(required, example = "it answered 500")]
    failure: Option<String>,
    /// When it was given up.
    #[schema(required, format = DateTime)]
    died: Option<String>,
}

/// Webhooks that were given up, the latest first.
#[derive(Debug, Serialize, ToSchema)]
#[schema(title = "DeadWebhooks", as = DeadWebhooks)]
pub struct DeadWebhooks {
    webhooks: Vec<DeadWebhook>,
}

impl From<&Delivery> for DeadWebhook {
    fn from(delivery: &Delivery) -> Self {
        Self {
            id: delivery.id.clone(),
            target: delivery.listener.clone(),
            kind: format!("job.{}", delivery.status.name()),
            job: delivery.job.to_string(),
            finished: rfc3339(delivery.finished),
            attempts: delivery.attempts,
            failure: delivery.failure.clone(),
            died: delivery.died.map(rfc3339),
        }
    }
}

/// Webhooks that were given up, the latest first
///
/// One page; the `Link` with `rel="next"` leads to the next one until there are no older ones. They are kept for 30 days.
/// Needs the scope `admin` where a key is needed.
#[utoipa::path(
    get,
    path = "/v1/webhooks/dead",
    operation_id = "listDeadWebhooks",
    tag = document::WEBHOOKS,
    params(document::DeadParameters),
    responses(document::Dead, DeadProblems)
)]
pub async fn dead(State(app): State<App>, caller: Caller, request: Request) -> Result<Response, Problem> {
    caller.must_have(Scope::Admin)?;
    let (limit, before) = read(&query_pairs(request.uri())?, app.limits())?;
    let found = app.jobs().dead_deliveries(before.as_deref(), limit + 1).await.map_err(JobError::from)?;
    let page = &found[..found.len().min(limit as usize)];
    let document = DeadWebhooks { webhooks: page.iter().map(DeadWebhook::from).collect() };
    let mut response = Json(document).into_response();
    response.headers_mut().insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
    if let (true, Some(last)) = (found.len() > page.len(), page.last()) {
        let link = format!("</v1/webhooks/dead?limit={limit}&cursor={}>; rel=\"next\"", last.id);
        if let Ok(link) = HeaderValue::try_from(link) {
            response.headers_mut().insert(header::LINK, link);
        }
    }
    Ok(response)
}

/// The page's length, and the id after which it begins.
fn read(pairs: &[(String, String)], limits: &Limits) -> Result<(u32, Option<String>), Problem> {
    let (mut limit, mut cursor) = (limits.page_default, None);
    for (place, (name, value)) in pairs.iter().enumerate() {
        let invalid =
            |detail: String| Err(Problem::new(&INVALID_PARAMETER, detail).with("parameter", name.as_str()));
        if pairs[..place].iter().any(|(other, _)| other == name) {
            return invalid(format!("{name} is given twice; give it once"));
        }
        match name.as_str() {
            "limit" => match value.parse() {
                Ok(number) if (1..=limits.page_most).contains(&number) => limit = number,
                _ => return invalid(format!("limit is a number from 1 to {}", limits.page_most)),
            },
            "cursor" if is_id(value) => cursor = Some(value.clone()),
            "cursor" => return invalid("the cursor is not one that a page of this list gave".to_owned()),
            _ => {
                let detail = "there is no such parameter; the known ones are limit and cursor";
                let shown: String = name.chars().take(40).collect();
                return Err(Problem::new(&UNKNOWN_PARAMETER, detail).with("parameter", shown));
            }
        }
    }
    Ok((limit, cursor))
}

fn is_id(text: &str) -> bool {
    text.strip_prefix("msg_")
        .is_some_and(|rest| rest.len() == 32 && rest.bytes().all(|byte| byte.is_ascii_hexdigit()))
}

/// Send a webhook again that was given up
///
/// It is tried as at first, with the same `webhook-id`. Needs the scope `admin` where a key is needed.
#[utoipa::path(
    post,
    path = "/v1/webhooks/dead/{id}/resend",
    operation_id = "resendWebhook",
    tag = document::WEBHOOKS,
    params(document::WebhookPath),
    responses(document::Resent, ResendProblems)
)]
pub async fn resend(
    State(app): State<App>,
    caller: Caller,
    id: Result<Path<String>, axum::extract::rejection::PathRejection>,
) -> Result<Response, Problem> {
    caller.must_have(Scope::Admin)?;
    let known = match id {
        Ok(Path(id)) => app.jobs().resend(&id).await.map_err(JobError::from)?,
        Err(_) => false,
    };
    if known {
        return Ok(StatusCode::ACCEPTED.into_response());
    }
    let detail = "no webhook with this id was given up, or its target is no longer set";
    Err(Problem::new(&WEBHOOK_NOT_FOUND, detail))
}
