//! Who asks, and whether they may: API keys and tokens, their scopes, and whose job is whose.

mod broken;
mod discovery;
mod fetching;
mod gate;
mod jwks;
mod jwt;
mod key_set;
mod keys;
mod ring;

use std::panic::{AssertUnwindSafe, resume_unwind};
use std::sync::Arc;
use std::time::Duration;

use axum::extract::{Request, State};
use axum::http::{HeaderMap, Method, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use futures::FutureExt;
use tokio_util::sync::CancellationToken;

use super::App;
use super::audit::{Occurrence, is_told};
use super::problem::{FORBIDDEN, INTERNAL_ERROR, KEYS_UNAVAILABLE, Problem, UNAUTHENTICATED};
use super::trace::job_in_path;
use crate::jobs::JobId;

pub use discovery::{Discovery, DiscoveryError};
pub(super) use gate::IssuerKeys;
use gate::Unknown;
pub use gate::{Gate, GateError};
pub use jwks::{JwksError, JwksSource};
pub use jwt::Issuer;
pub use keys::{Key, KeyError, KeyFile, Scope};
pub use ring::KeyRing;

/// Who sent a request.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Caller {
    /// There is no authentication: whoever reaches the service.
    Anyone,
    /// The holder of a key or a token.
    Principal(Arc<Principal>),
}

/// The holder of a key, or the subject of a token. Jobs belong to the name, so that they stay when a key is rotated.
#[derive(Debug, PartialEq, Eq)]
pub struct Principal {
    pub name: String,
    pub scopes: Vec<Scope>,
}

impl Caller {
    /// Whom a job belongs to that this caller submits.
    pub fn owner(&self) -> Option<&str> {
        match self {
            Caller::Anyone => None,
            Caller::Principal(principal) => Some(&principal.name),
        }
    }

    fn has(&self, scope: Scope) -> bool {
        match self {
            Caller::Anyone => true,
            Caller::Principal(principal) => {
                principal.scopes.contains(&scope) || principal.scopes.contains(&Scope::Admin)
            }
        }
    }

    /// # Errors
    /// 403 where the scope is missing.
    pub(super) fn must_have(&self, scope: Scope) -> Result<(), Problem> {
        if self.has(scope) { Ok(()) } else { Err(forbidden(scope)) }
    }

    /// The one owner whose jobs this caller may see; `None`: it may see all.
    pub fn bound_to(&self) -> Option<&str> {
        if self.has(Scope::Admin) { None } else { self.owner() }
    }

    /// Whether this caller may see a job of `owner`.
    pub fn may_see(&self, owner: Option<&str>) -> bool {
        self.bound_to().is_none_or(|name| owner == Some(name))
    }
}

/// Seconds after which to try again where the keys cannot be read.
const RETRY_AFTER: u32 = 10;

/// How often it is looked at whether a request that waits would still be let in.
const LOOK: Duration = Duration::from_secs(2);

/// Ready once a request that waits for news would no longer be let in, with what it is told then: its key was revoked
/// or exchanged, or its token has run out.
pub(super) async fn shut_out(app: &App, caller: &Caller, headers: &HeaderMap) -> Problem {
    let Some(gate) = app.gate() else { return std::future::pending().await };
    let mut is_doubted = false;
    loop {
        tokio::time::sleep(LOOK).await;
        match gate.caller(bearer(headers)).await {
            Ok(now) if now == *caller => is_doubted = false,
            Ok(_) => return unauthenticated(&Unknown::Key),
            // A file that could not be read once, as it was just being exchanged, ends nothing.
            Err(reason) if reason.is_open() && !is_doubted => is_doubted = true,
            Err(reason) => return unauthenticated(&reason),
        }
    }
}

/// Cancelled when the client of a request no longer waits for its answer.
#[derive(Debug, Clone)]
pub struct Left(pub CancellationToken);

/// Whether a path is one of the API's, about jobs and what belongs to them.
pub(super) fn is_of_api(path: &str) -> bool {
    path.starts_with("/v1/")
}

/// Lets a request for `/v1` or `/metrics` through, and tells the audit trail of it, once its caller is known and may do what
/// it asks for.
///
/// What may change something has a task of its own: it is done and told to its end, also when the client hangs up.
pub async fn admit(State(app): State<App>, mut request: Request, next: Next) -> Response {
    let path = request.uri().path();
    if !is_of_api(path) && path != "/metrics" {
        return next.run(request).await;
    }
    if request.method().is_safe() {
        return answered(app, request, next).await;
    }
    let left = CancellationToken::new();
    request.extensions_mut().insert(Left(left.clone()));
    let _left = left.drop_guard();
    let requests = app.requests().clone();
    match requests.spawn(answered(app, request, next)).await {
        Ok(response) => response,
        Err(error) => match error.try_into_panic() {
            // On to where panics become answers.
            Ok(panic) => resume_unwind(panic),
            Err(_) => {
                Problem::new(&INTERNAL_ERROR, "the service ends; send the request again").into_response()
            }
        },
    }
}

/// The answer, with its line in the trail.
async fn answered(app: App, mut request: Request, next: Next) -> Response {
    let path = request.uri().path().to_owned();
    let (method, peer) = (request.method().clone(), request.extensions().get().copied());
    let (outcome, caller) = match check(&app, &method, request.headers()).await {
        Ok(caller) => {
            request.extensions_mut().insert(caller.clone());
            (AssertUnwindSafe(next.run(request)).catch_unwind().await, Some(caller))
        }
        Err(Refused { problem, caller }) => (Ok(problem.into_response()), caller),
    };
    let (status, named) = match &outcome {
        Ok(response) => (response.status(), response.extensions().get::<JobId>().copied()),
        Err(_) => (StatusCode::INTERNAL_SERVER_ERROR, None),
    };
    let job = job_in_path(&path).or(named);
    // Polls, most of all requests, need no thread.
    if !is_told(&method, &path, status) {
        return outcome.unwrap_or_else(|panic| resume_unwind(panic));
    }
    // Written off the async threads, and before the answer begins.
    let told = tokio::task::spawn_blocking(move || {
        let user = caller.as_ref().and_then(Caller::owner);
        if let Some(trail) = app.trail() {
            trail.tell(&Occurrence { method: &method, path: &path, status, user, peer, job });
        }
    });
    if let Err(error) = told.await {
        tracing::error!(%error, "the audit trail cannot be added to");
    }
    outcome.unwrap_or_else(|panic| resume_unwind(panic))
}

/// Why a request is not let in, and whose it is where that is known.
struct Refused {
    problem: Problem,
    caller: Option<Caller>,
}

async fn check(app: &App, method: &Method, headers: &HeaderMap) -> Result<Caller, Refused> {
    let Some(gate) = app.gate() else { return Ok(Caller::Anyone) };
    let caller = gate.caller(bearer(headers)).await;
    let caller = caller.map_err(|reason| Refused { problem: unauthenticated(&reason), caller: None })?;
    let scope = if matches!(*method, Method::GET | Method::HEAD) { Scope::Read } else { Scope::Submit };
    if caller.has(scope) {
        return Ok(caller);
    }
    Err(Refused { problem: forbidden(scope), caller: Some(caller) })
}

/// The token of `Authorization: Bearer` (RFC 6750), where the header is there once.
fn bearer(headers: &HeaderMap) -> Option<&str> {
    let mut values = headers.get_all(header::AUTHORIZATION).iter();
    let (Some(value), None) = (values.next(), values.next()) else { return None };
    let (scheme, token) = value.to_str().ok()?.split_once(' ')?;
    scheme.eq_ignore_ascii_case("bearer").then(|| token.trim())
}

/// 401, as RFC 6750, section 3, has it: an error is named only where something was sent. 503 where it is not known
/// whether the key is wrong: a client must not throw a valid one away.
fn unauthenticated(reason: &Unknown) -> Problem {
    if reason.is_open() {
        let detail = format!("{reason}; try again later, the service's operator must see to them");
        return Problem::new(&KEYS_UNAVAILABLE, detail).header(header::RETRY_AFTER, RETRY_AFTER);
    }
    let challenge = match reason {
        Unknown::Nobody => "Bearer realm=\"rosaline\"".to_owned(),
        reason => {
            format!("Bearer realm=\"rosaline\", error=\"invalid_token\", error_description=\"{reason}\"")
        }
    };
    let todo = match reason {
        // Whoever has one got it from there, and no operator makes another.
        Unknown::Token(_) => "get a token from the issuer and send it as 'Authorization: Bearer ...'",
        _ => "send a valid key or token as 'Authorization: Bearer ...'. The operator makes keys",
    };
    let detail = format!("{reason}; {todo}");
    Problem::new(&UNAUTHENTICATED, detail).header(header::WWW_AUTHENTICATE, challenge)
}

fn forbidden(scope: Scope) -> Problem {
    let name = scope.name();
    let challenge = format!("Bearer realm=\"rosaline\", error=\"insufficient_scope\", scope=\"{name}\"");
    let detail = format!("the key or token lacks the scope '{name}'; ask for one that has it");
    Problem::new(&FORBIDDEN, detail).with("scope", name).header(header::WWW_AUTHENTICATE, challenge)
}
