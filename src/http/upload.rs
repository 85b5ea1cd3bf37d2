//! Takes a mesh and its parameters out of a request: a raw body, or a multipart form.

mod body;
mod multipart;
mod overhead;

use axum::extract::Request;
use axum::http::{HeaderMap, header};

use super::parameters::{Asked, query_pairs};
use super::problem::{
    Problem, UNSUPPORTED_CODING, UNSUPPORTED_MEDIA_TYPE, UNSUPPORTED_TRANSFER, UPLOAD_TOO_LARGE,
};
use super::{App, digest};
use crate::jobs::{FormatHint, Upload};

/// The media types of a raw body.
pub const MESH_TYPES: [&str; 7] =
    ["model/stl", "model/obj", "model/ply", "model/gltf-binary", "model/gltf+json", "model/vtk", ANY_TYPE];

/// The mesh's format is found from its content alone.
pub const ANY_TYPE: &str = "application/octet-stream";

/// A form with the parts `mesh` and `parameters`.
pub const FORM_TYPE: &str = "multipart/form-data";

/// What a form adds to its mesh at most, beside the parameters: boundaries and part headers.
const FORM_OVERHEAD: u64 = 64 << 10;

/// A mesh on disk, and what is to be done with it.
pub struct Received {
    pub upload: Upload,
    pub asked: Asked,
    pub hint: FormatHint,
    /// Whom the job will belong to.
    pub owner: Option<String>,
}

/// Streams the request's mesh to disk.
///
/// # Errors
/// 400, 408, 413, 415 or 501, before or while the body comes in; nothing of it is kept then.
pub async fn receive(app: &App, request: Request) -> Result<Received, Problem> {
    let content_type = content_type(request.headers())?;
    refuse_coding(request.headers())?;
    refuse_transfer(request.headers())?;
    let query = query_pairs(request.uri())?;
    // Refuses a wrong query before the body is read.
    Asked::from_pairs(&query, app.limits())?;
    let is_form = content_type == FORM_TYPE;
    let extra = if is_form { app.limits().parameters_bytes as u64 + FORM_OVERHEAD } else { 0 };
    check_length(app, request.headers(), extra)?;
    if is_form {
        return multipart::receive(app, request, query).await;
    }
    let asked = Asked::from_pairs(&query, app.limits())?;
    let expected = digest::sha256(request.headers())?;
    let upload = body::store(app, request.into_body()).await?;
    digest::check(expected.as_deref(), upload.sha256())?;
    let hint = FormatHint { extension: None, content_type: Some(content_type) };
    Ok(Received { upload, asked, hint, owner: None })
}

/// So much of a content type that was not taken is told back.
const LONGEST_TYPE: usize = 64;

/// The essence of `Content-Type`, in lower case; a body without one is taken by its content.
fn content_type(headers: &HeaderMap) -> Result<String, Problem> {
    let Some(value) = headers.get(header::CONTENT_TYPE) else { return Ok(ANY_TYPE.to_owned()) };
    let text = value.to_str().unwrap_or_default();
    let essence = text.split(';').next().unwrap_or_default().trim().to_ascii_lowercase();
    if essence == FORM_TYPE || MESH_TYPES.contains(&essence.as_str()) {
        return Ok(essence);
    }
    let accepted = [&MESH_TYPES[..], &[FORM_TYPE]].concat().join(", ");
    let shown = |c: &char| c.is_ascii_graphic() || *c == ' ';
    let found: String = essence.chars().filter(shown).take(LONGEST_TYPE).collect();
    let came = if found.is_empty() { "no type that can be read".to_owned() } else { format!("'{found}'") };
    let detail = format!("the body came as {came}; send a mesh as one of {accepted}");
    Err(Problem::new(&UNSUPPORTED_MEDIA_TYPE, detail)
        .with("accepted", [&MESH_TYPES[..], &[FORM_TYPE]].concat())
        .header(header::ACCEPT, accepted))
}

/// Refuses a body that came compressed: it would be taken for the mesh itself.
fn refuse_coding(headers: &HeaderMap) -> Result<(), Problem> {
    let codings = headers.get_all(header::CONTENT_ENCODING).iter();
    let mut words = codings.flat_map(|value| value.to_str().unwrap_or("?").split(','));
    if words.all(|word| word.trim().eq_ignore_ascii_case("identity")) {
        return Ok(());
    }
    let detail = "a compressed body is not read; send the mesh as it is, without Content-Encoding";
    Err(Problem::new(&UNSUPPORTED_CODING, detail).header(header::ACCEPT_ENCODING, "identity"))
}

/// Refuses every transfer coding but one `chunked`: where a proxy reads others, it may see the body end elsewhere (RFC 9112,
/// section 6.1).
fn refuse_transfer(headers: &HeaderMap) -> Result<(), Problem> {
    let mut codings = headers.get_all(header::TRANSFER_ENCODING).iter();
    let is_read = match (codings.next(), codings.next()) {
        (None, _) => true,
        (Some(coding), None) => coding.as_bytes().trim_ascii().eq_ignore_ascii_case(b"chunked"),
        (Some(_), Some(_)) => false,
    };
    if is_read {
        return Ok(());
    }
    let detail =
        "of transfer codings one chunked is read; send the mesh as it is, with Content-Length or chunked";
    Err(Problem::new(&UNSUPPORTED_TRANSFER, detail))
}

/// Refuses what declares itself too large, before any of it is read.
fn check_length(app: &App, headers: &HeaderMap, extra: u64) -> Result<(), Problem> {
    let declared =
        headers.get(header::CONTENT_LENGTH).and_then(|value| value.to_str().ok()?.parse::<u64>().ok());
    if declared.is_some_and(|length| length > app.limits().upload_bytes.saturating_add(extra)) {
        return Err(too_large(app));
    }
    Ok(())
}

pub(super) fn too_large(app: &App) -> Problem {
    let limit = app.limits().upload_bytes;
    let detail = format!("a mesh may have {limit} bytes; send a coarser one, or in a binary format");
    Problem::new(&UPLOAD_TOO_LARGE, detail).with("limit", limit)
}
