//! What goes on beside a run: its progress is written, and it is stopped where it should not go on.

use std::time::Duration;

use tokio::sync::{oneshot, watch};

use super::live::{Entry, Snapshot};
use super::worker::{Outcome, Phase, Shared};
use super::{Job, Lease};

/// How long a cancelled run may take to stop before its job is settled without it.
const STOP_WITHIN: Duration = Duration::from_secs(2);

/// Stops a run that took too long, and waits a while for it to obey.
pub(super) async fn out_of_time(entry: &Entry, mut answered: oneshot::Receiver<Outcome>) -> Outcome {
    entry.cancel.cancel();
    match tokio::time::timeout(STOP_WITHIN, &mut answered).await {
        Ok(_) => Outcome::OutOfTime(None),
        Err(_) => Outcome::OutOfTime(Some(answered)),
    }
}

/// Ready when a run goes on although it was dismissed, or although the service stops.
pub(super) async fn overdue(mut phase: watch::Receiver<Phase>, entry: &Entry) {
    let mut changes = entry.subscribe();
    // Neither sender goes before the worker, so neither wait fails.
    tokio::select! {
        _ = phase.wait_for(|phase| *phase == Phase::Stopping) => {}
        _ = changes.wait_for(|now| now.ended) => {}
    }
    entry.cancel.cancel();
    tokio::time::sleep(STOP_WITHIN).await;
}

/// Writes progress to the store as it comes, not more often than set. Ready when the run goes on although
/// its lease is lost.
pub(super) async fn flush(shared: &Shared, job: &Job, lease: &Lease, entry: &Entry) {
    let mut changes = entry.subscribe();
    let mut written = Snapshot::default();
    loop {
        tokio::time::sleep(shared.settings.flush).await;
        // The sender lives in `entry`, so the wait does not fail.
        let Ok(now) = changes.wait_for(|now| *now != written).await.map(|now| *now) else { return };
        written = now;
        let Some((stage, percent)) = written.progress() else { continue };
        let time = shared.clock.now_ms();
        match shared.store.progress(job.id, lease, percent, Some(stage.name()), time).await {
            Ok(true) => entry.touched(time),
            Ok(false) => {
                entry.cancel.cancel();
                return tokio::time::sleep(STOP_WITHIN).await;
            }
            Err(error) => tracing::warn!(%error, "cannot write progress"),
        }
    }
}
