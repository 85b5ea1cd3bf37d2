//! The connections: accepted, given to the router, and cut when their client stands still.

use std::pin::pin;
use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use axum::serve::Listener;
use hyper_util::rt::{TokioExecutor, TokioIo, TokioTimer};
use hyper_util::server::conn::auto::Builder;
use hyper_util::service::TowerToHyperService;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::{TcpListener, TcpStream};
use tokio::task::JoinSet;
use tokio_rustls::server::TlsStream;
use tokio_util::sync::CancellationToken;
use tower_http::add_extension::AddExtension;

use super::Tls;
use super::audit::Peer;

/// Serves every connection until `closing`, then those that are open until they have answered.
///
/// `axum::serve` does the same without a limit to the time that a request's head may take (`head`); that time
/// also ends connections that are kept open for a next request that does not come, and TLS handshakes that are not
/// whole. Dropping the future cuts what is open.
pub(super) async fn serve(
    mut listener: TcpListener,
    tls: Option<Arc<Tls>>,
    router: Router,
    head: Duration,
    closing: CancellationToken,
) {
    let mut http = Builder::new(TokioExecutor::new()).http1_only();
    http.http1().timer(TokioTimer::new()).header_read_timeout(head);
    let mut open = JoinSet::new();
    loop {
        tokio::select! {
            (socket, address) = Listener::accept(&mut listener) => {
                let (http, router, closing) = (http.clone(), router.clone(), closing.clone());
                let (tls, peer) = (tls.clone(), Peer(address.ip()));
                open.spawn(async move {
                    // Small answers should not wait for more; a socket that cannot be set works all the same.
                    let _ = socket.set_nodelay(true);
                    match tls {
                        None => converse(http, socket, peer, router, closing).await,
                        Some(tls) => {
                            if let Some(stream) = greet(&tls, socket, head).await {
                                converse(http, stream, peer, router, closing).await;
                            }
                        }
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

/// The TLS handshake; `None` when it fails or takes too long.
async fn greet(tls: &Tls, socket: TcpStream, limit: Duration) -> Option<TlsStream<TcpStream>> {
    match tokio::time::timeout(limit, tls.acceptor().accept(socket)).await {
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

/// Answers one client's requests.
async fn converse(
    http: Builder<TokioExecutor>,
    stream: impl AsyncRead + AsyncWrite + Unpin + Send + 'static,
    peer: Peer,
    router: Router,
    closing: CancellationToken,
) {
    let connection = http
        .serve_connection(TokioIo::new(stream), TowerToHyperService::new(AddExtension::new(router, peer)));
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
