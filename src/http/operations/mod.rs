//! The API's operations, one a file.

pub mod delete;
pub mod events;
pub mod health;
pub mod limits;
pub mod list;
pub mod metrics;
pub mod openapi;
pub mod result;
pub mod retry;
pub mod status;
pub mod submit;
pub mod webhooks;

use axum::extract::{FromRequestParts, Path};
use axum::http::request::Parts;
use axum::http::{HeaderMap, Method};

use super::App;
use super::access::Caller;
use super::problem::{Problem, job_not_found};
use crate::jobs::store::StoreError;
use crate::jobs::{JobError, JobId};

/// The job in a path.
pub struct Id(JobId);

impl FromRequestParts<App> for Id {
    type Rejection = Problem;

    /// A job that the caller may not see is one that is not there.
    async fn from_request_parts(parts: &mut Parts, app: &App) -> Result<Self, Problem> {
        let path = Path::<String>::from_request_parts(parts, app).await.map_err(|_| job_not_found())?;
        let id = path.parse().map_err(|_| job_not_found())?;
        let caller = caller(parts);
        if caller.bound_to().is_some() {
            let job = match app.jobs().status(id).await {
                Err(JobError::Store(StoreError::Corrupt { .. })) => return Err(job_not_found().about(id)),
                Err(JobError::Expired { owner, .. }) if !caller.may_see(owner.as_deref()) => {
                    return Err(job_not_found().about(id));
                }
                job => job?,
            };
            if !caller.may_see(job.spec.owner.as_deref()) {
                return Err(job_not_found().about(id));
            }
        }
        Ok(Id(id))
    }
}

impl FromRequestParts<App> for Caller {
    type Rejection = std::convert::Infallible;

    async fn from_request_parts(parts: &mut Parts, _: &App) -> Result<Self, Self::Rejection> {
        Ok(caller(parts))
    }
}

/// Whom `access::admit` let in.
fn caller(parts: &Parts) -> Caller {
    parts.extensions.get().cloned().unwrap_or(Caller::Anyone)
}

/// A request's method and conditions, for answers that depend on them.
pub struct Asked {
    method: Method,
    headers: HeaderMap,
}

impl<S: Send + Sync> FromRequestParts<S> for Asked {
    type Rejection = std::convert::Infallible;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Self::Rejection> {
        Ok(Self { method: parts.method.clone(), headers: parts.headers.clone() })
    }
}
