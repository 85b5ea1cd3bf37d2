//! The errors of each operation, out of the catalogue of problems.

use std::collections::BTreeMap;

use serde_json::json;
use utoipa::IntoResponses;
use utoipa::openapi::example::ExampleBuilder;
use utoipa::openapi::{ContentBuilder, Ref, RefOr, Response, ResponseBuilder};

use super::super::problem::*;
use super::responses::header;

/// A list of problem kinds as a type that an operation can name; 400 and 500 belong to every one.
macro_rules! problems {
    ($($(#[$doc:meta])* $name:ident => [$($kind:ident),* $(,)?];)+) => {$(
        $(#[$doc])*
        pub struct $name;

        impl IntoResponses for $name {
            fn responses() -> BTreeMap<String, RefOr<Response>> {
                of(&[MALFORMED_REQUEST, $($kind,)* INTERNAL_ERROR])
            }
        }
    )+};
}

problems! {
    /// Of `POST /v1/jobs`.
    SubmitProblems => [UNAUTHENTICATED, FORBIDDEN, TOO_MANY_CONNECTIONS, KEYS_UNAVAILABLE, UNKNOWN_PARAMETER, INVALID_PARAMETER, UPLOAD_INCOMPLETE, DIGEST_MISMATCH, EMPTY, TRUNCATED, MALFORMED,
        UPLOAD_TIMEOUT, IDEMPOTENCY_IN_FLIGHT, IDEMPOTENCY_KEY_REUSED, UPLOAD_TOO_LARGE, MESH_TOO_LARGE, UNSUPPORTED_MEDIA_TYPE, UNSUPPORTED_CODING, UNSUPPORTED_TRANSFER, UNSUPPORTED_FORMAT,
        NON_FINITE_COORDINATE, INDEX_OUT_OF_RANGE, NO_POLYGONS, UNSUPPORTED_FEATURE, TOO_MANY_JOBS, TOO_MANY_OWN_UPLOADS, QUEUE_FULL, TOO_MANY_UPLOADS, NOT_READY, STORAGE_UNAVAILABLE, STORAGE_FULL,
    ];
    /// Of `GET /v1/jobs`.
    ListProblems => [UNAUTHENTICATED, FORBIDDEN, TOO_MANY_CONNECTIONS, KEYS_UNAVAILABLE, UNKNOWN_PARAMETER, INVALID_PARAMETER, STORAGE_UNAVAILABLE];
    /// Of one job.
    JobProblems => [JOB_EXPIRED, UNAUTHENTICATED, FORBIDDEN, TOO_MANY_CONNECTIONS, KEYS_UNAVAILABLE, JOB_NOT_FOUND, STORAGE_UNAVAILABLE];
    /// Of `DELETE`.
    DeleteProblems => [JOB_EXPIRED, UNAUTHENTICATED, FORBIDDEN, TOO_MANY_CONNECTIONS, KEYS_UNAVAILABLE, JOB_NOT_FOUND, PRECONDITION_FAILED, STORAGE_UNAVAILABLE, STORAGE_FULL];
    /// Of `POST /v1/jobs/{id}/retry`.
    RetryProblems => [JOB_EXPIRED, UNAUTHENTICATED, FORBIDDEN, TOO_MANY_CONNECTIONS, KEYS_UNAVAILABLE, JOB_NOT_FOUND, NOT_RETRYABLE, INPUT_REMOVED, JOB_PURGED, NOT_READY, STORAGE_UNAVAILABLE, STORAGE_FULL];
    /// Of a result. A failed job answers with its own failure.
    ResultProblems => [JOB_EXPIRED, UNAUTHENTICATED, FORBIDDEN, TOO_MANY_CONNECTIONS, KEYS_UNAVAILABLE, JOB_NOT_FOUND, JOB_PURGED, RESULT_NOT_READY, NO_SUCH_FORM, JOB_DISMISSED, PRECONDITION_FAILED, STORAGE_UNAVAILABLE, NOT_ACCEPTABLE, RANGE_NOT_SATISFIABLE, FAILED_JOB_EXAMPLE,
    ];
    /// Of `GET /v1/limits`.
    LimitsProblems => [UNAUTHENTICATED, FORBIDDEN, TOO_MANY_CONNECTIONS, KEYS_UNAVAILABLE];
    /// Of `GET /metrics`.
    MetricsProblems => [UNAUTHENTICATED, FORBIDDEN, KEYS_UNAVAILABLE, STORAGE_UNAVAILABLE];
    /// Of `GET /v1/webhooks/dead`.
    DeadProblems => [UNAUTHENTICATED, FORBIDDEN, TOO_MANY_CONNECTIONS, KEYS_UNAVAILABLE, UNKNOWN_PARAMETER, INVALID_PARAMETER, STORAGE_UNAVAILABLE];
    /// Of `POST /v1/webhooks/dead/{id}/resend`.
    ResendProblems => [UNAUTHENTICATED, FORBIDDEN, TOO_MANY_CONNECTIONS, KEYS_UNAVAILABLE, WEBHOOK_NOT_FOUND, STORAGE_UNAVAILABLE, STORAGE_FULL];
    /// Of `GET /healthz` and `GET /openapi.yaml`.
    PlainProblems => [];
    /// Of `GET /readyz`.
    ReadyProblems => [NOT_READY];
}

/// Those that may go better later.
const LATER: [Kind; 9] = [
    TOO_MANY_CONNECTIONS,
    KEYS_UNAVAILABLE,
    NOT_READY,
    STORAGE_UNAVAILABLE,
    IDEMPOTENCY_IN_FLIGHT,
    TOO_MANY_JOBS,
    TOO_MANY_OWN_UPLOADS,
    QUEUE_FULL,
    TOO_MANY_UPLOADS,
];

/// A failed job's result answers with the failure that the job's status has as `error`.
const FAILED_JOB_EXAMPLE: Kind = Kind {
    word: "not-tubular",
    status: axum::http::StatusCode::UNPROCESSABLE_ENTITY,
    title: "The job failed: its own problem, as in the job's status",
};

/// One response a status, with an example of each kind that has it.
fn of(kinds: &[Kind]) -> BTreeMap<String, RefOr<Response>> {
    let mut by_status: BTreeMap<u16, Vec<&Kind>> = BTreeMap::new();
    for kind in kinds {
        by_status.entry(kind.status.as_u16()).or_default().push(kind);
    }
    let responses =
        by_status.into_iter().map(|(status, kinds)| (status.to_string(), RefOr::T(response(&kinds))));
    responses.collect()
}

fn response(kinds: &[&Kind]) -> Response {
    let titles: Vec<&str> = kinds.iter().map(|kind| kind.title).collect();
    let examples = kinds.iter().map(|kind| {
        let value = json!({
            "type": format!("{TYPE_PREFIX}{}", kind.word),
            "title": kind.title,
            "status": kind.status.as_u16(),
            "detail": "what was found, and what to do",
        });
        (kind.word, ExampleBuilder::new().value(Some(value)).build())
    });
    let content = ContentBuilder::new()
        .schema(Some(Ref::from_schema_name("Problem")))
        .examples_from_iter(examples)
        .build();
    let mut response = ResponseBuilder::new().description(titles.join("; ")).content(MEDIA_TYPE, content);
    for kind in kinds {
        response = match *kind {
            kind if *kind == UNAUTHENTICATED => response.header(
                "WWW-Authenticate",
                header("`Bearer`, with `error` where a key or token was sent (RFC 6750)"),
            ),
            kind if *kind == UNSUPPORTED_MEDIA_TYPE => {
                response.header("Accept", header("What to send instead"))
            }
            kind if *kind == RANGE_NOT_SATISFIABLE => {
                response.header("Content-Range", header("The length of the result: `bytes */1234`"))
            }
            kind if LATER.contains(kind) => {
                response.header("Retry-After", header("Seconds after which to try again"))
            }
            kind if *kind == RESULT_NOT_READY => {
                response.header("Retry-After", header("Of an active job: seconds after which to ask again"))
            }
            _ => response,
        };
    }
    response.build()
}
