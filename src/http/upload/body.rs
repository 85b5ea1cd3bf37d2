//! Bodies as streams with an idle limit.

use std::io;
use std::time::Duration;

use axum::body::Body;
use bytes::{Bytes, BytesMut};
use futures::{Stream, StreamExt, TryStreamExt, stream};
use tokio::time::Instant;

use super::super::App;
use super::super::limits::UPLOAD_STEP;
use super::super::problem::{Problem, UPLOAD_INCOMPLETE, UPLOAD_TIMEOUT};
use super::super::validation;
use super::too_large;
use crate::jobs::blob::BlobError;
use crate::jobs::{JobError, Upload};
use crate::mesh::format::{TELLING, plainly_foreign};

/// Streams a raw body to disk.
pub(super) async fn store(app: &App, body: Body) -> Result<Upload, Problem> {
    keep(app, body.into_data_stream().map(|item| item.map_err(io::Error::other))).await
}

/// Streams a mesh's bytes to disk, once they begin like one.
pub(super) async fn keep<S>(app: &App, bytes: S) -> Result<Upload, Problem>
where
    S: Stream<Item = io::Result<Bytes>> + Send + Unpin,
{
    let limits = app.limits();
    // Fused: a short body ends while its beginning is read.
    let counters = app.counters().clone();
    let counted = bytes.inspect_ok(move |chunk| counters.received(chunk.len()));
    let mut bytes = Box::pin(unless_idle(counted, limits.upload_idle).fuse());
    let begin = beginning(&mut bytes).await.map_err(|error| refusal(app, BlobError::Upload(error).into()))?;
    if let Some(error) = plainly_foreign(&begin) {
        return Err(validation::refusal(&error));
    }
    let whole = stream::iter([Ok(begin)]).chain(bytes);
    app.jobs().upload(whole, limits.upload_bytes).await.map_err(|error| refusal(app, error))
}

/// The first chunks, as many as tell what the file is.
async fn beginning<S>(bytes: &mut S) -> io::Result<Bytes>
where
    S: Stream<Item = io::Result<Bytes>> + Unpin,
{
    let mut begin = BytesMut::new();
    while begin.len() < TELLING {
        let Some(chunk) = bytes.next().await else { break };
        begin.extend_from_slice(&chunk?);
    }
    Ok(begin.freeze())
}

/// An upload's failure as the client sees it.
pub(super) fn refusal(app: &App, error: JobError) -> Problem {
    match error {
        JobError::Blob(BlobError::TooLarge { .. }) => too_large(app),
        JobError::Blob(BlobError::Upload(cause)) if cause.kind() == io::ErrorKind::TimedOut => {
            let seconds = app.limits().upload_idle.as_secs();
            let detail = format!("less than {UPLOAD_STEP} bytes came in {seconds} s; send the mesh again");
            Problem::new(&UPLOAD_TIMEOUT, detail)
        }
        JobError::Blob(BlobError::Upload(_)) => {
            Problem::new(&UPLOAD_INCOMPLETE, "the body ended before it was whole; send the mesh again")
        }
        error => error.into(),
    }
}

/// The stream, ended by `TimedOut` when less than [`UPLOAD_STEP`] comes within `idle`.
pub(super) fn unless_idle<'a, S>(
    stream: S,
    idle: Duration,
) -> impl Stream<Item = io::Result<Bytes>> + Send + 'a
where
    S: Stream<Item = io::Result<Bytes>> + Send + Unpin + 'a,
{
    let begin = (stream, Instant::now() + idle, 0);
    stream::unfold(Some(begin), move |state| async move {
        let (mut stream, mut end, mut came) = state?;
        match tokio::time::timeout_at(end, stream.next()).await {
            Ok(Some(item)) => {
                came += item.as_ref().map_or(0, Bytes::len);
                if came >= UPLOAD_STEP {
                    (end, came) = (Instant::now() + idle, 0);
                }
                Some((item, Some((stream, end, came))))
            }
            Ok(None) => None,
            Err(_) => Some((Err(io::ErrorKind::TimedOut.into()), None)),
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn a_stream_that_stands_still_times_out() {
        let source = stream::iter([Ok(Bytes::from_static(b"a"))]).chain(stream::pending()).boxed();
        let items: Vec<_> = unless_idle(source, Duration::from_millis(20)).collect().await;
        assert_eq!(items.len(), 2);
        assert_eq!(items[0].as_ref().unwrap(), "a");
        assert_eq!(items[1].as_ref().unwrap_err().kind(), io::ErrorKind::TimedOut);
    }

    #[tokio::test]
    async fn drops_do_not_keep_a_stream_alive_and_steady_bytes_do() {
        let every_30_ms = |bytes: usize| {
            let chunk = Bytes::from(vec![0; bytes]);
            let chunks = stream::iter(0..30).then(move |_| {
                let chunk = chunk.clone();
                async move {
                    tokio::time::sleep(Duration::from_millis(30)).await;
                    Ok(chunk)
                }
            });
            unless_idle(chunks.boxed(), Duration::from_millis(300)).collect::<Vec<_>>()
        };
        let drops = every_30_ms(1).await;
        assert!(drops.len() < 15 && drops.last().unwrap().is_err(), "{}", drops.len());
        let steady = every_30_ms(UPLOAD_STEP / 2).await;
        assert!(steady.len() == 30 && steady.iter().all(Result::is_ok));
    }
}
