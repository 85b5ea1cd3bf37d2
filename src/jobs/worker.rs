//! The workers: each claims a job from the store, runs it on the rayon pool of its place, and settles it.
//!
//! A pool a place, not one for all: a rayon thread that waits inside one job would otherwise pick up
//! another whole job, and the first could neither end nor obey its cancellation until the second is done.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use bytes::Bytes;
use futures::FutureExt;
use tokio::sync::{Notify, oneshot, watch};
use tracing::Instrument;

use super::backoff::Backoff;
use super::blob::BlobStore;
use super::faults::{Operation, Side, pass};
use super::live::{Board, Entry};
use super::meter::Meter;
use super::runner::{Artifact, JobRunner, RunControl, Work};
use super::slots::{Slot, Slots};
use super::store::{DeliveryStore, JobStore, StoreError};
use super::timeline::Timeline;
use super::watch::{flush, out_of_time, overdue};
use super::{Clock, DataFolder, Doubt, Job, JobFailure, JobStage, JobStatus, Lease, Settings};

/// Whether workers claim and run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Phase {
    Open,
    /// Running jobs go on, no new ones are claimed.
    Draining,
    /// Running jobs are stopped and put back.
    Stopping,
}

/// What the service and its workers share.
pub(super) struct Shared {
    pub(super) store: Arc<dyn JobStore>,
    pub(super) deliveries: Arc<dyn DeliveryStore>,
    pub(super) blobs: Arc<dyn BlobStore>,
    pub(super) runner: Arc<dyn JobRunner>,
    pub(super) clock: Arc<dyn Clock>,
    pub(super) board: Arc<Board>,
    pub(super) slots: Arc<Slots>,
    pub(super) settings: Settings,
    /// Locked as long as a worker lives.
    pub(super) folder: Option<DataFolder>,
    pub(super) wake: Notify,
    /// Workers that wait for a run which does not obey its cancellation.
    pub(super) held: AtomicUsize,
    pub(super) meter: Arc<Meter>,
    pub(super) phase: watch::Sender<Phase>,
    /// Why the clock is doubted now, if it is.
    pub(super) doubt: Mutex<Option<Doubt>>,
}

/// How a run ended.
pub(super) enum Outcome {
    Answered(Result<Vec<Artifact>, JobFailure>),
    Panicked,
    /// It does not obey its cancellation; ready when it ends.
    Stuck(oneshot::Receiver<Outcome>),
    /// It took longer than a run may; where it goes on all the same, ready when it ends.
    OutOfTime(Option<oneshot::Receiver<Outcome>>),
}

pub(super) struct Worker {
    pub(super) shared: Arc<Shared>,
    phase: watch::Receiver<Phase>,
    /// What was claimed and is not settled.
    at_work: Option<Job>,
}

impl Worker {
    pub(super) fn new(shared: Arc<Shared>) -> Self {
        Self { phase: shared.phase.subscribe(), shared, at_work: None }
    }

    pub(super) fn phase(&self) -> Phase {
        *self.phase.borrow()
    }

    /// Waits; ends early when the phase changes.
    pub(super) async fn pause(&mut self, wait: Duration) {
        tokio::select! {
            () = tokio::time::sleep(wait) => {}
            _ = self.phase.changed() => {}
        }
    }

    /// Claims and runs jobs until the service drains.
    pub(super) async fn work(mut self) {
        let mut backoff = Backoff::new();
        while self.phase() == Phase::Open {
            let lease = Lease::new();
            let turn = AssertUnwindSafe(self.turn(&lease, &mut backoff)).catch_unwind().await;
            if turn.is_ok() {
                continue;
            }
            tracing::error!("a worker panicked beside its run");
            let settled = AssertUnwindSafe(self.settle_panic(&lease, &mut backoff)).catch_unwind().await;
            if settled.is_err() {
                tracing::error!("and again; its job is put back by the next start");
            }
        }
    }

    /// Claims a job and works it off, or waits for one.
    async fn turn(&mut self, lease: &Lease, backoff: &mut Backoff) {
        let slots = self.shared.slots.clone();
        let Some(slot) = (tokio::select! {
            slot = slots.take() => slot,
            _ = self.phase.changed() => None,
        }) else {
            return;
        };
        if self.shared.in_place().await.is_err() {
            // It is logged where it is found. Others may wait for the slot to see it too.
            drop(slot);
            return self.pause(backoff.next()).await;
        }
        match self.shared.store.claim(lease, self.shared.clock.now_ms()).await {
            Ok(Some(job)) => {
                *backoff = Backoff::new();
                self.at_work = Some(job.clone());
                // There may be more: wake an idle worker to look.
                self.shared.wake.notify_one();
                let span = tracing::info_span!("job", id = %job.id);
                self.run(job, lease, slot).instrument(span).await;
                self.at_work = None;
                // And again: one that is to run alone waited for this one's end, and all slots may be idle.
                self.shared.wake.notify_one();
            }
            Ok(None) => {
                *backoff = Backoff::new();
                let poll = self.shared.settings.poll;
                let shared = self.shared.clone();
                tokio::select! {
                    () = shared.wake.notified() => {}
                    () = self.pause(poll) => {
                        slot.rest(shared.runner.clone());
                    }
                }
            }
            Err(error) => {
                tracing::error!(%error, "cannot claim jobs");
                self.unclaim(lease, backoff).await;
            }
        }
    }

    /// Fails the job at which the worker panicked, if it has not ended.
    async fn settle_panic(&mut self, lease: &Lease, backoff: &mut Backoff) {
        let Some(job) = self.at_work.take() else { return self.unclaim(lease, backoff).await };
        let entry = self.shared.board.start(job.id);
        entry.cancel.cancel();
        let failed = self.write_failure(&job, lease, None, &JobFailure::panicked()).await;
        match failed {
            Ok(true) => {
                entry.settled(JobStatus::Failed);
                self.drop_files(&job, lease).await;
            }
            // It had ended.
            Ok(false) => {}
            Err(error) => {
                tracing::error!(%error, "cannot write the failure; the next start puts the job back")
            }
        }
        entry.left();
        self.shared.board.end(job.id);
    }

    /// Puts back the job that a failed claim may have got, else it would wait for the next start under a
    /// lease that nobody holds. Tries until the store answers or the service drains.
    async fn unclaim(&mut self, lease: &Lease, backoff: &mut Backoff) {
        loop {
            self.pause(backoff.next()).await;
            match self.shared.store.unclaim(lease, self.shared.clock.now_ms()).await {
                Ok(put_back) => {
                    if put_back {
                        tracing::warn!("a failed claim had got a job; it is put back");
                    }
                    return;
                }
                Err(error) => tracing::error!(%error, "cannot undo a claim"),
            }
            if self.phase() != Phase::Open {
                return;
            }
        }
    }

    async fn run(&mut self, job: Job, lease: &Lease, slot: Slot) {
        let began = Instant::now();
        tracing::info!(attempt = job.attempts, bytes = job.input.size, "started");
        let entry = self.shared.board.start(job.id);
        let meter = self.shared.meter.clone();
        let (mut left, mut kept) = (None, None);
        let place = (Arc::new(slot), meter.begin());
        if self.holds(&job, lease).await {
            entry.runs(&job, Timeline::start(&job, meter.clone(), &self.shared.settings.spans));
            match self.read_input(&job, &entry).await {
                Some(Ok(bytes)) => {
                    let outcome = self.compute(&job, lease, &entry, bytes, &place.0).await;
                    let seconds = began.elapsed().as_secs_f64();
                    // Another worker may compute while this one stores, but not while the run has its threads still.
                    let goes_on = matches!(outcome, Outcome::Stuck(_) | Outcome::OutOfTime(Some(_)));
                    kept = goes_on.then_some(place);
                    left = self.settle(&job, lease, &entry, outcome, seconds).await;
                }
                Some(Err(failure)) => self.fail(&job, lease, &entry, failure).await,
                None => self.abandon(&job, lease).await,
            }
            entry.left();
        }
        self.shared.board.end(job.id);
        if let Some(run) = left {
            self.outlast(run).await;
        }
        drop(kept);
    }

    /// Waits for a run that was given up: it holds its threads and its memory, so another run beside it would
    /// take more than this worker's share.
    async fn outlast(&mut self, run: oneshot::Receiver<Outcome>) {
        self.shared.held.fetch_add(1, Ordering::Relaxed);
        tokio::select! {
            _ = run => tracing::warn!("the run that was given up has ended"),
            // The sender lives in `shared`, so the wait does not fail.
            _ = self.phase.wait_for(|phase| *phase != Phase::Open) => {}
        }
        self.shared.held.fetch_sub(1, Ordering::Relaxed);
    }

    /// Whether the job was not dismissed between its claim and its place on the board.
    async fn holds(&self, job: &Job, lease: &Lease) -> bool {
        match self.shared.store.get(job.id).await {
            Ok(found) => found.is_some_and(|found| found.lease.as_ref() == Some(lease)),
            // The fence of every later update decides.
            Err(_) => true,
        }
    }

    /// Whether this run is dismissed or to be put back.
    pub(super) fn stops(&self, entry: &Entry) -> bool {
        entry.cancel.is_cancelled() || self.phase() == Phase::Stopping
    }

    /// Runs the job on the pool and writes its progress to the store meanwhile.
    async fn compute(
        &mut self,
        job: &Job,
        lease: &Lease,
        entry: &Arc<Entry>,
        bytes: Bytes,
        slot: &Arc<Slot>,
    ) -> Outcome {
        let (answer, mut answered) = oneshot::channel();
        let (runner, control) = (self.shared.runner.clone(), RunControl::new(entry.clone()));
        let work = Work { input: job.input.clone(), bytes, spec: job.spec.clone() };
        let span = tracing::Span::current();
        // Its threads are taken until it ends, whatever becomes of the worker.
        let taken = slot.clone();
        slot.spawn(move || {
            let run = || span.in_scope(|| between_points(|| runner.run(work, &control)));
            let outcome = match catch_unwind(AssertUnwindSafe(run)) {
                Ok(result) => Outcome::Answered(result),
                Err(_) => Outcome::Panicked,
            };
            drop(taken);
            // The receiver is gone only when the run was given up.
            answer.send(outcome).ok();
        });
        let shared = self.shared.clone();
        let outcome = tokio::select! {
            biased;
            outcome = &mut answered => Some(outcome.unwrap_or(Outcome::Panicked)),
            () = flush(&shared, job, lease, entry) => None,
            () = overdue(self.phase.clone(), entry) => None,
            () = tokio::time::sleep(shared.settings.run_limit) => {
                return out_of_time(entry, answered).await;
            }
        };
        outcome.unwrap_or(Outcome::Stuck(answered))
    }

    /// Writes how the run ended; the end of a run that goes on.
    async fn settle(
        &mut self,
        job: &Job,
        lease: &Lease,
        entry: &Entry,
        outcome: Outcome,
        seconds: f64,
    ) -> Option<oneshot::Receiver<Outcome>> {
        let stopping = self.phase() == Phase::Stopping;
        match outcome {
            Outcome::Answered(Ok(artifacts)) if stopping || !entry.cancel.is_cancelled() => {
                tracing::info!(seconds, artifacts = artifacts.len(), "computed");
                self.succeed(job, lease, entry, artifacts).await;
            }
            Outcome::Answered(Err(failure)) if !entry.cancel.is_cancelled() => {
                tracing::info!(seconds, code = failure.code, "failed");
                self.fail(job, lease, entry, failure).await;
            }
            Outcome::Panicked => {
                tracing::error!(seconds, "panicked");
                self.fail(job, lease, entry, JobFailure::panicked()).await;
            }
            Outcome::OutOfTime(run) => {
                tracing::warn!(seconds, "out of time");
                let limit = self.shared.settings.run_limit.as_secs();
                self.fail(job, lease, entry, JobFailure::out_of_time(limit)).await;
                return run;
            }
            Outcome::Answered(_) => self.abandon(job, lease).await,
            Outcome::Stuck(run) => {
                tracing::error!(seconds, "the run does not obey its cancellation; its worker waits for it");
                self.abandon(job, lease).await;
                return Some(run);
            }
        }
        None
    }

    /// Puts the job back if the service stops; a dismissed one is settled already.
    pub(super) async fn abandon(&self, job: &Job, lease: &Lease) {
        match self.shared.store.release(job.id, lease, self.shared.clock.now_ms()).await {
            Ok(true) => tracing::info!("put back"),
            Ok(false) => tracing::info!("stopped, dismissed"),
            Err(error) => tracing::error!(%error, "cannot put back; the next start will"),
        }
    }

    async fn fail(&mut self, job: &Job, lease: &Lease, entry: &Entry, failure: JobFailure) {
        let mut backoff = Backoff::new();
        let at = entry.subscribe().borrow().progress();
        loop {
            match self.write_failure(job, lease, at, &failure).await {
                Ok(true) => return entry.settled(JobStatus::Failed),
                Ok(false) => return,
                Err(error) => tracing::error!(%error, "cannot write the failure"),
            }
            if self.stops(entry) {
                return self.abandon(job, lease).await;
            }
            self.pause(backoff.next()).await;
        }
    }

    async fn write_failure(
        &self,
        job: &Job,
        lease: &Lease,
        at: Option<(JobStage, u8)>,
        failure: &JobFailure,
    ) -> Result<bool, StoreError> {
        let (store, now) = (&self.shared.store, self.shared.clock.now_ms());
        if let Some((stage, percent)) = at {
            store.progress(job.id, lease, percent, Some(stage.name()), now).await?;
        }
        store.fail(job.id, lease, failure, now).await
    }
}

/// A run between its points.
fn between_points(
    run: impl FnOnce() -> Result<Vec<Artifact>, JobFailure>,
) -> Result<Vec<Artifact>, JobFailure> {
    pass(Operation::Run, Side::Before).map_err(|error| JobFailure::not_started(&error))?;
    let artifacts = run()?;
    pass(Operation::Run, Side::After).map_err(|error| JobFailure::not_started(&error))?;
    Ok(artifacts)
}
