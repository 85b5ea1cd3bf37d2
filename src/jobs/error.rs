//! Why the queue did not do as asked.

use super::blob::BlobError;
use super::store::StoreError;
use super::{FolderError, JobFailure, JobId, JobStatus};
use crate::output::OutputFormat;

/// Why the queue did not do as asked.
#[derive(Debug, thiserror::Error)]
pub enum JobError {
    #[error("there is no job {id}")]
    NotFound { id: JobId },
    #[error("job {id} is {status}; its result is there once it is successful")]
    NotReady { id: JobId, status: JobStatus },
    #[error("job {id} was dismissed and has no result")]
    Dismissed { id: JobId },
    #[error("job {id} failed: {failure}")]
    Failed { id: JobId, failure: Box<JobFailure> },
    #[error("job {id} is {status}; only a failed job can be tried again")]
    NotFailed { id: JobId, status: JobStatus },
    #[error("job {id} was kept for its time and is gone")]
    Expired { id: JobId, owner: Option<String> },
    #[error("the mesh of job {id} is no longer kept")]
    InputRemoved { id: JobId },
    #[error("job {id} is being purged")]
    Purging { id: JobId },
    #[error("job {id} has no result as {}", format.extension())]
    NoSuchResult { id: JobId, format: OutputFormat },
    #[error(
        "the result {key} is not what was stored: it has {found} bytes, and had {stored}; put a copy of the file back, or \
         delete its job and post the mesh again"
    )]
    ResultCut { key: String, stored: u64, found: u64 },
    #[error(
        "the result {key} is not what was stored: it has {size} bytes as it had, and some are others; put a copy of the file \
         back, or delete its job and post the mesh again"
    )]
    ResultChanged { key: String, size: u64 },
    #[error("the service is shutting down; try again when it is back")]
    ShuttingDown,
    #[error(transparent)]
    Store(#[from] StoreError),
    #[error(transparent)]
    Blob(#[from] BlobError),
    #[error(transparent)]
    Folder(#[from] FolderError),
    #[error("the worker threads cannot be started: {0}; set fewer threads")]
    Pool(#[from] rayon::ThreadPoolBuildError),
    #[error("the queue stopped on an internal error: {0}")]
    Internal(#[from] tokio::task::JoinError),
}

/// Why the service should get no requests now.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("not ready: {}", reasons.join("; "))]
pub struct Unready {
    pub reasons: Vec<String>,
}
