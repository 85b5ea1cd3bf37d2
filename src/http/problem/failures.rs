//! Failures of the queue as problems.

use axum::http::header;

use super::super::idempotency;
use super::{
    INPUT_REMOVED, INTERNAL_ERROR, JOB_DISMISSED, JOB_EXPIRED, JOB_NOT_FOUND, JOB_PURGED, NO_SUCH_FORM,
    NOT_READY, NOT_RETRYABLE, Problem, RESULT_NOT_READY, STORAGE_FULL, STORAGE_UNAVAILABLE,
};
use crate::jobs::JobError;
use crate::jobs::blob::BlobError;
use crate::jobs::store::StoreError;

/// Seconds after which a client should come back to a service that is restarting.
const RETRY_AFTER_RESTART: u32 = 10;

/// Seconds after which to try a storage again that could not be used.
const RETRY_AFTER_STORAGE: u32 = 5;

impl From<JobError> for Problem {
    fn from(error: JobError) -> Self {
        match error {
            JobError::NotFound { id } => job_not_found().about(id),
            JobError::NotReady { id, status } => {
                let detail = format!("the job is {status}; ask again once its status is successful");
                Problem::new(&RESULT_NOT_READY, detail).with("job_status", status.name()).about(id)
            }
            JobError::NoSuchResult { id, format } => {
                let todo =
                    "the links of its status have the forms that are there; post the mesh again for this one";
                let detail = format!("an older version made the job, without {}; {todo}", format.extension());
                Problem::new(&NO_SUCH_FORM, detail).about(id)
            }
            JobError::Dismissed { id } => {
                Problem::new(&JOB_DISMISSED, "the job was cancelled; post the mesh again").about(id)
            }
            JobError::Failed { id, failure } => Problem::from(failure.as_ref()).about(id),
            JobError::ShuttingDown => {
                Problem::new(&NOT_READY, error.to_string()).header(header::RETRY_AFTER, RETRY_AFTER_RESTART)
            }
            JobError::Store(StoreError::Full(_)) | JobError::Blob(BlobError::Full) => Problem::new(
                &STORAGE_FULL,
                "the service's disk is full; try again when its operator has made room",
            ),
            JobError::NotFailed { id, status } => {
                let detail = format!("the job is {status}; only a failed job can be tried again");
                Problem::new(&NOT_RETRYABLE, detail).with("job_status", status.name()).about(id)
            }
            JobError::Expired { id, .. } => {
                let detail = "jobs are kept for a time that the operator set; post the mesh again";
                Problem::new(&JOB_EXPIRED, detail).about(id)
            }
            JobError::InputRemoved { id } => {
                let detail = "its mesh was removed after the time that the operator set; post it again";
                Problem::new(&INPUT_REMOVED, detail).about(id)
            }
            JobError::Purging { id } => {
                Problem::new(&JOB_PURGED, "the job is being purged and has no result; post the mesh again")
                    .about(id)
            }
            JobError::Store(StoreError::Unavailable(_))
            | JobError::Blob(BlobError::Storage(_) | BlobError::Folder(_) | BlobError::Displaced(_))
            | JobError::Folder(_) => unavailable(&error),
            JobError::Store(StoreError::KeyTaken) => idempotency::in_flight(),
            error => internal(&error),
        }
    }
}

/// Also for ids that cannot be one: whether an id is well formed is the service's own affair.
pub fn job_not_found() -> Problem {
    Problem::new(&JOB_NOT_FOUND, "no job has this id; it may have been deleted")
}

/// Logs the cause: the disk is away, read-only or broken, and may be well again soon.
fn unavailable(error: &JobError) -> Problem {
    tracing::error!(%error, "the storage cannot be used");
    let detail = "the service cannot use its storage now; try again later, its log has the cause";
    Problem::new(&STORAGE_UNAVAILABLE, detail).header(header::RETRY_AFTER, RETRY_AFTER_STORAGE)
}

/// Logs the cause, which may name folders of the server, and tells the client only that there was one.
fn internal(error: &JobError) -> Problem {
    tracing::error!(%error, "a request failed");
    Problem::new(&INTERNAL_ERROR, "the service is at fault, not the request; its log has the cause")
}
