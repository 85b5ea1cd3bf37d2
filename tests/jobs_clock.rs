//! The clock jumps, by a day and by a year, ahead and back, while jobs wait, run and are kept.
#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

#[allow(dead_code)] // Each test file uses its own part.
mod jobs_fakes;

use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use futures::stream;
use jobs_fakes::{Script, ended, running, settings, submit, until};
use rosaline::jobs::{
    Clock, Idempotency, Job, JobService, JobSpec, JobStatus, ManualClock, Priority, Retention, Settings,
    Storage,
};
use tempfile::TempDir;

const NOW: i64 = 1_790_000_000_000;
const DAY: i64 = 86_400_000;
const JUMPS: [i64; 4] = [DAY, -DAY, 365 * DAY, -365 * DAY];

struct World {
    service: Arc<JobService>,
    clock: Arc<ManualClock>,
    script: Arc<Script>,
    dir: TempDir,
}

async fn world(workers: usize, change: impl FnOnce(&mut Settings)) -> World {
    let (dir, script, clock) = (tempfile::tempdir().unwrap(), Script::new(), Arc::new(ManualClock::new(NOW)));
    let mut settings = settings(&dir.path().join("data"), workers);
    change(&mut settings);
    let storage = Storage::local(&settings.data).await.unwrap();
    let service = JobService::start(storage, settings, script.clone(), clock.clone()).await.unwrap();
    World { service, clock, script, dir }
}

async fn submit_as(service: &JobService, script: &str, spec: JobSpec) -> Job {
    let body = stream::iter([Ok(Bytes::from(script.to_owned()))]);
    let upload = service.upload(body, 1 << 20).await.unwrap();
    service.submit(upload, spec).await.unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_running_job_keeps_its_lease_whatever_the_clock_says() {
    for jump in JUMPS {
        let World { service, clock, script, dir: _dir } = world(1, |_| ()).await;
        let held = submit(&service, "hold").await;
        running(&service, held.id).await;
        let waiting = submit(&service, "ok").await;
        clock.advance(jump);
        let later = submit(&service, "ok later").await;
        script.let_go();
        for id in [held.id, waiting.id, later.id] {
            assert_eq!(ended(&service, id).await.status, JobStatus::Successful, "{jump}");
        }
        assert_eq!((script.runs("hold"), script.runs("ok"), script.runs("ok later")), (1, 1, 1));
        service.shutdown(Duration::ZERO).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_restart_in_another_time_runs_what_waited_and_ids_go_on() {
    for jump in JUMPS {
        let World { service, clock, script, dir } = world(1, |_| ()).await;
        let held = submit(&service, "hold").await;
        running(&service, held.id).await;
        let waiting = submit(&service, "ok").await;
        // Not in order: as a kill leaves it.
        drop(service);
        clock.advance(jump);
        let settings = settings(&dir.path().join("data"), 1);
        let storage = until(async || Storage::local(&settings.data).await.ok()).await;
        let service =
            JobService::start(storage, settings.clone(), script.clone(), clock.clone()).await.unwrap();
        script.let_go();
        assert!(submit(&service, "ok").await.id > waiting.id, "{jump}");
        for id in [held.id, waiting.id] {
            assert_eq!(ended(&service, id).await.status, JobStatus::Successful, "{jump}");
        }
        service.shutdown(Duration::ZERO).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn ids_go_on_and_nobody_waits_when_the_clock_jumps() {
    for jump in JUMPS {
        let World { service, clock, script, dir: _dir } = world(1, |_| ()).await;
        let held = submit(&service, "hold").await;
        running(&service, held.id).await;
        let first = submit(&service, "ok first").await;
        clock.advance(jump);
        let second = submit(&service, "ok second").await;
        let urgent = JobSpec { priority: Priority::Urgent, ..JobSpec::default() };
        let urgent = submit_as(&service, "ok urgent", urgent).await;
        script.let_go();
        for job in [&first, &second, &urgent] {
            ended(&service, job.id).await;
        }
        assert!(first.id < second.id && second.id < urgent.id, "{jump}: ids go on");
        let load = service.load().await.unwrap();
        assert!(load.queue_age < Duration::from_secs(1), "nothing waits");
        assert_eq!(script.most(), 1);
        // An urgent job counts as older than it is by ten minutes; a day before it, by the clock, is older still.
        let turns = match jump {
            0.. => ["hold", "ok first", "ok urgent", "ok second"],
            _ => ["hold", "ok urgent", "ok first", "ok second"],
        };
        assert_eq!(script.begun(), turns, "{jump}");
        service.shutdown(Duration::ZERO).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn an_idempotency_key_outlives_every_jump() {
    let World { service, clock, dir: _dir, .. } = world(1, |_| ()).await;
    let key = || Some(Idempotency { key: "k".to_owned(), fingerprint: "f".to_owned() });
    let job = submit_as(&service, "ok", JobSpec { idempotency: key(), ..JobSpec::default() }).await;
    ended(&service, job.id).await;
    for jump in JUMPS {
        clock.advance(jump);
        assert_eq!(service.find("k").await.unwrap().unwrap().id, job.id);
    }
    service.shutdown(Duration::ZERO).await;
}

fn kept(settings: &mut Settings) {
    settings.retention = Retention { input: None, job: Some(Duration::from_secs(3600)) };
    settings.housekeeping = Duration::from_millis(20);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_clock_that_is_set_and_set_right_again_removes_nothing() {
    for jump in JUMPS {
        let World { service, clock, dir: _dir, .. } = world(1, kept).await;
        let job = submit(&service, "ok").await;
        ended(&service, job.id).await;
        clock.advance(jump);
        tokio::time::sleep(Duration::from_millis(300)).await;
        assert_eq!(service.status(job.id).await.unwrap().status, JobStatus::Successful, "{jump}");
        clock.advance(-jump);
        tokio::time::sleep(Duration::from_millis(100)).await;
        // Time that passes in steps as small as a clock's does remove it.
        until(async || {
            clock.advance(60 * 1000);
            tokio::time::sleep(Duration::from_millis(30)).await;
            service.status(job.id).await.err()
        })
        .await;
        service.shutdown(Duration::ZERO).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn what_ended_while_the_clock_was_ahead_does_not_stay_for_a_year() {
    let World { service, clock, dir: _dir, .. } = world(1, kept).await;
    clock.advance(365 * DAY);
    let job = submit(&service, "ok").await;
    ended(&service, job.id).await;
    clock.set(NOW);
    until(async || {
        clock.advance(60 * 1000);
        tokio::time::sleep(Duration::from_millis(30)).await;
        service.status(job.id).await.err()
    })
    .await;
    assert!(clock.now_ms() < NOW + DAY, "within a day of the right time");
    service.shutdown(Duration::ZERO).await;
}

/// Ends a job, then starts again by a clock that is this far off.
async fn restarted_by(jump: i64) -> (World, Job) {
    let World { service, clock, script, dir } = world(1, kept).await;
    let job = submit(&service, "ok").await;
    ended(&service, job.id).await;
    service.shutdown(Duration::ZERO).await;
    drop(service);
    clock.advance(jump);
    let mut settings = settings(&dir.path().join("data"), 1);
    kept(&mut settings);
    let storage = until(async || Storage::local(&settings.data).await.ok()).await;
    let service = JobService::start(storage, settings, script.clone(), clock.clone()).await.unwrap();
    (World { service, clock, script, dir }, job)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_clock_that_was_wrong_before_the_start_removes_nothing_until_it_is_right() {
    for jump in [365 * DAY, 8 * DAY, -DAY, -365 * DAY] {
        let (World { service, clock, dir: _dir, .. }, job) = restarted_by(jump).await;
        let doubt = service.clock_doubt().unwrap().to_string();
        assert!(
            doubt.contains(if jump > 0 { "no job came for" } else { "behind the newest job" }),
            "{doubt}"
        );
        for _ in 0..10 {
            clock.advance(60 * 1000);
            tokio::time::sleep(Duration::from_millis(30)).await;
        }
        assert_eq!(service.status(job.id).await.unwrap().status, JobStatus::Successful, "{jump}");
        // It is set right, and goes on.
        clock.set(NOW + 60 * 1000);
        until(async || service.clock_doubt().is_none().then_some(())).await;
        assert_eq!(service.status(job.id).await.unwrap().finished, Some(NOW), "the end stays what it was");
        until(async || {
            clock.advance(60 * 1000);
            tokio::time::sleep(Duration::from_millis(30)).await;
            service.status(job.id).await.err()
        })
        .await;
        service.shutdown(Duration::ZERO).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_service_that_was_off_for_a_while_goes_on_removing() {
    for pause in [0, DAY, 6 * DAY] {
        let (World { service, clock, dir: _dir, .. }, job) = restarted_by(pause).await;
        assert_eq!(service.clock_doubt(), None);
        clock.advance(60 * 1000);
        until(async || {
            clock.advance(60 * 1000);
            tokio::time::sleep(Duration::from_millis(30)).await;
            service.status(job.id).await.err()
        })
        .await;
        service.shutdown(Duration::ZERO).await;
    }
}
