//! Orderly stops of the job queue, and disks that fail under it.
#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

#[allow(dead_code)] // Each test file uses its own part.
mod jobs_fakes;

use std::ops::Range;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use bytes::Bytes;
use futures::{FutureExt, StreamExt, stream};
use jobs_fakes::{Script, ended, files, running, settings, submit, until};
use rosaline::jobs::blob::{BlobBody, BlobError, BlobFuture, BlobInfo, BlobStore};
use rosaline::jobs::{FolderError, JobError, JobService, JobStatus, Storage, SystemClock};

async fn open(data: &Path, workers: usize, script: &Arc<Script>) -> Arc<JobService> {
    JobService::open(settings(data, workers), script.clone()).await.unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn running_jobs_finish_within_the_grace_and_waiting_ones_keep() {
    let (dir, script) = (tempfile::tempdir().unwrap(), Script::new());
    let service = open(dir.path(), 1, &script).await;
    let (runs, waits) = (submit(&service, "sleep 300").await, submit(&service, "ok").await);
    running(&service, runs.id).await;
    let waiting = tokio::spawn({
        let service = service.clone();
        async move { service.wait(waits.id, Duration::from_secs(30)).await.unwrap() }
    });
    tokio::time::sleep(Duration::from_millis(50)).await;
    let upload = service.upload(stream::iter([Ok(Bytes::from_static(b"ok"))]), 10).await.unwrap();
    service.ready().await.unwrap();
    service.drain();
    assert_eq!(
        waiting.await.unwrap().status,
        JobStatus::Accepted,
        "it will not start, so its waiter is told"
    );
    assert!(service.ready().await.unwrap_err().to_string().contains("shutting down"));
    assert!(matches!(service.submit(upload, Default::default()).await, Err(JobError::ShuttingDown)));
    let late = service.upload(stream::iter([Ok(Bytes::from_static(b"ok"))]), 10).await;
    assert!(matches!(late, Err(JobError::ShuttingDown)));
    assert_eq!(ended(&service, runs.id).await.status, JobStatus::Successful);
    service.shutdown(Duration::from_secs(10)).await;
    drop(service);
    let service = open(dir.path(), 1, &script).await;
    assert_eq!(service.status(runs.id).await.unwrap().status, JobStatus::Successful);
    assert_eq!(ended(&service, waits.id).await.status, JobStatus::Successful);
    assert_eq!((script.runs("sleep 300"), script.runs("ok")), (1, 1));
    service.shutdown(Duration::ZERO).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn jobs_that_outlast_the_grace_are_put_back_unharmed() {
    let (dir, script) = (tempfile::tempdir().unwrap(), Script::new());
    let mut service = open(dir.path(), 2, &script).await;
    let id = submit(&service, "spin").await.id;
    // More shutdowns than attempts: an orderly one does not count.
    for round in 1..=4 {
        let job = running(&service, id).await;
        assert_eq!((job.attempts, script.runs("spin")), (1, round));
        let began = Instant::now();
        service.shutdown(Duration::from_millis(100)).await;
        println!("shutdown with a grace of 100 ms took {:?}", began.elapsed());
        assert!(began.elapsed() < Duration::from_millis(1500));
        assert_eq!(script.running(), 0);
        drop(service);
        service = open(dir.path(), 2, &script).await;
    }
    service.shutdown(Duration::ZERO).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn one_folder_serves_one_process() {
    let (dir, script) = (tempfile::tempdir().unwrap(), Script::new());
    let service = open(dir.path(), 1, &script).await;
    let second = JobService::open(settings(dir.path(), 1), script.clone()).await.err().unwrap();
    assert!(matches!(second, JobError::Folder(FolderError::InUse { .. })), "{second}");
    let job = submit(&service, "hold").await;
    running(&service, job.id).await;
    // Dropped without a shutdown: the lock goes with the last worker.
    drop(service);
    let service = until(async || JobService::open(settings(dir.path(), 1), script.clone()).await.ok()).await;
    script.let_go();
    assert_eq!(ended(&service, job.id).await.status, JobStatus::Successful);
    service.shutdown(Duration::ZERO).await;
}

/// A disk that is full when told so.
struct Disk {
    inner: Arc<dyn BlobStore>,
    full: Arc<AtomicBool>,
    broken: Arc<AtomicBool>,
}

impl BlobStore for Disk {
    fn put<'a>(&'a self, key: &'a str, body: BlobBody<'a>, limit: u64) -> BlobFuture<'a, BlobInfo> {
        if self.full.load(Ordering::SeqCst) {
            return async { Err(BlobError::Full) }.boxed();
        }
        self.inner.put(key, body, limit)
    }

    fn open<'a>(
        &'a self,
        key: &'a str,
        of: &'a BlobInfo,
        range: Option<Range<u64>>,
    ) -> BlobFuture<'a, BlobBody<'static>> {
        self.inner.open(key, of, range)
    }

    fn info<'a>(&'a self, key: &'a str) -> BlobFuture<'a, BlobInfo> {
        self.inner.info(key)
    }

    fn read<'a>(&'a self, key: &'a str) -> BlobFuture<'a, Bytes> {
        if self.broken.load(Ordering::SeqCst) {
            return async { Err(BlobError::Folder(std::io::Error::other("EIO"))) }.boxed();
        }
        self.inner.read(key)
    }

    fn delete<'a>(&'a self, key: &'a str) -> BlobFuture<'a, ()> {
        self.inner.delete(key)
    }

    fn list<'a>(&'a self, folder: &'a str) -> BlobFuture<'a, Vec<String>> {
        self.inner.list(folder)
    }

    fn check(&self) -> BlobFuture<'_, ()> {
        self.inner.check()
    }
}

struct Fixture {
    service: Arc<JobService>,
    script: Arc<Script>,
    full: Arc<AtomicBool>,
    broken: Arc<AtomicBool>,
    dir: tempfile::TempDir,
}

impl Fixture {
    async fn new() -> Self {
        let (dir, script) = (tempfile::tempdir().unwrap(), Script::new());
        let (full, broken) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicBool::new(false)));
        let mut storage = Storage::local(dir.path()).await.unwrap();
        storage.blobs = Arc::new(Disk { inner: storage.blobs, full: full.clone(), broken: broken.clone() });
        let settings = settings(dir.path(), 1);
        let service =
            JobService::start(storage, settings, script.clone(), Arc::new(SystemClock)).await.unwrap();
        Self { service, script, full, broken, dir }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_full_disk_refuses_uploads_and_delays_results_but_loses_no_work() {
    let Fixture { service, script, full, .. } = &Fixture::new().await;
    let job = submit(service, "hold").await;
    running(service, job.id).await;
    full.store(true, Ordering::SeqCst);
    script.let_go();
    let refused = service.upload(stream::iter([Ok(Bytes::from_static(b"ok"))]).boxed(), 10).await;
    assert!(matches!(refused, Err(JobError::Blob(BlobError::Full))));
    let waits = service.wait(job.id, Duration::from_millis(500)).await.unwrap();
    assert_eq!((waits.status, waits.stage.as_deref()), (JobStatus::Running, Some("writing")));
    full.store(false, Ordering::SeqCst);
    assert_eq!(ended(service, job.id).await.status, JobStatus::Successful);
    assert_eq!(script.runs("hold"), 1, "what was computed is not computed again");
    service.shutdown(Duration::ZERO).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_shutdown_does_not_wait_for_a_full_disk() {
    let Fixture { service, script, full, dir, .. } = Fixture::new().await;
    let job = submit(&service, "hold").await;
    running(&service, job.id).await;
    full.store(true, Ordering::SeqCst);
    script.let_go();
    until(async || (script.running() == 0).then_some(())).await;
    service.shutdown(Duration::from_millis(300)).await;
    assert_eq!(files(&dir.path().join("blobs")), [format!("{}/input", job.id)]);
    drop(service);
    let service = open(dir.path(), 1, &script).await;
    assert_eq!(ended(&service, job.id).await.status, JobStatus::Successful);
    assert_eq!(script.runs("hold"), 2);
    service.shutdown(Duration::ZERO).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_input_that_cannot_be_read_fails_its_job_and_the_next_runs() {
    let Fixture { service, script, broken, dir, .. } = &Fixture::new().await;
    let holds = submit(service, "sleep 200").await;
    running(service, holds.id).await;
    let lost = submit(service, "ok").await;
    std::fs::remove_file(dir.path().join(format!("blobs/{}/input", lost.id))).unwrap();
    let shrunk = submit(service, "ok 2").await;
    std::fs::write(dir.path().join(format!("blobs/{}/input", shrunk.id)), b"o").unwrap();
    for id in [lost.id, shrunk.id] {
        let job = ended(service, id).await;
        assert_eq!(job.error.map(|error| error.code).as_deref(), Some("input-lost"));
    }
    // A disk that answers with errors is waited for.
    broken.store(true, Ordering::SeqCst);
    let (unread, dismissed) = (submit(service, "ok 3").await, submit(service, "ok 5").await);
    let waits = service.wait(unread.id, Duration::from_secs(4)).await.unwrap();
    assert_eq!((waits.status, waits.stage.as_deref()), (JobStatus::Running, Some("reading")));
    service.remove(dismissed.id).await.unwrap();
    broken.store(false, Ordering::SeqCst);
    assert_eq!(ended(service, unread.id).await.status, JobStatus::Successful);
    assert_eq!(script.runs("ok 5"), 0);
    let fine = submit(service, "ok 4").await;
    assert_eq!(ended(service, fine.id).await.status, JobStatus::Successful);
    service.shutdown(Duration::ZERO).await;
}
