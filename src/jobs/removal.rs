//! Cancelling and purging.

use super::housekeeping::keep_reserve;
use super::recovery::purge;
use super::store::{StoreError, StoreFuture};
use super::{Job, JobError, JobId, JobService, JobStatus};

/// What [`JobService::remove`] did.
#[derive(Debug, Clone, PartialEq)]
pub enum Removed {
    /// The job was active; it is dismissed now.
    Dismissed(Box<Job>),
    /// The job had ended; it and its files are gone.
    Purged,
}

impl JobService {
    /// Cancels an active job; purges one that has ended, or whose row cannot be read, with its files.
    ///
    /// When the future is ready with [`Removed::Purged`], the files are gone. Where one stays, so does the row, and
    /// the purge is tried again later.
    pub async fn remove(&self, id: JobId) -> Result<Removed, JobError> {
        // Each turn ends unless the job changed its state in between.
        loop {
            let job = match self.row(id).await {
                Ok(job) => Some(job),
                Err(JobError::Store(StoreError::Corrupt { .. })) => None,
                Err(error) => return Err(error),
            };
            let active = job.as_ref().is_none_or(|job| job.status.is_active());
            if active && self.dismiss(id).await? && job.is_some() {
                return Ok(Removed::Dismissed(Box::new(self.status(id).await?)));
            }
            if (!active || job.is_none()) && self.purge(id).await? {
                return Ok(Removed::Purged);
            }
        }
    }

    /// Ends an active job and its run; whether it was active.
    async fn dismiss(&self, id: JobId) -> Result<bool, JobError> {
        let (shared, board) = (&self.shared, &self.shared.board);
        let now = shared.clock.now_ms();
        let dismissed = self.with_reserve(|| shared.store.dismiss(id, now)).await;
        // After an error it may be committed all the same: the store knows.
        let dismissed = dismissed.inspect_err(|_| board.forget_accepted(id))?;
        if dismissed {
            board.cancel(id);
            board.end(id);
            // Others may have waited for it to go first.
            shared.wake.notify_one();
            shared.meter.ended(JobStatus::Dismissed);
            tracing::info!(%id, "dismissed");
        }
        Ok(dismissed)
    }

    /// Removes an ended job's files and then its row; whether it had ended.
    async fn purge(&self, id: JobId) -> Result<bool, JobError> {
        let shared = self.shared.clone();
        // A file that is not at its path is taken for one that is gone.
        shared.in_place().await?;
        let now = shared.clock.now_ms();
        let begun = self.with_reserve(|| shared.store.begin_purge(id, now)).await?;
        if begun {
            let stores = shared.clone();
            // A task of its own: a client that leaves now must not leave half of it.
            tokio::spawn(async move { purge(stores.store.as_ref(), stores.blobs.as_ref(), id).await })
                .await??;
            tracing::info!(%id, "purged");
            // From what that has freed, for the next one.
            keep_reserve(&shared).await;
        }
        Ok(begun)
    }

    /// Makes a change that frees space; on a full disk, with the room that is kept for that.
    async fn with_reserve<'a>(
        &'a self,
        change: impl Fn() -> StoreFuture<'a, bool>,
    ) -> Result<bool, StoreError> {
        match (change().await, &self.shared.folder) {
            (Err(StoreError::Full(_)), Some(folder)) => {
                folder.release_reserve();
                change().await
            }
            (changed, _) => changed,
        }
    }
}
