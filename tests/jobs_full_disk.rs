//! A disk that is really full: a small tmpfs. Needs the right to mount, else it skips.
#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

#[allow(dead_code)] // Each test file uses its own part.
mod jobs_fakes;
#[path = "common/small_disk.rs"]
mod small_disk;

use std::time::Duration;

use bytes::Bytes;
use futures::stream;
use jobs_fakes::{Script, ended, files, running, settings, submit, until};
use rosaline::jobs::blob::BlobError;
use rosaline::jobs::store::StoreError;
use rosaline::jobs::{JobError, JobService, JobSpec, JobStatus};
use small_disk::SmallDisk;

#[tokio::test(flavor = "multi_thread")]
async fn a_full_disk_refuses_and_recovers_by_itself() {
    let Some(disk) = SmallDisk::mount() else { return };
    let (data, script) = (disk.path().join("data"), Script::new());
    let service = JobService::open(settings(&data, 1), script.clone()).await.unwrap();
    let job = submit(&service, "hold").await;
    running(&service, job.id).await;
    let early = service.upload(stream::iter([Ok(Bytes::from_static(b"ok"))]), 10).await.unwrap();
    let id = early.id();

    disk.fill();
    script.let_go();
    let chunks = (0..16).map(|_| Ok(Bytes::from(vec![1; 1 << 20])));
    let refused = service.upload(stream::iter(chunks), u64::MAX).await.err().unwrap();
    assert!(matches!(refused, JobError::Blob(BlobError::Full)), "{refused:?}");
    let refused = service.submit(early, JobSpec::default()).await.err().unwrap();
    assert!(matches!(refused, JobError::Store(StoreError::Full(_))), "{refused:?}");
    assert!(matches!(service.status(id).await, Err(JobError::NotFound { .. })));
    // The refused uploads are removed; what that frees is filled again.
    until(async || (files(&data.join("blobs")).len() == 1).then_some(())).await;
    disk.fill();
    assert!(service.ready().await.unwrap_err().to_string().contains("full"));
    let waits = service.wait(job.id, Duration::from_millis(300)).await.unwrap();
    assert_eq!((waits.status, waits.stage.as_deref()), (JobStatus::Running, Some("writing")));

    disk.free();
    assert_eq!(ended(&service, job.id).await.status, JobStatus::Successful);
    service.ready().await.unwrap();
    let next = submit(&service, "ok").await;
    assert_eq!(ended(&service, next.id).await.status, JobStatus::Successful);
    // The inputs and results of two jobs, and nothing of what was refused.
    until(async || {
        (files(&data.join("blobs")).len() == 2 * (1 + rosaline::output::OutputFormat::ALL.len()))
            .then_some(())
    })
    .await;
    service.shutdown(Duration::from_secs(5)).await;
}
