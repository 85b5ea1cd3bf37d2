//! The connections: accepted, given to the router, and cut when their client stands still.

use std::pin::pin;
use std::time::Duration;

use axum::Router;
use axum::serve::Listener;
use hyper_util::rt::{TokioExecutor, TokioIo, TokioTimer};
use hyper_util::server::conn::auto::Builder;
use hyper_util::service::TowerToHyperService;
use tokio::net::{TcpListener, TcpStream};
use tokio::task::JoinSet;
use tokio_util::sync::CancellationToken;
use tower_http::add_extension::AddExtension;

use super::audit::Peer;

/// Serves every connection until `closing`, then those that are open until they have answered.
///
/// `axum::serve` does the same without a limit to the time that a request's head may take (`head`); that time
/// also ends connections that are kept open for a next request that does not come. Dropping the future cuts
/// what is open.
pub(super) async fn serve(
    mut listener: TcpListener,
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
                open.spawn(converse(http.clone(), socket, Peer(address.ip()), router.clone(), closing.clone()));
            }
            Some(_) = open.join_next() => {}
            () = closing.cancelled() => break,
        }
    }
    // New clients should be refused, not left waiting.
    drop(listener);
    while open.join_next().await.is_some() {}
}

/// Answers one client's requests.
async fn converse(
    http: Builder<TokioExecutor>,
    socket: TcpStream,
    peer: Peer,
    router: Router,
    closing: CancellationToken,
) {
    // Small answers should not wait for more; a socket that cannot be set works all the same.
    let _ = socket.set_nodelay(true);
    let connection = http
        .serve_connection(TokioIo::new(socket), TowerToHyperService::new(AddExtension::new(router, peer)));
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
