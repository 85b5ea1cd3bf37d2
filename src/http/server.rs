//! Serves until told to stop, then stops in order.

use std::future::Future;
use std::io;
use std::time::{Duration, Instant};

use tokio::net::TcpListener;

use super::connections::House;
use super::{App, audit, connections, router};

/// How long open connections may take to end after the signal to stop, within the grace time.
const CONNECTIONS_END: Duration = Duration::from_secs(10);

/// Serves on `listener`, encrypted where the app has a certificate, until `stop` is ready. Then no connection is accepted any more, requests under way are
/// answered, running jobs finish within `grace`, and the others are put back.
pub async fn serve(
    listener: TcpListener,
    app: App,
    stop: impl Future<Output = ()>,
    grace: Duration,
) -> io::Result<()> {
    let closing = app.closing().clone();
    let router = router::router(app.clone());
    let tls = app.tls().cloned();
    if let Some(tls) = &tls {
        tokio::spawn(tls.clone().follow(closing.clone()));
    }
    if let Some(gate) = app.gate() {
        gate.follow(closing.clone());
    }
    let house = House { router, tls, head: app.limits().head, crowd: app.connections().clone() };
    let connections = connections::serve(listener, house, closing.clone());
    let requests = app.requests().clone();
    // Those whose clients have gone have no connection any more.
    let mut server = tokio::spawn(async move {
        connections.await;
        requests.close();
        requests.wait().await;
    });
    let trail = app.trail().cloned();
    if let Some(trail) = &trail {
        tokio::spawn(audit::follow(trail.clone(), closing.clone()));
    }
    tokio::select! {
        () = stop => {}
        ended = &mut server => {
            audit::finish(trail.as_ref()).await;
            return ended.map_err(io::Error::other);
        }
    }
    let begin = Instant::now();
    app.jobs().drain();
    closing.cancel();
    if tokio::time::timeout(grace.min(CONNECTIONS_END), &mut server).await.is_err() {
        tracing::warn!("connections and requests that did not end are cut");
        server.abort();
    }
    audit::finish(trail.as_ref()).await;
    app.jobs().shutdown(grace.saturating_sub(begin.elapsed())).await;
    Ok(())
}
