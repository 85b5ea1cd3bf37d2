//! A database that reports errors for changes that it has committed, and one with a row that cannot be read.
#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

#[allow(dead_code)] // Each test file uses its own part.
mod jobs_fakes;

use std::collections::HashSet;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

use futures::FutureExt;
use futures::future::BoxFuture;
use jobs_fakes::{Script, ended, files, result_of, running, settings, submit, until};
use rosaline::jobs::store::{JobStore, ListQuery, Page, Recovered, RetentionStore, StoreError, StoreFuture};
use rosaline::jobs::{
    Counts, Job, JobError, JobFailure, JobId, JobService, JobStatus, Lease, Removed, Storage, StoredArtifact,
    SystemClock,
};
use rosaline::output::OutputFormat;
use tempfile::TempDir;

/// A store whose next so many answers to claims or successes are lost after their commit.
struct Doubtful {
    inner: Arc<dyn JobStore>,
    claims: Arc<AtomicU32>,
    successes: Arc<AtomicU32>,
}

/// `answer`, or an error in its place when one is due.
fn lost<T>(due: &AtomicU32, answer: Result<T, StoreError>) -> Result<T, StoreError> {
    let due = due.fetch_update(Ordering::SeqCst, Ordering::SeqCst, |left| left.checked_sub(1));
    if due.is_ok() { Err(StoreError::Database(sqlx::Error::WorkerCrashed)) } else { answer }
}

impl RetentionStore for Doubtful {
    fn newest_created(&self) -> StoreFuture<'_, Option<i64>> {
        self.inner.newest_created()
    }

    fn ended_before(&self, time: i64, limit: u32) -> StoreFuture<'_, Vec<JobId>> {
        self.inner.ended_before(time, limit)
    }

    fn inputs_before(&self, time: i64, limit: u32) -> StoreFuture<'_, Vec<(JobId, String)>> {
        self.inner.inputs_before(time, limit)
    }

    fn input_removed(&self, id: JobId, now: i64) -> StoreFuture<'_, ()> {
        self.inner.input_removed(id, now)
    }

    fn note_expired(&self, id: JobId, now: i64) -> StoreFuture<'_, ()> {
        self.inner.note_expired(id, now)
    }

    fn expired(&self, id: JobId) -> StoreFuture<'_, Option<Option<String>>> {
        self.inner.expired(id)
    }

    fn ended_by(&self, now: i64) -> StoreFuture<'_, ()> {
        self.inner.ended_by(now)
    }

    fn forget_expired(&self, time: i64) -> StoreFuture<'_, ()> {
        self.inner.forget_expired(time)
    }
}

impl JobStore for Doubtful {
    fn insert<'a>(&'a self, job: &'a Job) -> StoreFuture<'a, ()> {
        self.inner.insert(job)
    }

    fn get(&self, id: JobId) -> StoreFuture<'_, Option<Job>> {
        self.inner.get(id)
    }

    fn by_key<'a>(&'a self, key: &'a str) -> StoreFuture<'a, Option<Job>> {
        self.inner.by_key(key)
    }

    fn list(&self, query: ListQuery) -> StoreFuture<'_, Page> {
        self.inner.list(query)
    }

    fn claim<'a>(&'a self, lease: &'a Lease, now: i64) -> StoreFuture<'a, Option<Job>> {
        async move {
            let claimed = self.inner.claim(lease, now).await;
            if matches!(claimed, Ok(Some(_))) { lost(&self.claims, claimed) } else { claimed }
        }
        .boxed()
    }

    fn progress<'a>(
        &'a self,
        id: JobId,
        lease: &'a Lease,
        percent: u8,
        stage: Option<&'a str>,
        now: i64,
    ) -> StoreFuture<'a, bool> {
        self.inner.progress(id, lease, percent, stage, now)
    }

    fn succeed<'a>(
        &'a self,
        id: JobId,
        lease: &'a Lease,
        artifacts: &'a [StoredArtifact],
        now: i64,
    ) -> StoreFuture<'a, bool> {
        async move { lost(&self.successes, self.inner.succeed(id, lease, artifacts, now).await) }.boxed()
    }

    fn fail<'a>(
        &'a self,
        id: JobId,
        lease: &'a Lease,
        failure: &'a JobFailure,
        now: i64,
    ) -> StoreFuture<'a, bool> {
        self.inner.fail(id, lease, failure, now)
    }

    fn release<'a>(&'a self, id: JobId, lease: &'a Lease, now: i64) -> StoreFuture<'a, bool> {
        self.inner.release(id, lease, now)
    }

    fn unclaim<'a>(&'a self, lease: &'a Lease, now: i64) -> StoreFuture<'a, bool> {
        self.inner.unclaim(lease, now)
    }

    fn retry(&self, id: JobId, now: i64) -> StoreFuture<'_, bool> {
        self.inner.retry(id, now)
    }

    fn dismiss(&self, id: JobId, now: i64) -> StoreFuture<'_, bool> {
        self.inner.dismiss(id, now)
    }

    fn begin_purge(&self, id: JobId, now: i64) -> StoreFuture<'_, bool> {
        self.inner.begin_purge(id, now)
    }

    fn purging(&self) -> StoreFuture<'_, Vec<JobId>> {
        self.inner.purging()
    }

    fn delete(&self, id: JobId) -> StoreFuture<'_, bool> {
        self.inner.delete(id)
    }

    fn recover(&self, max_crashes: u32, now: i64) -> StoreFuture<'_, Recovered> {
        self.inner.recover(max_crashes, now)
    }

    fn counts(&self) -> StoreFuture<'_, Counts> {
        self.inner.counts()
    }

    fn waiting(&self) -> StoreFuture<'_, u64> {
        self.inner.waiting()
    }

    fn oldest_waiting(&self) -> StoreFuture<'_, Option<i64>> {
        self.inner.oldest_waiting()
    }

    fn active_of<'a>(&'a self, owner: &'a str) -> StoreFuture<'a, u64> {
        self.inner.active_of(owner)
    }

    fn newest(&self) -> StoreFuture<'_, Option<JobId>> {
        self.inner.newest()
    }

    fn blob_keys<'a>(&'a self, ids: &'a [JobId]) -> StoreFuture<'a, HashSet<String>> {
        self.inner.blob_keys(ids)
    }

    fn check(&self) -> StoreFuture<'_, ()> {
        self.inner.check()
    }

    fn close(&self) -> BoxFuture<'_, ()> {
        self.inner.close()
    }
}

struct Fixture {
    service: Arc<JobService>,
    script: Arc<Script>,
    claims: Arc<AtomicU32>,
    successes: Arc<AtomicU32>,
    dir: TempDir,
}

impl Fixture {
    async fn new() -> Self {
        let (dir, script) = (tempfile::tempdir().unwrap(), Script::new());
        let (claims, successes) = (Arc::new(AtomicU32::new(0)), Arc::new(AtomicU32::new(0)));
        let mut storage = Storage::local(dir.path()).await.unwrap();
        let inner = storage.store;
        storage.store = Arc::new(Doubtful { inner, claims: claims.clone(), successes: successes.clone() });
        let settings = settings(dir.path(), 1);
        let service =
            JobService::start(storage, settings, script.clone(), Arc::new(SystemClock)).await.unwrap();
        Self { service, script, claims, successes, dir }
    }

    /// The job's result is there, and its files are all that there is.
    async fn has_result_of(&self, job: &Job, script: &str) {
        let artifact = self.service.result(job.id, OutputFormat::Json).await.unwrap();
        let path = self.dir.path().join("blobs").join(artifact.key);
        assert_eq!(std::fs::read(path).unwrap(), result_of(script, OutputFormat::Json));
        assert_eq!(files(&self.dir.path().join("blobs")).len(), 1 + OutputFormat::ALL.len());
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_success_that_was_reported_as_an_error_keeps_its_results() {
    let fixture = Fixture::new().await;
    fixture.successes.store(1, Ordering::SeqCst);
    let job = submit(&fixture.service, "ok").await;
    assert_eq!(ended(&fixture.service, job.id).await.status, JobStatus::Successful);
    // The worker has settled the job before when it ends the next one.
    let next = submit(&fixture.service, "fail").await;
    ended(&fixture.service, next.id).await;
    fixture.service.remove(next.id).await.unwrap();
    assert_eq!(fixture.script.runs("ok"), 1);
    fixture.has_result_of(&job, "ok").await;
    fixture.service.shutdown(Duration::ZERO).await;
}

/// The worker is told to stop while it is in doubt.
#[tokio::test(flavor = "multi_thread")]
async fn a_stop_in_doubt_keeps_the_results_of_a_committed_success() {
    let fixture = Fixture::new().await;
    fixture.successes.store(u32::MAX, Ordering::SeqCst);
    let job = submit(&fixture.service, "hold").await;
    running(&fixture.service, job.id).await;
    fixture.script.let_go();
    until(async || (fixture.successes.load(Ordering::SeqCst) < u32::MAX).then_some(())).await;
    fixture.service.shutdown(Duration::ZERO).await;
    let Fixture { dir, service, script, .. } = fixture;
    drop(service);
    assert_eq!(files(&dir.path().join("blobs")).len(), 1 + OutputFormat::ALL.len());
    let service = JobService::open(settings(dir.path(), 1), script.clone()).await.unwrap();
    assert_eq!(service.status(job.id).await.unwrap().status, JobStatus::Successful);
    assert_eq!(files(&dir.path().join("blobs")).len(), 1 + OutputFormat::ALL.len(), "nothing is an orphan");
    service.shutdown(Duration::ZERO).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_whose_claim_was_reported_as_an_error_runs_all_the_same() {
    let fixture = Fixture::new().await;
    fixture.claims.store(2, Ordering::SeqCst);
    let job = submit(&fixture.service, "ok").await;
    let done = ended(&fixture.service, job.id).await;
    assert_eq!((done.status, done.attempts), (JobStatus::Successful, 1), "what never ran does not count");
    fixture.has_result_of(&job, "ok").await;
    fixture.service.shutdown(Duration::ZERO).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_unreadable_newest_row_stops_neither_the_start_nor_the_list_and_can_be_deleted() {
    let (dir, script) = (tempfile::tempdir().unwrap(), Script::new());
    let service = JobService::open(settings(dir.path(), 1), script.clone()).await.unwrap();
    let jobs = [submit(&service, "ok").await.id, submit(&service, "ok").await.id];
    for id in jobs {
        ended(&service, id).await;
    }
    service.shutdown(Duration::ZERO).await;
    drop(service);
    let url = format!("sqlite://{}", dir.path().join("jobs.sqlite").display());
    let mut store = <sqlx::AnyConnection as sqlx::Connection>::connect(&url).await.unwrap();
    let spoil = "UPDATE jobs SET units = 'furlong' WHERE id = (SELECT MAX(id) FROM jobs)";
    sqlx::query(spoil).execute(&mut store).await.unwrap();

    let service = JobService::open(settings(dir.path(), 1), script).await.unwrap();
    let page = service.list(ListQuery { limit: 10, ..ListQuery::default() }).await.unwrap();
    assert_eq!(page.jobs.iter().map(|job| job.id).collect::<Vec<_>>(), jobs[..1]);
    assert!(submit(&service, "ok").await.id > jobs[1], "ids go on from it");
    assert_eq!(service.remove(jobs[1]).await.unwrap(), Removed::Purged);
    assert!(matches!(service.remove(jobs[1]).await, Err(JobError::NotFound { .. })));
    let left = files(&dir.path().join("blobs"));
    assert!(!left.iter().any(|name| name.starts_with(&jobs[1].to_string())), "{left:?}");
    service.shutdown(Duration::from_secs(5)).await;
}
