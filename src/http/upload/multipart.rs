//! A form with a part `mesh` and, before or after it, a part `parameters` (RFC 7578).

use std::io;
use std::path::Path;

use axum::RequestExt;
use axum::extract::Request;
use axum::extract::multipart::{Field, Multipart};
use bytes::Bytes;
use futures::{Stream, StreamExt, TryStreamExt};

use super::super::App;
use super::super::parameters::{Asked, json_pairs, source_name};
use super::super::problem::{MALFORMED_REQUEST, Problem, UPLOAD_TOO_LARGE};
use super::overhead::Overhead;
use super::{Received, body};
use crate::jobs::{FileName, FormatHint, Upload};

/// The part `mesh`, on disk.
struct Mesh {
    upload: Upload,
    hint: FormatHint,
    name: Option<FileName>,
}

/// Takes a form apart; `query` holds parameters too, which the form's override.
pub(super) async fn receive(
    app: &App,
    request: Request,
    query: Vec<(String, String)>,
) -> Result<Received, Problem> {
    let overhead = Overhead::default();
    let parts = overhead.bound(request).extract::<Multipart, _>().await;
    let parts = parts.map_err(|_| {
        let detail = "Content-Type names no boundary of the form's parts; send multipart/form-data; \
                      boundary=..., as HTTP libraries do by themselves";
        Problem::new(&MALFORMED_REQUEST, detail)
    })?;
    take_apart(app, &mut Form { parts, overhead }, query).await
}

struct Form {
    parts: Multipart,
    overhead: Overhead,
}

async fn take_apart(
    app: &App,
    form: &mut Form,
    mut pairs: Vec<(String, String)>,
) -> Result<Received, Problem> {
    let (mut mesh, mut has_parameters) = (None, false);
    let overhead = form.overhead.clone();
    while let Some(field) = next_field(app, form).await? {
        match field.name() {
            Some("mesh") if mesh.is_none() => mesh = Some(store(app, field, overhead.clone()).await?),
            Some("parameters") if !has_parameters => {
                has_parameters = true;
                let given = json_pairs(&read(app, field, overhead.clone()).await?)?;
                pairs.retain(|(name, _)| given.iter().all(|(other, _)| other != name));
                pairs.extend(given);
                // Refuses wrong parameters before the mesh comes in.
                Asked::from_pairs(&pairs, app.limits())?;
            }
            Some("mesh" | "parameters") => {
                return Err(Problem::new(&MALFORMED_REQUEST, "the form has a part twice; send each once"));
            }
            _ => {
                let detail = "the form has a part that is neither 'mesh' nor 'parameters'; name the mesh's part 'mesh', put parameters into the JSON of 'parameters' or into the query, and leave others out";
                return Err(Problem::new(&MALFORMED_REQUEST, detail));
            }
        }
    }
    let Some(mesh) = mesh else {
        return Err(Problem::new(
            &MALFORMED_REQUEST,
            "the form has no part 'mesh'; send the mesh's file in it",
        ));
    };
    let mut asked = Asked::from_pairs(&pairs, app.limits())?;
    asked.name = asked.name.or(mesh.name);
    Ok(Received { upload: mesh.upload, asked, hint: mesh.hint, owner: None })
}

async fn next_field<'a>(app: &App, form: &'a mut Form) -> Result<Option<Field<'a>>, Problem> {
    let idle = app.limits().upload_idle;
    match tokio::time::timeout(idle, form.parts.next_field()).await {
        // The error's own words are about the reader.
        Ok(field) => field.map_err(|_| form.overhead.problem()),
        Err(_) => Err(body::refusal(
            app,
            crate::jobs::blob::BlobError::Upload(io::ErrorKind::TimedOut.into()).into(),
        )),
    }
}

/// A part's data.
fn data<'a>(
    field: Field<'a>,
    overhead: Overhead,
) -> impl Stream<Item = io::Result<Bytes>> + Send + Unpin + 'a {
    let given = move |chunk: &Bytes| overhead.given(chunk.len());
    field.map_err(io::Error::other).inspect_ok(given).boxed()
}

/// Streams the mesh to disk. The part's content type is a hint only: browsers guess it from the file name.
async fn store(app: &App, field: Field<'_>, overhead: Overhead) -> Result<Mesh, Problem> {
    let file_name = field.file_name().unwrap_or_default();
    let extension =
        Path::new(file_name).extension().and_then(|extension| extension.to_str()).map(str::to_owned);
    let name = source_name(file_name, app.limits()).ok().flatten();
    let hint = FormatHint { extension, content_type: field.content_type().map(str::to_owned) };
    let upload = body::keep(app, data(field, overhead)).await?;
    Ok(Mesh { upload, hint, name })
}

/// The parameters' bytes.
async fn read(app: &App, field: Field<'_>, overhead: Overhead) -> Result<Vec<u8>, Problem> {
    let limit = app.limits().parameters_bytes;
    let mut chunks = Box::pin(body::unless_idle(data(field, overhead), app.limits().upload_idle));
    let mut whole = Vec::new();
    while let Some(chunk) = chunks.next().await {
        let chunk: Bytes =
            chunk.map_err(|error| body::refusal(app, crate::jobs::blob::BlobError::Upload(error).into()))?;
        if whole.len() + chunk.len() > limit {
            let detail = format!("the part 'parameters' may have {limit} bytes");
            return Err(Problem::new(&UPLOAD_TOO_LARGE, detail).with("limit", limit));
        }
        whole.extend_from_slice(&chunk);
    }
    Ok(whole)
}
