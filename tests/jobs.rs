//! The job queue with its real stores and workers, and runners that misbehave.
#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

#[allow(dead_code)] // Each test file uses its own part.
mod jobs_fakes;

use std::collections::HashSet;
use std::sync::Arc;
use std::time::{Duration, Instant};

use bytes::Bytes;
use futures::stream::{self, TryStreamExt};
use jobs_fakes::{Script, ended, files, result_of, running, settings, submit, until};
use rosaline::jobs::blob::BlobError;
use rosaline::jobs::store::ListQuery;
use rosaline::jobs::{Counts, JobError, JobId, JobService, JobStatus, Removed};
use rosaline::output::OutputFormat;
use sha2::{Digest, Sha256};
use tempfile::TempDir;

/// A service in a folder of its own.
async fn service(workers: usize) -> (Arc<JobService>, Arc<Script>, TempDir) {
    let (dir, script) = (tempfile::tempdir().unwrap(), Script::new());
    let service =
        JobService::open(settings(&dir.path().join("data"), workers), script.clone()).await.unwrap();
    (service, script, dir)
}

async fn read(service: &JobService, id: JobId, format: OutputFormat) -> Vec<u8> {
    let artifact = service.result(id, format).await.unwrap();
    let reader = service.open_result(&artifact, None).await.unwrap();
    let bytes = reader.try_collect::<Vec<Bytes>>().await.unwrap().concat();
    let sha256: String = Sha256::digest(&bytes).iter().map(|byte| format!("{byte:02x}")).collect();
    assert_eq!((artifact.size, artifact.sha256), (bytes.len() as u64, sha256));
    bytes
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_runs_and_gives_every_format() {
    let (service, _, _dir) = service(1).await;
    let job = submit(&service, "ok").await;
    assert_eq!((job.status, job.progress, job.attempts), (JobStatus::Accepted, 0, 0));
    let done = ended(&service, job.id).await;
    assert_eq!((done.status, done.progress, done.stage), (JobStatus::Successful, 100, None));
    assert!(done.created <= done.started.unwrap() && done.started <= done.finished);
    for format in OutputFormat::ALL {
        assert_eq!(read(&service, job.id, format).await, result_of("ok", format));
    }
    let artifact = service.result(job.id, OutputFormat::Json).await.unwrap();
    let part = service.open_result(&artifact, Some(3..5)).await.unwrap();
    assert_eq!(part.try_collect::<Vec<Bytes>>().await.unwrap().concat(), b"as");
    service.shutdown(Duration::from_secs(5)).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_panic_or_failure_ends_its_job_and_nothing_else() {
    let (service, _, _dir) = service(1).await;
    let (panics, fails) = (submit(&service, "panic").await, submit(&service, "fail").await);
    let fine = submit(&service, "ok").await;
    let panicked = ended(&service, panics.id).await;
    assert_eq!(panicked.status, JobStatus::Failed);
    let error = panicked.error.unwrap();
    assert_eq!((error.code.as_str(), error.status), ("internal-error", 500));
    assert!(!error.to_string().contains("DOE"), "a panic's message may quote the mesh");
    let failed = ended(&service, fails.id).await;
    assert_eq!((failed.stage.as_deref(), failed.progress), (Some("tips"), 27));
    match service.result(fails.id, OutputFormat::Glb).await.unwrap_err() {
        JobError::Failed { failure, .. } => {
            assert_eq!((failure.code.as_str(), failure.status), ("no-triangles", 422))
        }
        other => panic!("{other}"),
    }
    assert_eq!(ended(&service, fine.id).await.status, JobStatus::Successful);
    service.shutdown(Duration::from_secs(5)).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn two_hundred_jobs_over_four_workers_run_once_each() {
    let (service, script, dir) = service(4).await;
    let began = Instant::now();
    let names: Vec<String> = (0..200).map(|place| format!("sleep 5 #{place}")).collect();
    let jobs = futures::future::join_all(names.iter().map(|name| submit(&service, name))).await;
    let accepted = began.elapsed();
    for job in &jobs {
        assert_eq!(ended(&service, job.id).await.status, JobStatus::Successful);
    }
    println!("200 jobs: accepted in {accepted:?}, done in {:?}", began.elapsed());
    let runs = script.all_runs();
    assert_eq!(runs.len(), 200);
    assert!(runs.values().all(|runs| *runs == 1));
    assert!((2..=4).contains(&script.most()), "{} at once", script.most());
    assert_eq!(service.counts().await.unwrap(), Counts { successful: 200, ..Counts::default() });
    let page = service.list(ListQuery { limit: 500, ..ListQuery::default() }).await.unwrap();
    let listed: HashSet<JobId> = page.jobs.iter().map(|job| job.id).collect();
    assert_eq!(listed, jobs.iter().map(|job| job.id).collect());
    assert_eq!(files(&dir.path().join("data/blobs")).len(), 200 * (1 + OutputFormat::ALL.len()));
    service.shutdown(Duration::from_secs(5)).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_dismissed_run_stops_within_100_ms_and_frees_its_worker() {
    let (service, script, _dir) = service(1).await;
    let mut slowest = Duration::ZERO;
    for _ in 0..5 {
        let job = submit(&service, "spin").await;
        running(&service, job.id).await;
        let waiting = tokio::spawn({
            let service = service.clone();
            async move { service.wait(job.id, Duration::from_secs(30)).await.unwrap() }
        });
        let began = Instant::now();
        let removed = service.remove(job.id).await.unwrap();
        assert!(matches!(removed, Removed::Dismissed(job) if job.status == JobStatus::Dismissed));
        assert_eq!(waiting.await.unwrap().status, JobStatus::Dismissed, "waiters are told");
        let next = submit(&service, "ok").await;
        assert_eq!(ended(&service, next.id).await.status, JobStatus::Successful);
        let stopped = until(async || (script.running() == 0).then(|| script.ended().unwrap())).await;
        slowest = slowest.max(stopped.duration_since(began));
        assert!(matches!(service.result(job.id, OutputFormat::Json).await, Err(JobError::Dismissed { .. })));
    }
    println!("dismissed to stopped, slowest of 5: {slowest:?}");
    assert!(script.runs("spin") == 5 && script.runs("ok") == 5);
    assert!(
        slowest < Duration::from_millis(300),
        "{slowest:?}: 100 ms for the run, the rest for a busy machine"
    );
    service.shutdown(Duration::from_secs(5)).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_dismissed_while_it_waits_never_runs() {
    let (service, script, _dir) = service(1).await;
    let first = submit(&service, "hold").await;
    running(&service, first.id).await;
    let second = submit(&service, "ok").await;
    assert!(matches!(service.result(second.id, OutputFormat::Json).await, Err(JobError::NotReady { .. })));
    assert!(matches!(service.remove(second.id).await.unwrap(), Removed::Dismissed(_)));
    let third = submit(&service, "ok 3").await;
    script.let_go();
    ended(&service, third.id).await;
    assert_eq!((script.runs("ok"), script.runs("ok 3")), (0, 1));
    assert_eq!(service.status(second.id).await.unwrap().status, JobStatus::Dismissed);
    service.shutdown(Duration::from_secs(5)).await;
}

/// Posting and deleting large meshes in a loop must not pile up threads and memory.
#[tokio::test(flavor = "multi_thread")]
async fn runs_that_ignore_their_cancellation_are_never_more_than_the_workers() {
    let (service, script, _dir) = service(1).await;
    let jobs = [submit(&service, "deaf 3500").await, submit(&service, "deaf 3501").await];
    for job in jobs {
        running(&service, job.id).await;
        assert!(matches!(service.remove(job.id).await.unwrap(), Removed::Dismissed(_)));
        until(async || service.ready().await.is_err().then_some(())).await;
        assert!(service.ready().await.unwrap_err().to_string().contains("does not stop"));
        assert_eq!(service.status(job.id).await.unwrap().status, JobStatus::Dismissed);
    }
    let next = submit(&service, "ok").await;
    assert_eq!(ended(&service, next.id).await.status, JobStatus::Successful);
    assert_eq!(script.most(), 1);
    service.ready().await.unwrap();
    service.shutdown(Duration::from_secs(5)).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_run_that_ignores_its_cancellation_holds_up_neither_its_neighbours_nor_a_shutdown() {
    let (service, _, _dir) = service(2).await;
    let deaf = submit(&service, "deaf 8000").await;
    running(&service, deaf.id).await;
    service.remove(deaf.id).await.unwrap();
    let began = Instant::now();
    let next = submit(&service, "ok").await;
    assert_eq!(ended(&service, next.id).await.status, JobStatus::Successful);
    service.shutdown(Duration::from_secs(5)).await;
    assert!(began.elapsed() < Duration::from_secs(5), "{:?}", began.elapsed());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_purged_job_leaves_neither_row_nor_file() {
    let (service, _, dir) = service(1).await;
    let blobs = dir.path().join("data/blobs");
    for script in ["ok", "fail"] {
        let job = submit(&service, script).await;
        ended(&service, job.id).await;
        assert!(files(&blobs).contains(&format!("{}/input", job.id)));
        assert_eq!(service.remove(job.id).await.unwrap(), Removed::Purged);
        assert!(matches!(service.status(job.id).await, Err(JobError::NotFound { .. })));
        assert!(matches!(service.remove(job.id).await, Err(JobError::NotFound { .. })));
        assert!(files(&blobs).is_empty(), "{:?}", files(&blobs));
    }
    service.shutdown(Duration::from_secs(5)).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_upload_that_is_not_submitted_leaves_no_file() {
    let (service, _, dir) = service(1).await;
    let upload = service.upload(stream::iter([Ok(Bytes::from_static(b"ok"))]), 10).await.unwrap();
    assert_eq!((upload.size(), upload.read().await.unwrap()), (2, Bytes::from_static(b"ok")));
    assert!(matches!(service.status(upload.id()).await, Err(JobError::NotFound { .. })));
    drop(upload);
    until(async || files(&dir.path().join("data/blobs")).is_empty().then_some(())).await;
    let large = service.upload(stream::iter([Ok(Bytes::from_static(b"longer"))]), 5).await.err().unwrap();
    assert!(matches!(large, JobError::Blob(BlobError::TooLarge { limit: 5 })), "{large}");
    service.shutdown(Duration::from_secs(5)).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn progress_shows_at_once_and_reaches_the_store() {
    let (service, script, dir) = service(1).await;
    let job = submit(&service, "hold").await;
    let live = running(&service, job.id).await;
    assert_eq!((live.progress, live.stage.as_deref()), (27, Some("tips")));
    let url = format!("sqlite://{}/data/jobs.sqlite?mode=ro", dir.path().display());
    let row = until(async || {
        let mut store = <sqlx::AnyConnection as sqlx::Connection>::connect(&url).await.unwrap();
        let row = sqlx::query_as::<_, (i64, Option<String>)>("SELECT progress, stage FROM jobs");
        row.fetch_optional(&mut store).await.unwrap().filter(|(progress, _)| *progress > 0)
    })
    .await;
    assert_eq!(row, (27, Some("tips".to_owned())));
    script.let_go();
    ended(&service, job.id).await;
    service.shutdown(Duration::from_secs(5)).await;
}

/// Four workers compute on every core while clients ask.
#[tokio::test(flavor = "multi_thread")]
async fn status_answers_in_milliseconds_while_all_workers_compute() {
    let (service, _, _dir) = service(4).await;
    let mut jobs = Vec::new();
    for _ in 0..4 {
        jobs.push(submit(&service, "spin").await);
    }
    for job in &jobs {
        running(&service, job.id).await;
    }
    let mut times = Vec::new();
    for turn in 0..400 {
        let began = Instant::now();
        let job = service.status(jobs[turn % 4].id).await.unwrap();
        times.push(began.elapsed());
        assert_eq!(job.status, JobStatus::Running);
        tokio::time::sleep(Duration::from_millis(2)).await;
    }
    times.sort();
    println!("status under load: median {:?}, p99 {:?}, worst {:?}", times[200], times[396], times[399]);
    assert!(times[200] < Duration::from_millis(20), "median {:?}", times[200]);
    for job in &jobs {
        service.remove(job.id).await.unwrap();
    }
    service.shutdown(Duration::from_secs(5)).await;
}

/// Polling is off here: a worker that missed its wake-up would sleep for an hour.
#[tokio::test(flavor = "multi_thread")]
async fn jobs_that_come_together_wake_every_worker() {
    let (service, script, _dir) = service(3).await;
    for _ in 0..20 {
        let jobs = futures::future::join_all((0..3).map(|_| submit(&service, "sleep 30000"))).await;
        until(async || (script.running() == 3).then_some(())).await;
        for job in &jobs {
            service.remove(job.id).await.unwrap();
        }
        until(async || (script.running() == 0).then_some(())).await;
    }
    service.shutdown(Duration::from_secs(5)).await;
}
