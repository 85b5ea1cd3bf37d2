//! Every kind of problem that the service answers with, beside the failures that jobs store.

use axum::http::StatusCode;

use super::Kind;

/// Declares the kinds and the list of them all.
macro_rules! kinds {
    ($($name:ident = $status:ident, $word:literal, $title:literal;)+) => {
        $(pub const $name: Kind = Kind { word: $word, status: StatusCode::$status, title: $title };)+

        /// Every kind, for the API's documentation.
        pub const ALL: &[Kind] = &[$($name),+];
    };
}

kinds! {
    // Requests.
    MALFORMED_REQUEST = BAD_REQUEST, "malformed-request", "The request cannot be read";
    UNKNOWN_PARAMETER = BAD_REQUEST, "unknown-parameter", "There is no such parameter";
    INVALID_PARAMETER = BAD_REQUEST, "invalid-parameter", "A parameter has a value that it cannot take";
    UNAUTHENTICATED = UNAUTHORIZED, "unauthenticated", "The request has no valid key or token";
    FORBIDDEN = FORBIDDEN, "forbidden", "The key or token does not allow this";
    UPLOAD_INCOMPLETE = BAD_REQUEST, "upload-incomplete", "The upload broke off";
    DIGEST_MISMATCH = BAD_REQUEST, "digest-mismatch", "The body is not the one that its digest is of";
    NOT_RETRYABLE = CONFLICT, "not-retryable", "The job did not fail";
    IDEMPOTENCY_IN_FLIGHT = CONFLICT, "idempotency-in-flight", "A request with this key is under way";
    IDEMPOTENCY_KEY_REUSED = UNPROCESSABLE_ENTITY, "idempotency-key-reused",
        "The key was used for another request";
    NOT_FOUND = NOT_FOUND, "not-found", "There is nothing at this path";
    JOB_NOT_FOUND = NOT_FOUND, "job-not-found", "There is no such job";
    NO_SUCH_FORM = NOT_FOUND, "no-such-form", "The result is not there in this form";
    RESULT_NOT_READY = NOT_FOUND, "result-not-ready", "The job has no result yet";
    JOB_DISMISSED = NOT_FOUND, "job-dismissed", "The job was cancelled and has no result";
    JOB_EXPIRED = GONE, "job-expired", "The job was kept for its time and is gone";
    INPUT_REMOVED = CONFLICT, "input-removed", "The job's mesh is no longer kept";
    WEBHOOK_NOT_FOUND = NOT_FOUND, "webhook-not-found", "There is no such webhook that was given up";
    JOB_PURGED = GONE, "job-purged", "The job was purged";
    METHOD_NOT_ALLOWED = METHOD_NOT_ALLOWED, "method-not-allowed", "The method does not apply to this path";
    NOT_ACCEPTABLE = NOT_ACCEPTABLE, "not-acceptable", "The result has no form that the client accepts";
    UPLOAD_TIMEOUT = REQUEST_TIMEOUT, "upload-timeout", "The upload stood still for too long";
    UPLOAD_TOO_LARGE = PAYLOAD_TOO_LARGE, "upload-too-large", "The upload is larger than the limit";
    UNSUPPORTED_MEDIA_TYPE = UNSUPPORTED_MEDIA_TYPE, "unsupported-media-type",
        "The content type is not one that jobs are made from";
    UNSUPPORTED_CODING = UNSUPPORTED_MEDIA_TYPE, "unsupported-coding", "The body came compressed";
    UNSUPPORTED_TRANSFER = NOT_IMPLEMENTED, "unsupported-transfer", "The body came in a transfer coding that is not read";
    PRECONDITION_FAILED = PRECONDITION_FAILED, "precondition-failed",
        "The job or its result is not in the state that the request is for";
    RANGE_NOT_SATISFIABLE = RANGE_NOT_SATISFIABLE, "range-not-satisfiable",
        "The range lies outside of the result";
    // Meshes, in the words of the readers' errors.
    EMPTY = BAD_REQUEST, "empty", "The upload is empty";
    UNSUPPORTED_FORMAT = UNSUPPORTED_MEDIA_TYPE, "unsupported-format", "The content is not a mesh format";
    TRUNCATED = BAD_REQUEST, "truncated", "The mesh file ends early";
    MALFORMED = BAD_REQUEST, "malformed", "The mesh file breaks its format's rules";
    NON_FINITE_COORDINATE = UNPROCESSABLE_ENTITY, "non-finite-coordinate",
        "The mesh has a coordinate that is not a finite number";
    INDEX_OUT_OF_RANGE = UNPROCESSABLE_ENTITY, "index-out-of-range",
        "The mesh has a face that refers to a missing vertex";
    NO_POLYGONS = UNPROCESSABLE_ENTITY, "no-polygons", "The mesh file holds no polygons";
    UNSUPPORTED_FEATURE = UNPROCESSABLE_ENTITY, "unsupported-feature",
        "The mesh file uses a feature that is not read";
    MESH_TOO_LARGE = PAYLOAD_TOO_LARGE, "too-large", "The mesh is larger than the limits";
    TOO_MANY_JOBS = TOO_MANY_REQUESTS, "too-many-jobs", "The caller has as many active jobs as it may";
    TOO_MANY_OWN_UPLOADS = TOO_MANY_REQUESTS, "too-many-own-uploads",
        "The caller has as many uploads under way as it may";
    // The service.
    QUEUE_FULL = SERVICE_UNAVAILABLE, "queue-full", "As many jobs wait as may";
    TOO_MANY_CONNECTIONS = SERVICE_UNAVAILABLE, "too-many-connections", "As many connections are open as may";
    TOO_MANY_UPLOADS = SERVICE_UNAVAILABLE, "too-many-uploads", "As many uploads come in as may";
    INTERNAL_ERROR = INTERNAL_SERVER_ERROR, "internal-error", "The service failed";
    KEYS_UNAVAILABLE = SERVICE_UNAVAILABLE, "keys-unavailable", "The service cannot read its keys";
    NOT_READY = SERVICE_UNAVAILABLE, "not-ready", "The service is not ready for work";
    STORAGE_UNAVAILABLE = SERVICE_UNAVAILABLE, "storage-unavailable",
        "The service cannot use its storage";
    STORAGE_FULL = INSUFFICIENT_STORAGE, "storage-full", "The service's disk is full";
}
