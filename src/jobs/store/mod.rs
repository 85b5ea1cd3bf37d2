//! The job store: one table, opened by URL.

mod connection;
mod deliveries;
mod listing;
mod retention;
mod row;
mod sql;
#[cfg(test)]
mod tests;
mod turns;

use std::collections::HashSet;

use futures::future::BoxFuture;

use super::{
    Counts, Delivery, DeliveryCounts, Job, JobFailure, JobId, JobStatus, Lease, Listener, StoredArtifact,
    Told,
};

pub use sql::SqlStore;

/// Why the store did not do as asked.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    #[error("the job database is full: {0}; free space on the data folder's disk")]
    Full(sqlx::Error),
    #[error("the job database cannot be used now: {0}; see to the data folder's disk and its rights")]
    Unavailable(sqlx::Error),
    #[error("the job database failed: {0}")]
    Database(sqlx::Error),
    #[error(
        "the job database cannot be brought to this version's form: {0}; was it written by a newer version?"
    )]
    Migrate(#[from] sqlx::migrate::MigrateError),
    #[error("job {id} has an unreadable {column} in the database: {detail}")]
    Corrupt { id: String, column: &'static str, detail: String },
    #[error("another job has this idempotency key")]
    KeyTaken,
    #[error("there is no store for the URL scheme '{scheme}'; use sqlite:")]
    Scheme { scheme: String },
}

/// What a store method answers.
pub type StoreFuture<'a, T> = BoxFuture<'a, Result<T, StoreError>>;

/// Which jobs, newest first.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct ListQuery {
    /// Only jobs of this owner.
    pub owner: Option<String>,
    pub status: Option<JobStatus>,
    /// Only jobs that their client gave this word.
    pub client_reference: Option<String>,
    /// Only jobs older than this one: the `next` of the page before.
    pub before: Option<JobId>,
    /// At least 1.
    pub limit: u32,
}

/// One page of a list.
#[derive(Debug, Clone, PartialEq)]
pub struct Page {
    pub jobs: Vec<Job>,
    /// The `before` of the next page, if there is one.
    pub next: Option<JobId>,
}

/// What [`JobStore::recover`] did.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Recovered {
    /// Jobs put back to `accepted`.
    pub requeued: u64,
    /// Jobs given up.
    pub failed: u64,
}

/// What retention needs of the table of jobs.
pub trait RetentionStore {
    /// When the newest job came, by the clock of then.
    fn newest_created(&self) -> StoreFuture<'_, Option<i64>>;

    /// Jobs that ended at `time` or before, oldest first.
    fn ended_before(&self, time: i64, limit: u32) -> StoreFuture<'_, Vec<JobId>>;

    /// Those of them that still have their input, with its blob's key.
    fn inputs_before(&self, time: i64, limit: u32) -> StoreFuture<'_, Vec<(JobId, String)>>;

    /// The job's input is gone.
    fn input_removed(&self, id: JobId, now: i64) -> StoreFuture<'_, ()>;

    /// Remembers the job's id and owner for when its row is gone.
    fn note_expired(&self, id: JobId, now: i64) -> StoreFuture<'_, ()>;

    /// The owner of an expired job, if it is one.
    fn expired(&self, id: JobId) -> StoreFuture<'_, Option<Option<String>>>;

    /// Jobs that ended later than `now`, by a clock that was ahead, ended now: they would stay too long.
    fn ended_by(&self, now: i64) -> StoreFuture<'_, ()>;

    /// Forgets what expired at `time` or before.
    fn forget_expired(&self, time: i64) -> StoreFuture<'_, ()>;
}

/// The durable table of what is to be told of jobs' ends. An end is written here with the change of the job's state, for
/// every listener that there is then.
pub trait DeliveryStore: Send + Sync + 'static {
    /// Replaces the listeners; what waits for one that is gone, and is not under way, is given up.
    fn set_listeners<'a>(&'a self, listeners: &'a [Listener], now: i64) -> StoreFuture<'a, ()>;

    fn count_listeners(&self) -> StoreFuture<'_, u64>;

    /// What was under way is due again. For the start of a process that has the store for itself.
    fn release_deliveries(&self, now: i64) -> StoreFuture<'_, u64>;

    /// Whether there is something to claim: asked often, so without the writer.
    fn is_due<'a>(&'a self, listener: &'a str, now: i64) -> StoreFuture<'a, bool>;

    /// The delivery that is due for the longest, and counts the attempt; nobody else gets it before `until`.
    fn claim_delivery<'a>(
        &'a self,
        listener: &'a str,
        lease: &'a Lease,
        now: i64,
        until: i64,
    ) -> StoreFuture<'a, Option<Delivery>>;

    /// Removes, puts off or gives up a delivery that is still under `lease`; whether it was. One that is put off is given
    /// up as well where its listener is gone: nobody would claim it.
    fn settle_delivery<'a>(
        &'a self,
        id: &'a str,
        lease: &'a Lease,
        told: &'a Told,
        now: i64,
    ) -> StoreFuture<'a, bool>;

    /// Those that were given up, the latest first, from the one after `before` on.
    fn dead<'a>(&'a self, before: Option<&'a str>, limit: u32) -> StoreFuture<'a, Vec<Delivery>>;

    /// One that was given up is due again. `false`: there is none, or its listener is gone.
    fn revive<'a>(&'a self, id: &'a str, now: i64) -> StoreFuture<'a, bool>;

    /// Removes what was given up at `time` or before.
    fn forget_dead(&self, time: i64) -> StoreFuture<'_, u64>;

    fn count_deliveries(&self) -> StoreFuture<'_, DeliveryCounts>;
}

/// The durable table of jobs.
///
/// A change is on disk when its future is ready. Where a [`Lease`] is asked for, the change happens only
/// if the job still runs under that lease; the answer says whether it did. Times are epoch milliseconds.
pub trait JobStore: RetentionStore + Send + Sync + 'static {
    /// # Errors
    /// [`StoreError::KeyTaken`] when another job has its idempotency key.
    fn insert<'a>(&'a self, job: &'a Job) -> StoreFuture<'a, ()>;

    fn get(&self, id: JobId) -> StoreFuture<'_, Option<Job>>;

    /// The job that was made with this idempotency key.
    fn by_key<'a>(&'a self, key: &'a str) -> StoreFuture<'a, Option<Job>>;

    /// Leaves out, and logs, rows that cannot be read.
    fn list(&self, query: ListQuery) -> StoreFuture<'_, Page>;

    /// Sets the next waiting job running under `lease` and counts the attempt: the oldest, where urgent ones count
    /// as older than they are.
    ///
    /// A job that was running when the process died runs beside no other such job, and one that was so twice
    /// runs alone and before all others, so that a job which takes the process down is told from its
    /// neighbours.
    ///
    /// A claim that fails may have been committed all the same: see [`JobStore::unclaim`].
    fn claim<'a>(&'a self, lease: &'a Lease, now: i64) -> StoreFuture<'a, Option<Job>>;

    fn progress<'a>(
        &'a self,
        id: JobId,
        lease: &'a Lease,
        percent: u8,
        stage: Option<&'a str>,
        now: i64,
    ) -> StoreFuture<'a, bool>;

    /// running → successful.
    fn succeed<'a>(
        &'a self,
        id: JobId,
        lease: &'a Lease,
        artifacts: &'a [StoredArtifact],
        now: i64,
    ) -> StoreFuture<'a, bool>;

    /// running → failed, at the progress and stage last written.
    fn fail<'a>(
        &'a self,
        id: JobId,
        lease: &'a Lease,
        failure: &'a JobFailure,
        now: i64,
    ) -> StoreFuture<'a, bool>;

    /// running → accepted, by an orderly shutdown: the attempt does not count.
    fn release<'a>(&'a self, id: JobId, lease: &'a Lease, now: i64) -> StoreFuture<'a, bool>;

    /// running → accepted for the job that a failed [`JobStore::claim`] may have got; the attempt does not
    /// count. `false`: it got none.
    fn unclaim<'a>(&'a self, lease: &'a Lease, now: i64) -> StoreFuture<'a, bool>;

    /// failed → accepted, as if it had never run. `false`: it is not failed, or being purged.
    fn retry(&self, id: JobId, now: i64) -> StoreFuture<'_, bool>;

    /// accepted or running → dismissed. `false`: it was neither.
    fn dismiss(&self, id: JobId, now: i64) -> StoreFuture<'_, bool>;

    /// Notes that the files of a job that has ended are about to be removed, and its row after them. `false`:
    /// there is no such job, or it is active.
    fn begin_purge(&self, id: JobId, now: i64) -> StoreFuture<'_, bool>;

    /// The jobs whose purge was begun and not ended.
    fn purging(&self) -> StoreFuture<'_, Vec<JobId>>;

    /// Removes the row of a job that has ended. `false`: there is none, or it is active.
    fn delete(&self, id: JobId) -> StoreFuture<'_, bool>;

    /// Every running job → accepted, or → failed with [`JobFailure::crashed`] once it was the only one running
    /// at `max_crashes` such calls. For the start of a process that has the store for itself.
    fn recover(&self, max_crashes: u32, now: i64) -> StoreFuture<'_, Recovered>;

    fn counts(&self) -> StoreFuture<'_, Counts>;

    /// How many jobs wait.
    fn waiting(&self) -> StoreFuture<'_, u64>;

    /// When the oldest waiting job was accepted.
    fn oldest_waiting(&self) -> StoreFuture<'_, Option<i64>>;

    /// How many jobs of this owner wait or run.
    fn active_of<'a>(&'a self, owner: &'a str) -> StoreFuture<'a, u64>;

    fn newest(&self) -> StoreFuture<'_, Option<JobId>>;

    /// The keys of every blob that one of these jobs owns.
    fn blob_keys<'a>(&'a self, ids: &'a [JobId]) -> StoreFuture<'a, HashSet<String>>;

    /// Fails unless the store can be reached and written.
    fn check(&self) -> StoreFuture<'_, ()>;

    /// Finishes what is under way and closes.
    fn close(&self) -> BoxFuture<'_, ()>;
}
