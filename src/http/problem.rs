//! Errors as problem details (RFC 9457).

mod failures;
mod kinds;

use std::collections::BTreeMap;

use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use serde_json::Value;
use utoipa::ToSchema;

use crate::jobs::{JobFailure, JobId};

pub use failures::job_not_found;
pub use kinds::*;

/// Media type of every error's body.
pub const MEDIA_TYPE: &str = "application/problem+json";

/// What every `type` starts with; the rest is the kind's word.
pub const TYPE_PREFIX: &str = "urn:rosaline:problem:";

/// A kind of problem: one `type`, with the title and status that all its occurrences share.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Kind {
    /// The stable word at the end of `type`.
    pub word: &'static str,
    pub status: StatusCode,
    pub title: &'static str,
}

/// An error as the client sees it.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(transparent)]
pub struct Problem(Box<Details>);

/// What went wrong (RFC 9457).
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[schema(as = Problem)]
pub struct Details {
    /// A stable URI that names the kind of problem: `urn:rosaline:problem:` and a word.
    #[serde(rename = "type")]
    #[schema(example = "urn:rosaline:problem:job-not-found")]
    kind: String,
    /// What the kind means, the same in every occurrence.
    #[schema(example = "There is no such job")]
    title: String,
    /// The HTTP status code.
    #[serde(serialize_with = "status_number")]
    #[schema(value_type = u16, minimum = 400, maximum = 599, example = 404)]
    status: StatusCode,
    /// What was found in this request and what to do.
    #[schema(example = "no job has this id; it may have been deleted")]
    detail: String,
    /// The job that the problem is about, where there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(example = "/v1/jobs/019aa8b6-7a42-7d52-8d53-2f8ad3a2b9c1")]
    instance: Option<String>,
    /// What this kind adds: `limit`, `parameter`, `accepted`, `available`, `job_status`.
    #[serde(flatten)]
    #[schema(additional_properties)]
    extras: BTreeMap<&'static str, Value>,
    #[serde(skip)]
    #[schema(ignore)]
    headers: HeaderMap,
}

fn status_number<S: serde::Serializer>(status: &StatusCode, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_u16(status.as_u16())
}

impl Problem {
    /// An occurrence of `kind`; `detail` says what was found and what to do.
    pub fn new(kind: &Kind, detail: impl Into<String>) -> Self {
        Self::of(kind.word, kind.title, kind.status, detail.into())
    }

    fn of(word: &str, title: &str, status: StatusCode, detail: String) -> Self {
        Self(Box::new(Details {
            kind: format!("{TYPE_PREFIX}{word}"),
            title: title.to_owned(),
            status,
            detail,
            instance: None,
            extras: BTreeMap::new(),
            headers: HeaderMap::new(),
        }))
    }

    /// Adds a member of its own.
    pub fn with(mut self, name: &'static str, value: impl Into<Value>) -> Self {
        self.0.extras.insert(name, value.into());
        self
    }

    /// Adds a header to the response.
    pub fn header(mut self, name: HeaderName, value: impl TryInto<HeaderValue>) -> Self {
        if let Ok(value) = value.try_into() {
            self.0.headers.insert(name, value);
        }
        self
    }

    /// Names the job as the problem's `instance`.
    pub fn about(mut self, job: JobId) -> Self {
        self.0.instance = Some(format!("/v1/jobs/{job}"));
        self
    }

    pub fn status(&self) -> StatusCode {
        self.0.status
    }
}

impl From<&JobFailure> for Problem {
    /// The failure's own problem, as it was stored with the job; of a kind that requests are refused with too,
    /// in that kind's words.
    fn from(failure: &JobFailure) -> Self {
        if let Some(kind) = ALL.iter().find(|kind| kind.word == failure.code) {
            return Problem::new(kind, failure.detail.clone());
        }
        let status = StatusCode::from_u16(failure.status).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR);
        Self::of(&failure.code, &failure.title, status, failure.detail.clone())
    }
}

impl IntoResponse for Problem {
    fn into_response(mut self) -> Response {
        let headers = std::mem::take(&mut self.0.headers);
        // A struct of strings and numbers always serialises; an empty body is the honest rest.
        let body = serde_json::to_vec(&self).unwrap_or_default();
        let mut response = (self.0.status, body).into_response();
        response.headers_mut().extend(headers);
        response.headers_mut().insert(header::CONTENT_TYPE, HeaderValue::from_static(MEDIA_TYPE));
        response.headers_mut().insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
        response
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn members_are_those_of_rfc_9457_and_the_extras_stand_beside_them() {
        let problem = Problem::new(&UPLOAD_TOO_LARGE, "the upload is too large").with("limit", 5);
        let value = serde_json::to_value(&problem).unwrap();
        let expected = serde_json::json!({
            "type": "urn:rosaline:problem:upload-too-large", "title": UPLOAD_TOO_LARGE.title, "status": 413,
            "detail": "the upload is too large", "limit": 5,
        });
        assert_eq!(value, expected);
    }

    #[test]
    fn a_failed_job_keeps_its_own_problem() {
        let failure = JobFailure::new("not-tubular", 422, "No tube", "it is a sphere");
        let problem = Problem::from(&failure);
        assert_eq!(problem.status(), StatusCode::UNPROCESSABLE_ENTITY);
        assert_eq!(serde_json::to_value(&problem).unwrap()["type"], "urn:rosaline:problem:not-tubular");
    }

    #[test]
    fn words_are_unique_and_statuses_are_errors() {
        for (place, kind) in ALL.iter().enumerate() {
            assert!(kind.status.is_client_error() || kind.status.is_server_error(), "{}", kind.word);
            assert!(ALL[..place].iter().all(|other| other.word != kind.word), "{} twice", kind.word);
        }
    }
}
