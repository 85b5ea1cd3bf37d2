//! A run's input: read from the disk, whose outages are waited out.

use std::time::{Duration, Instant};

use bytes::Bytes;

use super::backoff::Backoff;
use super::blob::BlobError;
use super::live::Entry;
use super::worker::{Phase, Worker};
use super::{Job, JobError, JobFailure, JobStage};

/// How often a file must be found missing, in a store that is there, before its job fails: the store may just have been on
/// its way back.
const MISSES: u32 = 3;
/// How long a file may answer with errors in a store that is there: the disk may be mended, but other jobs wait for the turn.
const ERRORS: Duration = Duration::from_secs(2 * 60);

impl Worker {
    /// The input's bytes; `None` when the run is to stop. Only a file that is gone from a store that is there, or has another
    /// length, is lost: a store that is away is waited for without end, as where results are stored, and one that answers
    /// with errors for some minutes.
    pub(super) async fn read_input(&mut self, job: &Job, entry: &Entry) -> Option<Result<Bytes, JobFailure>> {
        entry.report(JobStage::Reading, 0.0);
        let (mut backoff, mut misses) = (Backoff::new(), 0);
        let mut errs_since: Option<Instant> = None;
        loop {
            let read = match self.shared.in_place().await {
                Ok(()) => self.shared.blobs.read(&job.input.key).await.map_err(JobError::from),
                Err(error) => {
                    errs_since = None;
                    Err(error)
                }
            };
            match read {
                Ok(bytes) if bytes.len() as u64 == job.input.size => return Some(Ok(bytes)),
                Ok(bytes) => {
                    let detail = format!("{} bytes were stored and {} are left", job.input.size, bytes.len());
                    return Some(Err(JobFailure::input_lost(detail)));
                }
                Err(JobError::Blob(BlobError::NotFound { .. })) => misses += 1,
                Err(error) => {
                    misses = 0;
                    if matches!(error, JobError::Blob(_))
                        && errs_since.get_or_insert_with(Instant::now).elapsed() > ERRORS
                    {
                        let detail =
                            "the data folder's disk answers with errors; mend it, then retry the job";
                        return Some(Err(JobFailure::input_lost(detail)));
                    }
                    tracing::error!(%error, "cannot read the input; its job waits until that is mended");
                }
            }
            if misses == MISSES {
                return Some(Err(JobFailure::input_lost("its file is gone from the data folder")));
            }
            self.pause_of(entry, backoff.next()).await;
            // A service that drains need not wait for a run that has not begun.
            if self.stops(entry) || self.phase() != Phase::Open {
                return None;
            }
        }
    }

    /// Waits; ends early when the job is dismissed, or the phase changes.
    async fn pause_of(&mut self, entry: &Entry, wait: Duration) {
        let mut changes = entry.subscribe();
        tokio::select! {
            () = self.pause(wait) => {}
            // The sender lives in `entry`, so the wait does not fail.
            _ = changes.wait_for(|now| now.ended) => {}
        }
    }
}
