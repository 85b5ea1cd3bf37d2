//! How long files and jobs are kept once a job has ended.

use std::time::Duration;

use super::recovery::purge;
use super::store::StoreError;
use super::worker::Shared;
use super::{JobError, JobId};

/// Jobs that one step looks at.
const STEP: u32 = 200;
/// How long the id of an expired job answers that it is gone.
const REMEMBERED: Duration = Duration::from_secs(365 * 24 * 60 * 60);

/// How long things are kept; `None` is until they are purged.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Retention {
    /// An ended job's mesh; zero removes it at once, which is within a round of the housekeeping.
    pub input: Option<Duration>,
    /// An ended job with all that is left of it.
    pub job: Option<Duration>,
}

impl Retention {
    /// How often to look, so that nothing stays much longer than it should.
    pub(super) fn pace(self, usual: Duration) -> Duration {
        let shortest = self.input.into_iter().chain(self.job).min().unwrap_or(usual);
        usual.min(shortest.max(Duration::from_secs(1)))
    }
}

/// Removes whatever is kept for too long at `now`. What cannot be removed now is tried again with the next round.
pub(super) async fn sweep(shared: &Shared, now: i64) -> Result<(), StoreError> {
    let before = |kept: Duration| now.saturating_sub(i64::try_from(kept.as_millis()).unwrap_or(i64::MAX));
    shared.store.ended_by(now).await?;
    if let Some(kept) = shared.settings.retention.job {
        sweep_jobs(shared, before(kept), now).await?;
    }
    if let Some(kept) = shared.settings.retention.input {
        sweep_inputs(shared, before(kept), now).await?;
    }
    shared.store.forget_expired(before(REMEMBERED)).await
}

async fn sweep_jobs(shared: &Shared, before: i64, now: i64) -> Result<(), StoreError> {
    loop {
        let ids = shared.store.ended_before(before, STEP).await?;
        let mut left = 0;
        for id in &ids {
            if let Err(error) = expire(shared, *id, now).await {
                tracing::error!(%id, %error, "an expired job stays for now");
                left += 1;
            }
        }
        if left > 0 || ids.len() < STEP as usize {
            return Ok(());
        }
    }
}

/// The id is noted as expired first: the job's row counts as long as it is there.
async fn expire(shared: &Shared, id: JobId, now: i64) -> Result<(), JobError> {
    shared.store.note_expired(id, now).await?;
    if shared.store.begin_purge(id, now).await? {
        purge(shared.store.as_ref(), shared.blobs.as_ref(), id).await?;
        tracing::info!(%id, "expired");
    }
    Ok(())
}

async fn sweep_inputs(shared: &Shared, before: i64, now: i64) -> Result<(), StoreError> {
    loop {
        let inputs = shared.store.inputs_before(before, STEP).await?;
        let mut left = 0;
        for (id, key) in &inputs {
            match shared.blobs.delete(key).await {
                // The file first: the row must not say that it is gone while it is there.
                Ok(()) => {
                    shared.store.input_removed(*id, now).await?;
                    tracing::info!(%id, "mesh removed");
                }
                Err(error) => {
                    tracing::error!(%id, %error, "a mesh whose time is up stays for now");
                    left += 1;
                }
            }
        }
        if left > 0 || inputs.len() < STEP as usize {
            return Ok(());
        }
    }
}
