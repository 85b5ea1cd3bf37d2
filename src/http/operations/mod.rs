//! The API's operations, one a file.

pub mod delete;
pub mod events;
pub mod health;
pub mod limits;
pub mod list;
pub mod openapi;
pub mod result;
pub mod retry;
pub mod status;
pub mod submit;

use axum::extract::{FromRequestParts, Path};
use axum::http::request::Parts;
use axum::http::{HeaderMap, Method};

use super::problem::{Problem, job_not_found};
use crate::jobs::JobId;

/// The job in a path.
pub struct Id(JobId);

impl<S: Send + Sync> FromRequestParts<S> for Id {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Problem> {
        let path = Path::<String>::from_request_parts(parts, state).await.map_err(|_| job_not_found())?;
        path.parse().map(Id).map_err(|_| job_not_found())
    }
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
