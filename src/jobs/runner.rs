//! What a job does, behind an interface: one input in, results out, on a rayon pool.

use std::sync::Arc;

use bytes::Bytes;

use super::live::Entry;
use super::{JobFailure, JobSpec, JobStage, StoredInput};
use crate::centerline::{CancelToken, Part};
use crate::output::OutputFormat;

/// One run's input.
pub struct Work {
    pub input: StoredInput,
    /// The input's bytes.
    pub bytes: Bytes,
    pub spec: JobSpec,
}

/// One form of the result, not yet stored.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Artifact {
    pub format: OutputFormat,
    pub bytes: Vec<u8>,
}

/// Progress out of a run and cancellation into it.
pub struct RunControl {
    entry: Arc<Entry>,
}

impl RunControl {
    pub(super) fn new(entry: Arc<Entry>) -> Self {
        Self { entry }
    }

    /// Reports that `fraction` (0 to 1) of `stage` is done. Cheap; any thread may call it.
    pub fn report(&self, stage: JobStage, fraction: f64) {
        self.entry.report(stage, fraction);
    }

    /// [`RunControl::report`] of a part of the surface: its components go through the stages one by one.
    pub fn report_part(&self, stage: JobStage, fraction: f64, part: Part) {
        self.entry.report_part(stage, fraction, part);
    }

    /// Set when the run should stop within 100 ms; what the run then answers is dropped.
    pub fn cancel(&self) -> &CancelToken {
        &self.entry.cancel
    }
}

/// Turns an input into results.
pub trait JobRunner: Send + Sync + 'static {
    /// Called on a thread of a worker's rayon pool; parallel iterators inside use that pool. A panic fails
    /// the job and nothing else.
    ///
    /// # Errors
    /// The [`JobFailure`] that the job ends with.
    fn run(&self, work: Work, control: &RunControl) -> Result<Vec<Artifact>, JobFailure>;

    /// Called now and then while a worker has nothing to do, on a thread of its pool: what is kept for a next run
    /// alone may go.
    fn rest(&self) {}

    /// Processes that are kept for a next run.
    fn resting(&self) -> usize {
        0
    }
}
