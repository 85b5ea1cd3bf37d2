//! What is done again and again beside the jobs: room is kept for a full disk, begun purges are ended,
//! what is kept for too long is removed.

use std::panic::AssertUnwindSafe;
use std::sync::{Arc, PoisonError};
use std::time::Instant;

use futures::FutureExt;

use super::Steadiness;
use super::recovery::finish_purges;
use super::retention::sweep;
use super::worker::{Phase, Shared};

/// Keeps house until the service drains.
pub(super) async fn keep(shared: Arc<Shared>, mut clock: Steadiness) {
    let mut phase = shared.phase.subscribe();
    let pace = shared.settings.retention.pace(shared.settings.housekeeping);
    loop {
        tokio::select! {
            () = tokio::time::sleep(pace) => {}
            // The sender lives in `shared`, so the wait does not fail.
            _ = phase.wait_for(|phase| *phase != Phase::Open) => return,
        }
        let now = trusted_now(&shared, &mut clock);
        if AssertUnwindSafe(round(&shared, now)).catch_unwind().await.is_err() {
            tracing::error!("the housekeeping panicked; it goes on with its next round");
        }
    }
}

/// What the clock says, where it can be trusted; what is found is noted, and logged once.
pub(super) fn trusted_now(shared: &Shared, clock: &mut Steadiness) -> Option<i64> {
    let now = shared.clock.now_ms();
    let found = clock.holds(now, Instant::now()).err();
    let mut noted = shared.doubt.lock().unwrap_or_else(PoisonError::into_inner);
    match (&found, &*noted) {
        (Some(doubt), None) => tracing::warn!("{doubt}"),
        (None, Some(_)) => tracing::info!("the clock is trusted again"),
        _ => {}
    }
    *noted = found;
    found.is_none().then_some(now)
}

/// One round; `now` is the time where the clock can be trusted. Asked again it may be another one.
async fn round(shared: &Arc<Shared>, now: Option<i64>) {
    // Nothing is removed meanwhile either. It is logged where it is found.
    if shared.in_place().await.is_err() {
        return;
    }
    keep_reserve(shared).await;
    if let Err(error) = finish_purges(shared.store.as_ref(), shared.blobs.as_ref()).await {
        tracing::warn!(%error, "purges that were begun cannot be looked up");
    }
    if let Some(now) = now
        && let Err(error) = sweep(shared, now).await
    {
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
