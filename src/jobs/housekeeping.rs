//! What is done again and again beside the jobs: room is kept for a full disk, begun purges are ended,
//! what is kept for too long is removed.

use std::panic::AssertUnwindSafe;
use std::sync::Arc;
use std::time::Instant;

use futures::FutureExt;

use super::Steadiness;
use super::recovery::finish_purges;
use super::retention::sweep;
use super::worker::{Phase, Shared};

/// Keeps house until the service drains.
pub(super) async fn keep(shared: Arc<Shared>) {
    let mut phase = shared.phase.subscribe();
    let mut clock = Steadiness::new(shared.clock.now_ms(), Instant::now());
    let pace = shared.settings.retention.pace(shared.settings.housekeeping);
    loop {
        tokio::select! {
            () = tokio::time::sleep(pace) => {}
            // The sender lives in `shared`, so the wait does not fail.
            _ = phase.wait_for(|phase| *phase != Phase::Open) => return,
        }
        let steady = clock.holds(shared.clock.now_ms(), Instant::now());
        if AssertUnwindSafe(round(&shared, steady)).catch_unwind().await.is_err() {
            tracing::error!("the housekeeping panicked; it goes on with its next round");
        }
    }
}

/// One round; `steady` says whether the clock can be trusted.
async fn round(shared: &Arc<Shared>, steady: bool) {
    keep_reserve(shared).await;
    if let Err(error) = finish_purges(shared.store.as_ref(), shared.blobs.as_ref()).await {
        tracing::warn!(%error, "purges that were begun cannot be looked up");
    }
    if steady && let Err(error) = sweep(shared).await {
        tracing::warn!(%error, "what is kept for too long cannot be looked up");
    }
}

/// Keeps room for changes that free space on a full disk.
pub(super) async fn keep_reserve(shared: &Arc<Shared>) {
    let owned = shared.clone();
    let kept = tokio::task::spawn_blocking(move || owned.folder.as_ref().map(|folder| folder.keep_reserve()));
    if let Err(error) = kept.await {
        tracing::warn!(%error, "no room is kept for a full disk");
    }
}
