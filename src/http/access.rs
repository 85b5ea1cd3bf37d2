//! Who asks, and whether they may: API keys, their scopes, and whose job is whose.

mod keys;
mod ring;

use std::sync::Arc;

use axum::extract::{Request, State};
use axum::http::{HeaderMap, Method, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use super::App;
use super::audit::Occurrence;
use super::problem::{FORBIDDEN, Problem, UNAUTHENTICATED};
use super::trace::job_in_path;
use crate::jobs::JobId;

pub use keys::{Key, KeyError, KeyFile, Scope};
pub use ring::KeyRing;

/// Who sent a request.
#[derive(Debug, Clone)]
pub enum Caller {
    /// There is no authentication: whoever reaches the service.
    Anyone,
    /// The holder of a key.
    Principal(Arc<Principal>),
}

/// The holder of a key. Jobs belong to the name, so that they stay when the key is rotated.
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

    /// The one owner whose jobs this caller may see; `None`: it may see all.
    pub fn bound_to(&self) -> Option<&str> {
        if self.has(Scope::Admin) { None } else { self.owner() }
    }

    /// Whether this caller may see a job of `owner`.
    pub fn may_see(&self, owner: Option<&str>) -> bool {
        self.bound_to().is_none_or(|name| owner == Some(name))
    }
}

/// Lets a request for `/v1` or `/metrics` through, and tells the audit trail of it, once its caller is known and may do what it asks for.
pub async fn admit(State(app): State<App>, mut request: Request, next: Next) -> Response {
    let path = request.uri().path().to_owned();
    if !path.starts_with("/v1/") && path != "/metrics" {
        return next.run(request).await;
    }
    let (method, peer) = (request.method().clone(), request.extensions().get().copied());
    let (response, caller) = match check(&app, &method, request.headers()) {
        Ok(caller) => {
            request.extensions_mut().insert(caller.clone());
            (next.run(request).await, Some(caller))
        }
        Err(problem) => (problem.into_response(), None),
    };
    let job = job_in_path(&path).or_else(|| response.extensions().get::<JobId>().copied());
    let status = response.status();
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
    response
}

fn check(app: &App, method: &Method, headers: &HeaderMap) -> Result<Caller, Problem> {
    let Some(ring) = app.keys() else { return Ok(Caller::Anyone) };
    let caller = match ring.caller(bearer(headers)) {
        Some(caller) => caller,
        None => return Err(unauthenticated()),
    };
    let scope = if matches!(*method, Method::GET | Method::HEAD) { Scope::Read } else { Scope::Submit };
    if caller.has(scope) {
        return Ok(caller);
    }
    let detail = format!("this key lacks the scope '{}'; ask the operator for one that has it", scope.name());
    Err(Problem::new(&FORBIDDEN, detail).with("scope", scope.name()))
}

/// The token of `Authorization: Bearer` (RFC 6750), where the header is there once.
fn bearer(headers: &HeaderMap) -> Option<&str> {
    let mut values = headers.get_all(header::AUTHORIZATION).iter();
    let (Some(value), None) = (values.next(), values.next()) else { return None };
    let (scheme, token) = value.to_str().ok()?.split_once(' ')?;
    scheme.eq_ignore_ascii_case("bearer").then(|| token.trim())
}

/// The same whether there was no key, a wrong one or a revoked one.
fn unauthenticated() -> Problem {
    let detail =
        "send a valid key as 'Authorization: Bearer KEY'; the operator makes one with 'rosaline keys add'";
    Problem::new(&UNAUTHENTICATED, detail).header(header::WWW_AUTHENTICATE, "Bearer realm=\"rosaline\"")
}
