//! Lets a refused upload run out, so that the client reads the answer instead of a reset connection.
//!
//! A connection that is closed with unread bytes in it is reset, and a reset throws away the answer that is
//! still on its way. Web servers call the cure a lingering close.

use std::io;
use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::Duration;

use axum::body::{Body, BodyDataStream, HttpBody};
use axum::extract::Request;
use axum::http::header;
use axum::middleware::Next;
use axum::response::Response;
use bytes::Bytes;
use futures::{Stream, StreamExt};

/// How much of what nobody wants is read and thrown away, and for how long.
const DISCARD_BYTES: usize = 64 << 20;
const DISCARD_TIME: Duration = Duration::from_secs(5);

/// Gives every body that is not read to its end a decent one, whoever drops it.
pub async fn linger(request: Request, next: Next) -> Response {
    if request.body().is_end_stream() {
        return next.run(request).await;
    }
    // Such a client sends nothing before it is asked to, and reading would ask it to.
    let waits = request.headers().contains_key(header::EXPECT);
    let request = request
        .map(|body| Body::from_stream(Lingering { rest: Some(body.into_data_stream()), is_sent: !waits }));
    next.run(request).await
}

/// A body that is read on in the background when it is dropped early.
struct Lingering {
    /// `None` once it has ended or failed.
    rest: Option<BodyDataStream>,
    /// The client sends it, wanted or not.
    is_sent: bool,
}

impl Stream for Lingering {
    type Item = io::Result<Bytes>;

    fn poll_next(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Self::Item>> {
        self.is_sent = true;
        let Some(rest) = &mut self.rest else { return Poll::Ready(None) };
        let item = std::task::ready!(rest.poll_next_unpin(context));
        if !matches!(item, Some(Ok(_))) {
            self.rest = None;
        }
        Poll::Ready(item.map(|item| item.map_err(io::Error::other)))
    }
}

impl Drop for Lingering {
    fn drop(&mut self) {
        let Some(rest) = self.rest.take() else { return };
        if let (true, Ok(runtime)) = (self.is_sent, tokio::runtime::Handle::try_current()) {
            runtime.spawn(tokio::time::timeout(DISCARD_TIME, discard(rest)));
        }
    }
}

async fn discard(mut rest: BodyDataStream) {
    let mut left = DISCARD_BYTES;
    while let Some(Ok(chunk)) = rest.next().await {
        left = left.saturating_sub(chunk.len());
        if left == 0 {
            return;
        }
    }
}
