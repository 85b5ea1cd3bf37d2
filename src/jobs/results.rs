//! Results: on disk first, as they are and compressed, then the row that says so; and handed out again.

use std::ops::Range;

use bytes::Bytes;
use futures::StreamExt;
use futures::future::join_all;

use super::backoff::Backoff;
#[cfg(doc)]
use super::blob::BlobError;
use super::blob::{BlobBody, BlobInfo};
use super::coding::LEAST;
use super::live::Entry;
use super::runner::Artifact;
use super::worker::{Phase, Worker};
use super::{Coding, Job, JobError, JobId, JobService, JobStage, JobStatus, Lease, StoredArtifact};
use crate::centerline::CancelToken;
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
        let artifacts = packed(artifacts, entry.cancel.clone()).await;
        let mut backoff = Backoff::new();
        loop {
            match self.write_results(job, lease, entry, &artifacts).await {
                Ok(true) => {
                    tracing::info!("successful");
                    entry.settled(JobStatus::Successful);
                    return;
                }
                Ok(false) => return self.drop_unless_named(job, lease, entry, &artifacts).await,
                Err(error) => tracing::error!(%error, "cannot store the results"),
            }
            if self.stops(entry) {
                self.abandon(job, lease).await;
                return self.drop_unless_named(job, lease, entry, &artifacts).await;
            }
            self.pause(backoff.next()).await;
        }
    }

    /// Drops the results of a run whose lease is void. A write that failed may have been committed all the
    /// same, so the row decides whether they are its own.
    async fn drop_unless_named(&self, job: &Job, lease: &Lease, entry: &Entry, artifacts: &[Packed]) {
        match self.shared.store.get(job.id).await {
            Ok(Some(found)) if found.lease.as_ref() == Some(lease) => {
                tracing::warn!("not put back; the next start does that, and removes the results");
            }
            Ok(Some(found))
                if names(&found, &result_key(job, lease, OutputFormat::Json, Coding::Identity)) =>
            {
                tracing::info!("successful");
                entry.settled(JobStatus::Successful);
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

    /// Whether the row says so now; not where the run was cancelled meanwhile.
    async fn write_results(
        &self,
        job: &Job,
        lease: &Lease,
        entry: &Entry,
        artifacts: &[Packed],
    ) -> Result<bool, JobError> {
        if entry.cancel.is_cancelled() && self.phase() != Phase::Stopping {
            return Ok(false);
        }
        self.shared.in_place().await?;
        let put = async |packed: &Packed| {
            let (format, coding) = (packed.format, packed.coding);
            let key = result_key(job, lease, format, coding);
            let body = futures::stream::iter([Ok(packed.bytes.clone())]).boxed();
            let info = self.shared.blobs.put(&key, body, u64::MAX).await?;
            Ok::<_, JobError>(StoredArtifact { format, key, size: info.size, sha256: info.sha256, coding })
        };
        // All at once: the disk then syncs them together. And all to their end, also when one fails: a file
        // that is still being written could not be dropped.
        let stored = join_all(artifacts.iter().map(put)).await.into_iter().collect::<Result<Vec<_>, _>>()?;
        if entry.cancel.is_cancelled() && self.phase() != Phase::Stopping {
            return Ok(false);
        }
        self.shared.in_place().await?;
        Ok(self.shared.store.succeed(job.id, lease, &stored, self.shared.clock.now_ms()).await?)
    }

    /// Drops whatever a run has stored under a lease that no row names.
    pub(super) async fn drop_files(&self, job: &Job, lease: &Lease) {
        let folder = format!("{}/{}", job.id, lease.as_str());
        let keys = self.shared.blobs.list(&folder).await.unwrap_or_default();
        for key in keys {
            if let Err(error) = self.shared.blobs.delete(&key).await {
                tracing::warn!(%error, "a dropped result stays until the next start");
            }
        }
    }

    async fn drop_results(&self, job: &Job, lease: &Lease, artifacts: &[Packed]) {
        for Packed { format, coding, .. } in artifacts {
            if let Err(error) = self.shared.blobs.delete(&result_key(job, lease, *format, *coding)).await {
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
fn result_key(job: &Job, lease: &Lease, format: OutputFormat, coding: Coding) -> String {
    format!("{}/{}/centerline.{}{}", job.id, lease.as_str(), format.extension(), coding.suffix())
}

/// One form of the result in one coding.
struct Packed {
    format: OutputFormat,
    coding: Coding,
    bytes: Bytes,
}

/// Every form as it is, and what viewers fetch as text compressed where that makes it smaller.
///
/// Without these once `cancel` is set.
async fn packed(artifacts: Vec<Artifact>, cancel: CancelToken) -> Vec<Packed> {
    let plain: Vec<Packed> = artifacts
        .into_iter()
        .map(|artifact| Packed {
            format: artifact.format,
            coding: Coding::Identity,
            bytes: artifact.bytes.into(),
        })
        .collect();
    let texts: Vec<(OutputFormat, Bytes)> =
        plain.iter().map(|form| (form.format, form.bytes.clone())).collect();
    let smaller = tokio::task::spawn_blocking(move || {
        texts.into_iter().flat_map(|text| smaller(text, &cancel)).collect::<Vec<_>>()
    });
    // What cannot be compressed is there as it is.
    let smaller = smaller.await.inspect_err(|error| tracing::warn!(%error, "results are not compressed"));
    plain.into_iter().chain(smaller.unwrap_or_default()).collect()
}

fn smaller((format, bytes): (OutputFormat, Bytes), cancel: &CancelToken) -> Vec<Packed> {
    // VTP is fetched seldom, and by desktop tools: compressing it would cost every job.
    if bytes.len() < LEAST || matches!(format, OutputFormat::Glb | OutputFormat::Vtp) {
        return Vec::new();
    }
    let pack = |coding: Coding| {
        let packed = coding.pack(&bytes, cancel).ok().filter(|packed| packed.len() < bytes.len())?;
        Some(Packed { format, coding, bytes: packed.into() })
    };
    Coding::PACKED.into_iter().filter_map(pack).collect()
}

impl JobService {
    /// A successful job's result in one form, as it is.
    ///
    /// # Errors
    /// [`JobError::NotReady`], [`JobError::Failed`] or [`JobError::Dismissed`] by the job's state.
    pub async fn result(&self, id: JobId, format: OutputFormat) -> Result<StoredArtifact, JobError> {
        self.result_in(id, format, &[Coding::Identity]).await
    }

    /// A successful job's result in one form, in the first of `codings` that there is.
    ///
    /// # Errors
    /// Those of [`JobService::result`].
    pub async fn result_in(
        &self,
        id: JobId,
        format: OutputFormat,
        codings: &[Coding],
    ) -> Result<StoredArtifact, JobError> {
        let job = self.successful(id).await?;
        let of = |coding: &Coding| {
            let mut forms = job.artifacts.iter();
            forms.find(|artifact| (artifact.format, artifact.coding) == (format, *coding)).cloned()
        };
        codings.iter().find_map(of).ok_or(JobError::NoSuchResult { id, format })
    }

    /// The [forms](Job::forms) of a successful job's result.
    ///
    /// # Errors
    /// Those of [`JobService::result`].
    pub async fn result_forms(&self, id: JobId) -> Result<Vec<OutputFormat>, JobError> {
        Ok(self.successful(id).await?.forms().collect())
    }

    /// A job that has a result.
    async fn successful(&self, id: JobId) -> Result<Job, JobError> {
        let job = self.row(id).await?;
        if job.purging.is_some() {
            return Err(JobError::Purging { id });
        }
        match (job.status, job.error) {
            (JobStatus::Successful, error) => Ok(Job { error, ..job }),
            (JobStatus::Failed, Some(failure)) => Err(JobError::Failed { id, failure: Box::new(failure) }),
            (JobStatus::Dismissed, _) => Err(JobError::Dismissed { id }),
            (status, _) => Err(JobError::NotReady { id, status }),
        }
    }

    /// Whether a result's file still has the bytes that were stored: its `ETag` promises them.
    ///
    /// # Errors
    /// [`JobError::ResultCut`] where it has another length, [`JobError::ResultChanged`] where it has other bytes,
    /// [`BlobError::NotFound`] where it is gone.
    pub async fn check_result(&self, artifact: &StoredArtifact) -> Result<(), JobError> {
        let found = self.shared.blobs.info(&artifact.key).await?;
        let (key, size) = (artifact.key.clone(), found.size);
        if size != artifact.size {
            return Err(JobError::ResultCut { key, stored: artifact.size, found: size });
        }
        if found.sha256 == artifact.sha256 { Ok(()) } else { Err(JobError::ResultChanged { key, size }) }
    }

    /// The bytes of a result, or of a range within it. Where the file has others they end in an error, never with the last
    /// of them; [`JobService::check_result`] says before whether it has.
    pub async fn open_result(
        &self,
        artifact: &StoredArtifact,
        range: Option<Range<u64>>,
    ) -> Result<BlobBody<'static>, JobError> {
        let of = BlobInfo { size: artifact.size, sha256: artifact.sha256.clone() };
        Ok(self.shared.blobs.open(&artifact.key, &of, range).await?)
    }
}
