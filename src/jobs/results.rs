//! The end of a good run: results on disk first, then the row that says so.

use bytes::Bytes;
use futures::StreamExt;

use super::live::Entry;
use super::runner::Artifact;
use super::worker::{Backoff, Worker};
use super::{Job, JobError, JobStage, Lease, StoredArtifact};
use crate::output::OutputFormat;

impl Worker {
    /// Stores the results, then says so in the row. A full disk is waited out.
    pub(super) async fn succeed(
        &mut self,
        job: &Job,
        lease: &Lease,
        entry: &Entry,
        artifacts: Vec<Artifact>,
    ) {
        entry.report(JobStage::Writing, 0.5);
        let artifacts: Vec<(OutputFormat, Bytes)> =
            artifacts.into_iter().map(|artifact| (artifact.format, Bytes::from(artifact.bytes))).collect();
        let mut backoff = Backoff::new();
        loop {
            match self.write_results(job, lease, &artifacts).await {
                Ok(true) => {
                    tracing::info!("successful");
                    return;
                }
                Ok(false) => return self.drop_unless_named(job, lease, &artifacts).await,
                Err(error) => tracing::error!(%error, "cannot store the results"),
            }
            if self.stops(entry) {
                self.abandon(job, lease).await;
                return self.drop_unless_named(job, lease, &artifacts).await;
            }
            self.pause(backoff.next()).await;
        }
    }

    /// Drops the results of a run whose lease is void. A write that failed may have been committed all the
    /// same, so the row decides whether they are its own.
    async fn drop_unless_named(&self, job: &Job, lease: &Lease, artifacts: &[(OutputFormat, Bytes)]) {
        match self.shared.store.get(job.id).await {
            Ok(Some(found)) if found.lease.as_ref() == Some(lease) => {
                tracing::warn!("not put back; the next start does that, and removes the results");
            }
            Ok(Some(found)) if names(&found, &result_key(job, lease, OutputFormat::Json)) => {
                tracing::info!("successful");
            }
            Ok(_) => {
                tracing::info!("dismissed or put back, results dropped");
                self.drop_results(job, lease, artifacts).await;
            }
            Err(error) => {
                tracing::error!(%error, "whether the results are needed is not known; the next start decides");
            }
        }
    }

    async fn write_results(
        &self,
        job: &Job,
        lease: &Lease,
        artifacts: &[(OutputFormat, Bytes)],
    ) -> Result<bool, JobError> {
        let mut stored = Vec::with_capacity(artifacts.len());
        for (format, bytes) in artifacts {
            let key = result_key(job, lease, *format);
            let body = futures::stream::iter([Ok(bytes.clone())]).boxed();
            let info = self.shared.blobs.put(&key, body, u64::MAX).await?;
            stored.push(StoredArtifact { format: *format, key, size: info.size, sha256: info.sha256 });
        }
        Ok(self.shared.store.succeed(job.id, lease, &stored, self.shared.clock.now_ms()).await?)
    }

    async fn drop_results(&self, job: &Job, lease: &Lease, artifacts: &[(OutputFormat, Bytes)]) {
        for (format, _) in artifacts {
            if let Err(error) = self.shared.blobs.delete(&result_key(job, lease, *format)).await {
                tracing::warn!(%error, "a dropped result stays until the next start");
            }
        }
    }
}

/// Whether the job's row says that this file is its result.
fn names(job: &Job, key: &str) -> bool {
    job.artifacts.iter().any(|artifact| artifact.key == key)
}

/// The lease in the key keeps two runs of a job from writing one file.
fn result_key(job: &Job, lease: &Lease, format: OutputFormat) -> String {
    format!("{}/{}/centerline.{}", job.id, lease.as_str(), format.extension())
}
