//! What is to be told of jobs that have ended, and to whom: kept with the jobs, so that nothing is lost and nothing is
//! told that did not happen. Sending it is the affair of others.

use std::future::Future;
use std::sync::{Arc, PoisonError};
use std::time::Duration;

use super::store::StoreError;
use super::worker::{Phase, Shared};
use super::{JobFailure, JobId, JobService, JobStatus, Lease};

/// No delivery waits for longer before it is tried again.
pub const LONGEST_WAIT: Duration = Duration::from_secs(12 * 60 * 60);

/// Somebody who is told of the ends of jobs.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Listener {
    /// Its name, unique.
    pub name: String,
    /// Only of jobs of this principal; `None`: of everybody's.
    pub owner: Option<String>,
    /// The ends that are told.
    pub ends: Vec<JobStatus>,
}

/// The end of a job that is to be told to one listener. Times are milliseconds since the epoch.
#[derive(Clone, PartialEq, Eq)]
pub struct Delivery {
    /// The same at every try.
    pub id: String,
    pub listener: String,
    pub job: JobId,
    pub status: JobStatus,
    pub created: i64,
    pub started: Option<i64>,
    pub finished: i64,
    /// The client's; may be patient data. `None` also once the job was purged.
    pub client_reference: Option<String>,
    /// Of a failed job.
    pub error: Option<JobFailure>,
    /// Tries so far; the one under way counts.
    pub attempts: u32,
    /// Why the last try failed.
    pub failure: Option<String>,
    /// When it was given up.
    pub died: Option<i64>,
}

impl std::fmt::Debug for Delivery {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Delivery").field("id", &self.id).field("job", &self.job).finish_non_exhaustive()
    }
}

/// How many deliveries there are.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct DeliveryCounts {
    pub waiting: u64,
    pub dead: u64,
}

/// How a try ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Told {
    /// The listener has it.
    Yes,
    /// It is to be tried again after this many milliseconds.
    Later { after: i64, failure: String },
    /// It is given up.
    Never { failure: String },
}

/// The deliveries, for those who send them.
#[derive(Clone)]
pub struct Outbox(Arc<Shared>);

impl Outbox {
    /// From now on these are told. What waits for one that is no longer there is given up.
    pub async fn listen(&self, listeners: &[Listener]) -> Result<(), StoreError> {
        self.0.deliveries.set_listeners(listeners, self.now()).await
    }

    /// How many listeners there are, as they were set last, by this process or another.
    pub async fn listeners(&self) -> Result<u64, StoreError> {
        self.0.deliveries.count_listeners().await
    }

    /// The next delivery for `listener` that is due, under `lease`; nobody else gets it for `lease_ms`.
    pub async fn claim(
        &self,
        listener: &str,
        lease: &Lease,
        lease_ms: i64,
    ) -> Result<Option<Delivery>, StoreError> {
        let now = self.now();
        if !self.0.deliveries.is_due(listener, now).await? {
            return Ok(None);
        }
        self.0.deliveries.claim_delivery(listener, lease, now, now.saturating_add(lease_ms)).await
    }

    /// Notes how a try ended; `false`: its lease had run out.
    pub async fn settle(&self, delivery: &Delivery, lease: &Lease, told: &Told) -> Result<bool, StoreError> {
        self.0.deliveries.settle_delivery(&delivery.id, lease, told, self.now()).await
    }

    /// Forgets what was given up longer than `kept_ms` ago; nothing while the clock is doubted.
    pub async fn forget(&self, kept_ms: i64) -> Result<u64, StoreError> {
        if self.0.doubt.lock().unwrap_or_else(PoisonError::into_inner).is_some() {
            return Ok(0);
        }
        self.0.deliveries.forget_dead(self.now().saturating_sub(kept_ms)).await
    }

    /// Whether nothing more is to be begun.
    pub fn is_draining(&self) -> bool {
        *self.0.phase.borrow() != Phase::Open
    }

    /// Ready when nothing more is to be begun.
    pub async fn draining(&self) {
        self.past(Phase::Open).await;
    }

    /// Ready when what is under way is to be broken off.
    pub async fn stopping(&self) {
        self.past(Phase::Draining).await;
    }

    async fn past(&self, phase: Phase) {
        // The sender lives in `shared`, so the wait does not fail.
        self.0.phase.subscribe().wait_for(|now| *now > phase).await.ok();
    }

    fn now(&self) -> i64 {
        self.0.clock.now_ms()
    }
}

impl JobService {
    pub fn outbox(&self) -> Outbox {
        Outbox(self.shared.clone())
    }

    /// Runs `task` until it ends by itself; a shutdown waits for it as it does for workers.
    pub fn run_beside(&self, task: impl Future<Output = ()> + Send + 'static) {
        self.workers.lock().unwrap_or_else(PoisonError::into_inner).push(tokio::spawn(task));
    }

    /// Deliveries that were given up, the latest first, from the one after `before` on.
    pub async fn dead_deliveries(
        &self,
        before: Option<&str>,
        limit: u32,
    ) -> Result<Vec<Delivery>, StoreError> {
        self.shared.deliveries.dead(before, limit).await
    }

    /// Lets a delivery that was given up be tried again, from its first try on; `false`: there is none.
    pub async fn resend(&self, id: &str) -> Result<bool, StoreError> {
        self.shared.deliveries.revive(id, self.shared.clock.now_ms()).await
    }

    pub async fn delivery_counts(&self) -> Result<DeliveryCounts, StoreError> {
        self.shared.deliveries.count_deliveries().await
    }
}
