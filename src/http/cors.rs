//! Cross-origin access for browsers (Fetch, section 3.3).

use std::time::Duration;

use axum::http::{HeaderName, Method, header};
use tower_http::cors::{Any, CorsLayer};

use super::digest::CONTENT_DIGEST;
use super::idempotency::IDEMPOTENCY_KEY;
use super::operations::events::LAST_EVENT_ID;
use super::operations::submit::REQUEST_ID;
use super::prefer::{PREFER, PREFERENCE_APPLIED};
use crate::jobs::TRACEPARENT;

/// How long a browser may keep the answer to a preflight; Chromium caps it at two hours.
const PREFLIGHT_AGE: Duration = Duration::from_secs(2 * 60 * 60);

/// The request headers that the API reads, beside those that Fetch always allows.
pub const REQUEST_HEADERS: [HeaderName; 13] = [
    header::ACCEPT,
    header::AUTHORIZATION,
    header::CONTENT_TYPE,
    LAST_EVENT_ID,
    header::IF_MATCH,
    header::IF_NONE_MATCH,
    header::IF_RANGE,
    header::RANGE,
    CONTENT_DIGEST,
    IDEMPOTENCY_KEY,
    PREFER,
    REQUEST_ID,
    HeaderName::from_static(TRACEPARENT),
];

/// The response headers that a script may read, beside those that Fetch always exposes.
pub const RESPONSE_HEADERS: [HeaderName; 12] = [
    header::ACCEPT_RANGES,
    header::WWW_AUTHENTICATE,
    header::ALLOW,
    header::CONTENT_ENCODING,
    header::CONTENT_LENGTH,
    header::CONTENT_LOCATION,
    header::CONTENT_RANGE,
    header::ETAG,
    header::LINK,
    header::LOCATION,
    header::RETRY_AFTER,
    PREFERENCE_APPLIED,
];

/// Any page may call the API: it has no cookies that a foreign page could ride on.
pub fn layer() -> CorsLayer {
    CorsLayer::new()
        .allow_origin(Any)
        .allow_methods([Method::GET, Method::HEAD, Method::POST, Method::DELETE])
        .allow_headers(REQUEST_HEADERS)
        .expose_headers(RESPONSE_HEADERS)
        .max_age(PREFLIGHT_AGE)
}
