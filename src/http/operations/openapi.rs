//! `GET /openapi.yaml`

use std::sync::LazyLock;

use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use sha2::{Digest, Sha256};

use super::super::document;
use super::super::etag::ETag;

/// RFC 9512.
const MEDIA_TYPE: HeaderValue = HeaderValue::from_static("application/yaml");

struct Yaml {
    text: String,
    etag: ETag,
}

static YAML: LazyLock<Yaml> = LazyLock::new(|| {
    let text = document::yaml();
    let digest: String = Sha256::digest(&text).iter().map(|byte| format!("{byte:02x}")).collect();
    Yaml { etag: ETag::of_digest(&digest), text }
});

/// This document
#[utoipa::path(
    get,
    path = "/openapi.yaml",
    operation_id = "getOpenApi",
    tag = document::SERVICE,
    params(document::IfNoneMatchHeader),
    responses(document::Document, document::PlainProblems)
)]
pub async fn openapi(headers: HeaderMap) -> Response {
    let yaml = &*YAML;
    let mut response = if yaml.etag.is_known_to(&headers) {
        StatusCode::NOT_MODIFIED.into_response()
    } else {
        ([(header::CONTENT_TYPE, MEDIA_TYPE)], yaml.text.as_str()).into_response()
    };
    response.headers_mut().insert(header::CACHE_CONTROL, HeaderValue::from_static("no-cache"));
    if let Some(etag) = yaml.etag.header() {
        response.headers_mut().insert(header::ETAG, etag);
    }
    response
}
