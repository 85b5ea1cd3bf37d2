//! What a form has beside the data of its parts: their heads, boundaries, and whatever stands before the first.
//!
//! The reader of forms keeps all of that in memory until a boundary or a head is whole, however long that takes.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use axum::body::{Body, BodyDataStream};
use axum::extract::Request;
use bytes::Bytes;
use futures::{Stream, StreamExt, stream};

use super::super::problem::{MALFORMED_REQUEST, Problem, UPLOAD_INCOMPLETE};
use super::FORM_OVERHEAD;

/// The body comes in pieces of so many bytes at most, each with a pause before it, in which the reader gives the data on
/// that it has. So it holds no more than a few of them beside what it keeps.
const PIECE: usize = 64 << 10;

const MOST: u64 = FORM_OVERHEAD + 4 * PIECE as u64;

/// How a form's body comes in.
#[derive(Clone, Default)]
pub(super) struct Overhead(Arc<State>);

#[derive(Default)]
struct State {
    /// Bytes that came in and are no data of a part, or were not given on yet.
    bytes: AtomicU64,
    broke_off: AtomicBool,
}

impl Overhead {
    /// The request with a body that fails when it has more of this than a form needs.
    pub(super) fn bound(&self, request: Request) -> Request {
        let this = self.clone();
        request.map(|body| Body::from_stream(this.pieces(body.into_data_stream())))
    }

    /// So many bytes of a part's data were given on.
    pub(super) fn given(&self, data: usize) {
        self.0.bytes.fetch_sub(data as u64, Ordering::Relaxed);
    }

    /// Why the form could not be read on.
    pub(super) fn problem(&self) -> Problem {
        if self.is_too_much() {
            let detail = format!(
                "the form has more than {FORM_OVERHEAD} bytes beside the data of its parts; send 'mesh' and \
                 'parameters' with short heads, and nothing before them"
            );
            return Problem::new(&MALFORMED_REQUEST, detail);
        }
        if self.0.broke_off.load(Ordering::Relaxed) {
            return Problem::new(&UPLOAD_INCOMPLETE, "the form broke off before it was whole; send it again");
        }
        let detail = "the form has no last boundary, another one than Content-Type names, or a part whose head cannot \
                      be read; send it whole, as HTTP libraries make it";
        Problem::new(&MALFORMED_REQUEST, detail)
    }

    fn is_too_much(&self) -> bool {
        self.0.bytes.load(Ordering::Relaxed) > MOST
    }

    fn pieces(self, body: BodyDataStream) -> impl Stream<Item = io::Result<Bytes>> + Send {
        stream::unfold((body, Bytes::new()), move |(mut body, mut rest)| {
            let this = self.clone();
            async move {
                tokio::task::yield_now().await;
                while rest.is_empty() {
                    rest = match body.next().await {
                        Some(Ok(chunk)) => chunk,
                        Some(Err(error)) => {
                            this.0.broke_off.store(true, Ordering::Relaxed);
                            return Some((Err(io::Error::other(error)), (body, rest)));
                        }
                        None => return None,
                    };
                }
                let piece = rest.split_to(rest.len().min(PIECE));
                this.0.bytes.fetch_add(piece.len() as u64, Ordering::Relaxed);
                let item =
                    if this.is_too_much() { Err(io::ErrorKind::FileTooLarge.into()) } else { Ok(piece) };
                Some((item, (body, rest)))
            }
        })
    }
}
