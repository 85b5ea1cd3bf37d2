//! The places where runs compute: as many as there are workers, each with threads of its own.
//!
//! A worker leaves its place once its run has answered, and another worker takes it while the results are stored: syncs of
//! files and commits take longer than a small run, and no processor.

use std::sync::{Arc, Mutex, PoisonError};

use rayon::{ThreadPool, ThreadPoolBuildError, ThreadPoolBuilder};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use super::Settings;
use super::runner::JobRunner;

/// The stack of a pool's thread, bytes.
pub(super) const STACK: usize = 8 << 20;

/// More than the allocator shares out in pieces, bytes; they are not touched.
const LARGE: usize = 8 << 20;

/// Those places.
pub(super) struct Slots {
    free: Mutex<Vec<ThreadPool>>,
    permits: Arc<Semaphore>,
}

/// A place that is taken, until this is dropped.
pub(super) struct Slot {
    /// Always there until the drop.
    pool: Option<ThreadPool>,
    slots: Arc<Slots>,
    _permit: OwnedSemaphorePermit,
}

impl Slots {
    pub(super) fn new(settings: &Settings) -> Result<Arc<Self>, ThreadPoolBuildError> {
        let workers = settings.workers.get();
        let pools: Result<Vec<_>, _> = (0..workers).map(|number| pool(settings, number)).collect();
        Ok(Arc::new(Self { free: Mutex::new(pools?), permits: Arc::new(Semaphore::new(workers)) }))
    }

    /// Waits for a place; the first that waits gets the first that is free. Always one: the places are never closed.
    pub(super) async fn take(self: &Arc<Self>) -> Option<Slot> {
        let permit = self.permits.clone().acquire_owned().await.ok()?;
        let pool = self.free.lock().unwrap_or_else(PoisonError::into_inner).pop();
        Some(Slot { pool, slots: self.clone(), _permit: permit })
    }
}

impl Slot {
    /// Starts this on the place's threads.
    pub(super) fn spawn(&self, run: impl FnOnce() + Send + 'static) {
        // There is a pool for each permit.
        if let Some(pool) = &self.pool {
            pool.spawn(run);
        }
    }

    /// Lets go of what is kept for a next run.
    pub(super) fn rest(&self, runner: Arc<dyn JobRunner>) {
        self.spawn(move || {
            runner.rest();
            // The allocator gives back what was freed a while ago when a large block is freed, and never while a
            // service has nothing to do.
            drop(std::hint::black_box(Vec::<u8>::with_capacity(LARGE)));
        });
    }
}

impl Drop for Slot {
    fn drop(&mut self) {
        // Before the permit, which goes after this.
        self.slots.free.lock().unwrap_or_else(PoisonError::into_inner).extend(self.pool.take());
    }
}

fn pool(settings: &Settings, number: usize) -> Result<ThreadPool, ThreadPoolBuildError> {
    ThreadPoolBuilder::new()
        .num_threads(settings.threads_per_worker.get())
        .thread_name(move |thread| format!("worker-{number}-{thread}"))
        .stack_size(STACK)
        .build()
}
