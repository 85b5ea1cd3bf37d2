//! `GET /v1/jobs/{id}/events`

use std::convert::Infallible;
use std::time::Duration;

use axum::extract::State;
use axum::http::{HeaderName, HeaderValue, StatusCode, header};
use axum::response::sse::{Event, KeepAlive, Sse};
use axum::response::{IntoResponse, Response};
use futures::future::BoxFuture;
use futures::{FutureExt, stream};

use super::super::access::{self, Caller};
use super::super::document::{self, JobProblems};
use super::super::{App, Problem};
use super::status::represent;
use super::{Asked, Id};
use crate::jobs::Job;

pub const LAST_EVENT_ID: HeaderName = HeaderName::from_static("last-event-id");

/// A comment is sent after this long without an event, so that neither end takes the connection for dead.
const KEEP_ALIVE: Duration = Duration::from_secs(15);
/// How long one wait for a change lasts; a new one follows.
const WAIT: Duration = Duration::from_secs(60);

/// A job's changes as they come
///
/// Server-sent events (WHATWG HTML): the job's status at once, then after each change, until it has ended, or the key or
/// token of the request is no longer valid. Each event is `status` with the whole status as its data, so that one that was missed is made up for by the next.
/// A client that comes back with the `Last-Event-ID` of the present status is told nothing twice; where the job has
/// ended, it gets a 204, which ends an `EventSource`.
#[utoipa::path(
    get,
    path = "/v1/jobs/{id}/events",
    operation_id = "getEvents",
    tag = document::JOBS,
    params(document::JobPath, document::LastEventHeader),
    responses(document::Events, JobProblems)
)]
pub async fn events(
    State(app): State<App>,
    Id(id): Id,
    caller: Caller,
    asked: Asked,
) -> Result<Response, Problem> {
    let job = app.jobs().status(id).await?;
    let told = asked.headers.get(LAST_EVENT_ID).and_then(|value| value.to_str().ok()).map(str::to_owned);
    if !job.status.is_active() && told.as_ref() == Some(&event_id(&job)) {
        return Ok(StatusCode::NO_CONTENT.into_response());
    }
    let expelled = {
        let (app, headers) = (app.clone(), asked.headers);
        async move { drop(access::shut_out(&app, &caller, &headers).await) }.boxed()
    };
    let follower = Follower { app, expelled, told, step: Step::Tell(Box::new(job)) };
    let events = stream::unfold(follower, |follower| follower.next());
    let mut response = Sse::new(events).keep_alive(KeepAlive::new().interval(KEEP_ALIVE)).into_response();
    response.headers_mut().insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
    Ok(response)
}

/// One client that follows one job.
struct Follower {
    app: App,
    /// Ready when its key or token is no longer valid. One for all waits: changes that come fast do not put it off.
    expelled: BoxFuture<'static, ()>,
    /// The id of the event that it got last.
    told: Option<String>,
    step: Step,
}

enum Step {
    Tell(Box<Job>),
    Wait(Box<Job>),
    End,
}

impl Follower {
    async fn next(mut self) -> Option<(Result<Event, Infallible>, Self)> {
        loop {
            self.step = match self.step {
                Step::Tell(job) => {
                    let (id, body) = (event_id(&job), represent(&job).0);
                    let after = if job.status.is_active() { Step::Wait(job) } else { Step::End };
                    if self.told.as_ref() != Some(&id) {
                        // JSON is UTF-8 on one line.
                        let event =
                            Event::default().event("status").id(&id).data(String::from_utf8_lossy(&body));
                        self.told = Some(id);
                        self.step = after;
                        return Some((Ok(event), self));
                    }
                    after
                }
                Step::Wait(job) => tokio::select! {
                    biased;
                    () = self.app.closing().cancelled() => Step::End,
                    // It may come back, and is told why not then.
                    () = &mut self.expelled => Step::End,
                    // A job that was purged has no further changes.
                    next = self.app.jobs().wait_change(&job, WAIT) => {
                        next.map_or(Step::End, |next| Step::Tell(Box::new(next)))
                    }
                },
                Step::End => return None,
            };
        }
    }
}

/// Equal for equal statuses, also after a restart.
fn event_id(job: &Job) -> String {
    represent(job).1.to_string().trim_matches('"').chars().take(32).collect()
}
