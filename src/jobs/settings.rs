//! How the queue is set up.

use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::time::Duration;

/// Settings of [`super::JobService`].
#[derive(Debug, Clone)]
pub struct Settings {
    /// The one folder for everything; created on first start.
    pub data: PathBuf,
    /// Jobs that run at once, each on a rayon pool of its own.
    pub workers: NonZeroUsize,
    /// Rayon threads over all workers; each worker's pool gets an equal share, at least one.
    pub threads: NonZeroUsize,
    /// Starts after which a job that takes the process down is failed instead of run again.
    pub max_attempts: u32,
    /// How often an idle worker looks into the store although nobody woke it.
    pub poll: Duration,
    /// The least time between two writes of a running job's progress to the store.
    pub flush: Duration,
}

impl Settings {
    /// The defaults for this machine: a thread a core, and at least two workers so that a small mesh does
    /// not wait behind a large one.
    pub fn new(data: impl Into<PathBuf>) -> Self {
        let threads = std::thread::available_parallelism().unwrap_or(NonZeroUsize::MIN);
        let workers = NonZeroUsize::new((threads.get() / 4).max(2)).unwrap_or(NonZeroUsize::MIN);
        Self {
            data: data.into(),
            workers,
            threads,
            max_attempts: 3,
            poll: Duration::from_secs(5),
            flush: Duration::from_secs(1),
        }
    }

    /// Rayon threads of one worker.
    pub fn threads_per_worker(&self) -> usize {
        (self.threads.get() / self.workers.get()).max(1)
    }
}
