//! How the queue is set up.

use std::num::{NonZeroU32, NonZeroUsize};
use std::path::PathBuf;
use std::time::Duration;

use super::{Retention, Spans};

/// Crashes of a job that ran alone after which it is given up. The `unwrap` is tried when this is compiled.
pub const MAX_CRASHES: NonZeroU32 = NonZeroU32::new(3).unwrap();

/// How long one run of a job may take, where nothing else is set.
pub const RUN_LIMIT: Duration = Duration::from_secs(60 * 60);

/// Bytes that should be free on the data folder's disk, where nothing else is set.
pub const LEAST_FREE: u64 = 64 << 20;

/// Settings of [`super::JobService`].
#[derive(Debug, Clone)]
pub struct Settings {
    /// The one folder for everything; created on first start.
    pub data: PathBuf,
    /// Jobs that run at once, each on a rayon pool of its own.
    pub workers: NonZeroUsize,
    /// Rayon threads of each worker's pool.
    pub threads_per_worker: NonZeroUsize,
    /// Deaths of the process while a job runs alone after which that job is failed instead of run again.
    pub max_crashes: NonZeroU32,
    /// How long one run of a job may take before the job is failed.
    pub run_limit: Duration,
    /// How often an idle worker looks into the store although nobody woke it.
    pub poll: Duration,
    /// How long an ended job and its mesh are kept.
    pub retention: Retention,
    /// Bytes free on the data folder's disk below which the service is not ready for requests.
    pub least_free: u64,
    /// How often the service looks after its data folder.
    pub housekeeping: Duration,
    /// The least time between two writes of a running job's progress to the store.
    pub flush: Duration,
    /// Where the spans of requests and runs go.
    pub spans: Spans,
}

/// More workers than threads.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error(
    "{workers} workers need a thread each and there are {threads} threads; set fewer workers or more threads"
)]
pub struct TooManyWorkers {
    pub workers: NonZeroUsize,
    pub threads: NonZeroUsize,
}

impl Settings {
    /// The defaults for this machine: see [`Settings::on`].
    pub fn new(data: impl Into<PathBuf>) -> Self {
        let (workers, threads_per_worker) = share(default_workers(cores()), cores());
        Self {
            data: data.into(),
            workers,
            threads_per_worker,
            max_crashes: MAX_CRASHES,
            run_limit: RUN_LIMIT,
            retention: Retention::default(),
            least_free: LEAST_FREE,
            poll: Duration::from_secs(5),
            housekeeping: Duration::from_secs(60),
            flush: Duration::from_secs(1),
            spans: Spans::default(),
        }
    }

    /// These settings on this many threads over all workers, none more. Without `threads`: one a core, or one
    /// a worker if that is more. Without `workers`: one for four threads, and two where there are two threads,
    /// so that a small mesh does not wait behind a large one.
    ///
    /// # Errors
    /// [`TooManyWorkers`] when there is not a thread for each.
    pub fn on(
        self,
        threads: Option<NonZeroUsize>,
        workers: Option<NonZeroUsize>,
    ) -> Result<Self, TooManyWorkers> {
        let threads = threads.unwrap_or_else(|| cores().max(workers.unwrap_or(NonZeroUsize::MIN)));
        let workers = workers.unwrap_or_else(|| default_workers(threads));
        if workers > threads {
            return Err(TooManyWorkers { workers, threads });
        }
        let (workers, threads_per_worker) = share(workers, threads);
        Ok(Self { workers, threads_per_worker, ..self })
    }
}

fn cores() -> NonZeroUsize {
    std::thread::available_parallelism().unwrap_or(NonZeroUsize::MIN)
}

fn default_workers(threads: NonZeroUsize) -> NonZeroUsize {
    NonZeroUsize::new((threads.get() / 4).max(2)).map_or(NonZeroUsize::MIN, |workers| workers.min(threads))
}

/// Workers and the threads of each, for no more workers than threads.
fn share(workers: NonZeroUsize, threads: NonZeroUsize) -> (NonZeroUsize, NonZeroUsize) {
    (workers, NonZeroUsize::new(threads.get() / workers.get()).unwrap_or(NonZeroUsize::MIN))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn on(threads: Option<usize>, workers: Option<usize>) -> Result<(usize, usize), TooManyWorkers> {
        let some = |number: Option<usize>| number.map(|number| NonZeroUsize::new(number).unwrap());
        let settings = Settings::new("data").on(some(threads), some(workers))?;
        Ok((settings.workers.get(), settings.threads_per_worker.get()))
    }

    #[test]
    fn workers_never_have_more_threads_than_were_set() {
        for threads in 1..70 {
            let (workers, each) = on(Some(threads), None).unwrap();
            assert!(workers * each <= threads, "{threads} threads: {workers} workers of {each}");
            assert!(threads == 1 || workers >= 2, "{threads} threads: {workers} workers");
            for workers in 1..=threads {
                let (set, each) = on(Some(threads), Some(workers)).unwrap();
                assert!(
                    set == workers && workers * each <= threads,
                    "{threads} threads: {workers} of {each}"
                );
            }
            assert!(on(Some(threads), Some(threads + 1)).is_err());
        }
        assert_eq!(
            (on(Some(1), None), on(Some(8), None), on(Some(16), None)),
            (Ok((1, 1)), Ok((2, 4)), Ok((4, 4)))
        );
    }

    #[test]
    fn workers_alone_bring_their_threads_along() {
        assert_eq!(on(None, Some(1000)), Ok((1000, 1)));
        let (workers, each) = on(None, Some(1)).unwrap();
        assert_eq!((workers, each), (1, cores().get()));
        let error = on(Some(1), Some(2)).unwrap_err();
        assert!(error.to_string().contains("2 workers"), "{error}");
    }
}
