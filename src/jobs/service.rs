//! The door to the queue.

use std::io;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use bytes::Bytes;
use futures::{Stream, StreamExt};
use tokio::sync::{Notify, watch};
use tokio::task::JoinHandle;

use super::housekeeping;
use super::live::Board;
use super::recovery::recover;
use super::runner::JobRunner;
use super::slots::Slots;
use super::store::{ListQuery, Page};
use super::worker::{Phase, Shared, Worker};
use super::{
    Clock, Counts, Doubt, IdSource, Job, JobError, JobId, JobSpec, JobStatus, Load, Settings, Spans,
    Steadiness, Storage, StoredInput, SystemClock,
};

/// A mesh that was stored for a job not yet submitted. Dropping it removes the mesh.
pub struct Upload {
    id: JobId,
    input: Option<StoredInput>,
    shared: Arc<Shared>,
}

impl Upload {
    /// The id that the job will have.
    pub fn id(&self) -> JobId {
        self.id
    }

    /// Bytes.
    pub fn size(&self) -> u64 {
        self.input.as_ref().map_or(0, |input| input.size)
    }

    /// SHA-256 of the bytes, lower-case hex.
    pub fn sha256(&self) -> &str {
        self.input.as_ref().map_or("", |input| &input.sha256)
    }

    /// The bytes, all in memory: for a look at them before the job is submitted.
    pub async fn read(&self) -> Result<Bytes, JobError> {
        let key = self.input.as_ref().map_or("", |input| &input.key);
        Ok(self.shared.blobs.read(key).await?)
    }
}

impl Drop for Upload {
    fn drop(&mut self) {
        let (Some(input), Ok(runtime)) = (self.input.take(), tokio::runtime::Handle::try_current()) else {
            return;
        };
        let shared = self.shared.clone();
        runtime.spawn(async move {
            if let Err(error) = shared.blobs.delete(&input.key).await {
                tracing::warn!(%error, "an upload without a job stays until the next start");
            }
        });
    }
}

/// The durable queue with its workers. All methods may be called from any number of tasks.
pub struct JobService {
    pub(super) shared: Arc<Shared>,
    ids: IdSource,
    pub(super) workers: Mutex<Vec<JoinHandle<()>>>,
}

impl JobService {
    /// Opens (or creates) the data folder, recovers what a dead process left, and starts the workers.
    ///
    /// Must be called inside a tokio runtime.
    ///
    /// # Errors
    /// [`super::FolderError::InUse`] while another process uses the folder.
    pub async fn open(settings: Settings, runner: Arc<dyn JobRunner>) -> Result<Arc<Self>, JobError> {
        Self::start(Storage::local(&settings.data).await?, settings, runner, Arc::new(SystemClock)).await
    }

    /// [`JobService::open`] on any storage, which nothing else uses, and any clock.
    pub async fn start(
        storage: Storage,
        settings: Settings,
        runner: Arc<dyn JobRunner>,
        clock: Arc<dyn Clock>,
    ) -> Result<Arc<Self>, JobError> {
        let (store, blobs) = (&storage.store, &storage.blobs);
        // Before anything is written with a clock that may be wrong.
        let mut steadiness = Steadiness::new(clock.now_ms(), store.newest_created().await?, Instant::now());
        recover(store.as_ref(), blobs.as_ref(), settings.max_crashes.get(), clock.now_ms()).await?;
        storage.deliveries.release_deliveries(clock.now_ms()).await?;
        let ids = IdSource::new(clock.clone(), store.newest().await?);
        let slots = Slots::new(&settings)?;
        let shared = Arc::new(Shared {
            store: storage.store,
            deliveries: storage.deliveries,
            blobs: storage.blobs,
            runner,
            clock,
            board: Arc::new(Board::default()),
            slots,
            settings,
            folder: storage.folder,
            wake: Notify::new(),
            held: AtomicUsize::new(0),
            meter: Arc::default(),
            phase: watch::Sender::new(Phase::Open),
            doubt: Mutex::new(None),
        });
        housekeeping::trusted_now(&shared, &mut steadiness);
        // As many again as there are places: they store results while others compute.
        let number = 2 * shared.settings.workers.get();
        let mut workers: Vec<_> =
            (0..number).map(|_| tokio::spawn(Worker::new(shared.clone()).work())).collect();
        housekeeping::keep_reserve(&shared).await;
        workers.push(tokio::spawn(housekeeping::keep(shared.clone(), steadiness)));
        Ok(Arc::new(Self { shared, ids, workers: Mutex::new(workers) }))
    }

    /// Where spans go.
    pub fn spans(&self) -> &Spans {
        &self.shared.settings.spans
    }

    pub(super) fn phase(&self) -> Phase {
        *self.shared.phase.borrow()
    }

    /// Streams a mesh to disk, for [`JobService::submit`]. Memory use does not grow with the body.
    ///
    /// # Errors
    /// [`super::blob::BlobError::TooLarge`] past `limit` bytes, [`super::blob::BlobError::Upload`] when `body` fails,
    /// [`super::blob::BlobError::Full`] when the disk is full, [`JobError::ShuttingDown`].
    pub async fn upload<S>(&self, body: S, limit: u64) -> Result<Upload, JobError>
    where
        S: Stream<Item = io::Result<Bytes>> + Send,
    {
        if self.phase() != Phase::Open {
            return Err(JobError::ShuttingDown);
        }
        self.shared.in_place().await?;
        let id = self.ids.next();
        let key = format!("{id}/input");
        let info = self.shared.blobs.put(&key, body.boxed(), limit).await?;
        let input = StoredInput { key, size: info.size, sha256: info.sha256 };
        Ok(Upload { id, input: Some(input), shared: self.shared.clone() })
    }

    /// Accepts a job. When the future is ready the job is durable: it will run, kill -9 or not.
    pub async fn submit(&self, upload: Upload, spec: JobSpec) -> Result<Job, JobError> {
        if self.phase() != Phase::Open {
            return Err(JobError::ShuttingDown);
        }
        // A task of its own: a client that leaves now must not tear row and file apart.
        tokio::spawn(accept(upload, spec)).await?
    }

    /// The job as it is now, progress included.
    pub async fn status(&self, id: JobId) -> Result<Job, JobError> {
        let job = match self.shared.board.row(id) {
            Some(job) => job,
            None => self.row(id).await?,
        };
        Ok(self.with_progress(job))
    }

    /// The job's row in the store.
    ///
    /// # Errors
    /// [`JobError::Expired`] where there was one, [`JobError::NotFound`] where there never was, or it was purged.
    pub(super) async fn row(&self, id: JobId) -> Result<Job, JobError> {
        match self.shared.store.get(id).await? {
            Some(job) => Ok(job),
            None => Err(match self.shared.store.expired(id).await? {
                Some(owner) => JobError::Expired { id, owner },
                None => JobError::NotFound { id },
            }),
        }
    }

    /// Lets a failed job run again, with its own mesh and parameters.
    ///
    /// # Errors
    /// [`JobError::NotFailed`] when it did not fail.
    pub async fn retry(&self, id: JobId) -> Result<Job, JobError> {
        if self.phase() != Phase::Open {
            return Err(JobError::ShuttingDown);
        }
        self.shared.in_place().await?;
        if !self.shared.store.retry(id, self.shared.clock.now_ms()).await? {
            let job = self.row(id).await?;
            return Err(match (job.purging, job.status, job.input_removed) {
                (Some(_), ..) => JobError::Purging { id },
                (None, JobStatus::Failed, Some(_)) => JobError::InputRemoved { id },
                _ => JobError::NotFailed { id, status: job.status },
            });
        }
        self.shared.wake.notify_one();
        tracing::info!(%id, "to be tried again");
        self.status(id).await
    }

    /// The job that was made with this idempotency key, as it is now.
    pub async fn find(&self, key: &str) -> Result<Option<Job>, JobError> {
        Ok(self.shared.store.by_key(key).await?.map(|job| self.with_progress(job)))
    }

    fn with_progress(&self, mut job: Job) -> Job {
        if job.status == JobStatus::Running
            && let Some((stage, percent)) =
                self.shared.board.snapshot(job.id).and_then(|live| live.progress())
        {
            job.progress = percent;
            job.stage = Some(stage.name().to_owned());
        }
        job
    }

    /// [`JobService::status`] once the job has ended, or after `limit`, whichever is first.
    pub async fn wait(&self, id: JobId, limit: Duration) -> Result<Job, JobError> {
        let mut watch = self.shared.board.watch(id);
        let job = self.status(id).await?;
        if !job.status.is_active() || limit.is_zero() {
            return Ok(job);
        }
        tokio::select! {
            // The sender lives in `watch`, so the wait does not fail.
            _ = watch.changes.wait_for(|live| live.ended) => {}
            () = self.will_not_start(id) => {}
            () = tokio::time::sleep(limit) => {}
        }
        self.status(id).await
    }

    /// [`JobService::status`] once it differs from `seen`, or after `limit`, whichever is first.
    pub async fn wait_change(&self, seen: &Job, limit: Duration) -> Result<Job, JobError> {
        let (id, end) = (seen.id, tokio::time::Instant::now() + limit);
        loop {
            let mut watch = self.shared.board.watch(id);
            watch.changes.mark_unchanged();
            let job = self.status(id).await?;
            if job != *seen || !job.status.is_active() {
                return Ok(job);
            }
            tokio::select! {
                // The sender lives in `watch`, so the wait does not fail.
                _ = watch.changes.changed() => {}
                () = self.will_not_start(id) => return Ok(job),
                () = tokio::time::sleep_until(end) => return Ok(job),
            }
        }
    }

    /// Ready when the service drains and the job does not run.
    async fn will_not_start(&self, id: JobId) {
        // The sender lives in `shared`, so the wait does not fail.
        self.shared.phase.subscribe().wait_for(|phase| *phase != Phase::Open).await.ok();
        if self.status(id).await.is_ok_and(|job| job.status == JobStatus::Running) {
            // Its worker ends the wait, also when it puts the job back.
            std::future::pending::<()>().await;
        }
    }

    /// Jobs, newest first.
    pub async fn list(&self, query: ListQuery) -> Result<Page, JobError> {
        let page = self.shared.store.list(query).await?;
        let jobs = page.jobs.into_iter().map(|job| self.with_progress(job)).collect();
        Ok(Page { jobs, next: page.next })
    }

    /// Waiting jobs.
    pub async fn waiting(&self) -> Result<u64, JobError> {
        Ok(self.shared.store.waiting().await?)
    }

    /// What there is to do.
    pub async fn load(&self) -> Result<Load, JobError> {
        let shared = &self.shared;
        let oldest = shared.store.oldest_waiting().await?;
        let age = oldest.map_or(0, |created| shared.clock.now_ms().saturating_sub(created).max(0));
        Ok(Load {
            counts: shared.store.counts().await?,
            queue_age: Duration::from_millis(age.unsigned_abs()),
            ends: shared.meter.ends(),
            workers: shared.settings.workers.get(),
            busy: shared.meter.busy(),
            held: shared.held.load(Ordering::Relaxed),
            threads: shared.settings.workers.get() * shared.settings.threads_per_worker.get(),
            busy_threads: shared.meter.busy() * shared.settings.threads_per_worker.get(),
            resting: shared.runner.resting(),
            stages: shared.meter.stages(),
        })
    }

    /// Active jobs of `owner`.
    pub async fn active_of(&self, owner: &str) -> Result<u64, JobError> {
        Ok(self.shared.store.active_of(owner).await?)
    }

    pub async fn counts(&self) -> Result<Counts, JobError> {
        Ok(self.shared.store.counts().await?)
    }

    /// Why the clock is doubted now, if it is.
    pub fn clock_doubt(&self) -> Option<Doubt> {
        *self.shared.doubt.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Refuses new jobs from now on; running ones go on.
    pub fn drain(&self) {
        self.shared.phase.send_if_modified(|phase| {
            let open = *phase == Phase::Open;
            if open {
                *phase = Phase::Draining;
            }
            open
        });
    }

    /// Drains, lets running jobs finish within `grace`, puts the others back, and closes the store.
    pub async fn shutdown(&self, grace: Duration) {
        self.drain();
        let workers = std::mem::take(&mut *self.workers.lock().unwrap_or_else(PoisonError::into_inner));
        let mut all = futures::future::join_all(workers);
        if tokio::time::timeout(grace, &mut all).await.is_err() {
            self.shared.phase.send_replace(Phase::Stopping);
            self.shared.board.cancel_all();
            all.await;
        }
        self.shared.store.close().await;
    }
}

impl Drop for JobService {
    /// Stops the workers of a service that was not shut down; its jobs run again at the next start.
    fn drop(&mut self) {
        self.shared.phase.send_replace(Phase::Stopping);
    }
}

/// Commits the row of an uploaded job and wakes a worker.
async fn accept(mut upload: Upload, spec: JobSpec) -> Result<Job, JobError> {
    let shared = upload.shared.clone();
    // An upload holds its input until it is taken here or in `drop`.
    let Some(input) = upload.input.clone() else { return Err(JobError::NotFound { id: upload.id }) };
    shared.in_place().await?;
    let job = Job::accepted(upload.id, input, spec, shared.clock.now_ms());
    shared.board.accept(&job);
    if let Err(error) = shared.store.insert(&job).await {
        shared.board.forget_accepted(job.id);
        // The commit may have happened all the same; only then does the file belong to a row.
        match shared.store.get(job.id).await {
            Ok(None) => return Err(error.into()),
            Ok(Some(_)) => {}
            Err(_) => {
                upload.input = None;
                return Err(error.into());
            }
        }
    }
    upload.input = None;
    shared.wake.notify_one();
    tracing::info!(id = %job.id, bytes = job.input.size, "accepted");
    Ok(job)
}
