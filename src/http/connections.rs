//! The connections: accepted, given to the router, and cut when their client stands still.

use std::io;
use std::pin::{Pin, pin};
use std::sync::Arc;
use std::time::Duration;

use axum::serve::Listener;
use axum::{Extension, Router};
use hyper_util::rt::{TokioExecutor, TokioIo, TokioTimer};
use hyper_util::server::conn::auto::Builder;
use hyper_util::service::TowerToHyperService;
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::task::JoinSet;
use tokio_io_timeout::TimeoutStream;
use tokio_rustls::server::TlsStream;
use tokio_util::sync::CancellationToken;
use tower_http::add_extension::AddExtension;

use super::Tls;
use super::audit::Peer;
use super::crowd::{ASKING, Crowd, HEARING, Standing};

/// Bytes of a request that should have been encrypted which are read and thrown away.
const MOST_PLAIN: usize = 1 << 20;

/// What connections are served with.
pub(super) struct House {
    pub router: Router,
    pub tls: Option<Arc<Tls>>,
    /// How long a request's head may take. It also ends connections that are kept open for a next request that does not
    /// come, TLS handshakes that are not whole, and answers of which nothing is read.
    pub head: Duration,
    pub crowd: Crowd,
}

/// Serves every connection until `closing`, then those that are open until they have answered.
///
/// `axum::serve` does the same without a limit to the time of a request's head and to the number of connections. Dropping
/// the future cuts what is open.
pub(super) async fn serve(mut listener: TcpListener, house: House, closing: CancellationToken) {
    let House { router, tls, head, crowd } = house;
    let manners = Arc::new(Manners::new(router, head));
    let mut open = JoinSet::new();
    loop {
        tokio::select! {
            (socket, address) = Listener::accept(&mut listener), if crowd.has_room() => {
                // There is room: only this loop takes places.
                let Some(place) = crowd.take() else { continue };
                let manners = manners.clone();
                let (tls, closing, peer) = (tls.clone(), closing.clone(), Peer(address.ip()));
                open.spawn(async move {
                    let place = place.seated_soon().await;
                    let manner = if place.is_seat() { &manners.seated } else { &manners.standing };
                    let conversation = begin(manner, tls, socket, peer, closing);
                    if place.is_seat() {
                        conversation.await;
                    } else if tokio::time::timeout(HEARING, conversation).await.is_err() {
                        tracing::debug!("a connection past the limit stayed too long");
                    }
                });
            }
            Some(_) = open.join_next() => {}
            () = closing.cancelled() => break,
        }
    }
    // New clients should be refused, not left waiting.
    drop(listener);
    while open.join_next().await.is_some() {}
}

/// How the requests of a connection are answered.
struct Manner {
    http: Builder<TokioExecutor>,
    router: Router,
    head: Duration,
}

/// Within the limit of connections, and past it.
struct Manners {
    seated: Manner,
    standing: Manner,
}

impl Manners {
    fn new(router: Router, head: Duration) -> Self {
        let mut http = Builder::new(TokioExecutor::new()).http1_only();
        http.http1().timer(TokioTimer::new()).header_read_timeout(head);
        let mut once = http.clone();
        once.http1().keep_alive(false).header_read_timeout(ASKING);
        let turning_away = router.clone().layer(Extension(Standing));
        Self {
            seated: Manner { http, router, head },
            standing: Manner { http: once, router: turning_away, head: ASKING },
        }
    }
}

/// Greets a client where TLS is spoken, and answers its requests.
async fn begin(
    manner: &Manner,
    tls: Option<Arc<Tls>>,
    socket: TcpStream,
    peer: Peer,
    closing: CancellationToken,
) {
    // Small answers should not wait for more; a socket that cannot be set works all the same.
    let _ = socket.set_nodelay(true);
    match tls {
        None => converse(manner, socket, peer, closing).await,
        Some(tls) => {
            let greeted = tokio::select! {
                greeted = greet(&tls, socket, manner.head) => greeted,
                // Nothing was asked yet.
                () = closing.cancelled() => None,
            };
            if let Some(stream) = greeted {
                converse(manner, stream, peer, closing).await;
            }
        }
    }
}

/// What a client is told that speaks HTTP where TLS is spoken.
const PLAIN: &[u8] =
    b"HTTP/1.1 400 Bad Request\r\nContent-Type: text/plain; charset=utf-8\r\nContent-Length: 46\r\n\
                       Connection: close\r\n\r\nthis port speaks TLS: use https:// in the URL\n";

/// The TLS handshake; `None` when it fails or takes too long.
async fn greet(tls: &Tls, mut socket: TcpStream, limit: Duration) -> Option<TlsStream<TcpStream>> {
    let greeted = async {
        if is_plain(&socket).await? {
            refuse(&mut socket).await?;
            return Err(io::Error::other("the client speaks HTTP without TLS"));
        }
        tls.acceptor().accept(socket).await
    };
    match tokio::time::timeout(limit, greeted).await {
        Ok(Ok(stream)) => Some(stream),
        Ok(Err(error)) => {
            tracing::debug!(%error, "a TLS handshake failed");
            None
        }
        Err(_) => {
            tracing::debug!("a TLS handshake stood still");
            None
        }
    }
}

/// Whether the client begins with a letter, as a request's method does and no TLS record (RFC 8446, section 5.1).
async fn is_plain(socket: &TcpStream) -> io::Result<bool> {
    let mut first = [0];
    Ok(socket.peek(&mut first).await? == 1 && first[0].is_ascii_alphabetic())
}

/// Says what is wrong, in the clear. What the client sends meanwhile is read: a connection that is closed with unread bytes
/// is reset, and the answer with it.
async fn refuse(socket: &mut TcpStream) -> io::Result<()> {
    socket.write_all(PLAIN).await?;
    socket.shutdown().await?;
    let mut rest = [0; 4096];
    let mut read = 0;
    while read < MOST_PLAIN {
        match socket.read(&mut rest).await? {
            0 => break,
            bytes => read += bytes,
        }
    }
    Ok(())
}

/// A stream that fails once nothing that is written to it has been taken for so long: the client does not read its answer.
fn unless_stuck<Stream: AsyncRead + AsyncWrite>(
    stream: Stream,
    limit: Duration,
) -> Pin<Box<TimeoutStream<Stream>>> {
    let mut stream = TimeoutStream::new(stream);
    stream.set_write_timeout(Some(limit));
    Box::pin(stream)
}

/// Answers one client's requests.
async fn converse(
    Manner { http, router, head }: &Manner,
    stream: impl AsyncRead + AsyncWrite + Send + 'static,
    peer: Peer,
    closing: CancellationToken,
) {
    let stream = TokioIo::new(unless_stuck(stream, *head));
    let service = TowerToHyperService::new(AddExtension::new(router.clone(), peer));
    let connection = http.serve_connection(stream, service);
    let mut connection = pin!(connection);
    let ended = tokio::select! {
        ended = connection.as_mut() => ended,
        () = closing.cancelled() => {
            connection.as_mut().graceful_shutdown();
            connection.await
        }
    };
    if let Err(error) = ended {
        tracing::debug!(error, "a connection ended early");
    }
}
