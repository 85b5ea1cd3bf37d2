//! What every job store must do, tried on SQLite.

mod deliveries;
mod forms;
mod listing;

use std::collections::HashSet;
use std::sync::Arc;

use sqlx::{Connection, Row};
use tempfile::TempDir;

use super::*;
use crate::jobs::{
    Coding, FileName, FormatHint, IdSource, Idempotency, JobSpec, ManualClock, Origin, Priority, StoredInput,
};
use crate::mesh::Units;
use crate::output::OutputFormat;

struct Fixture {
    store: SqlStore,
    ids: IdSource,
    dir: TempDir,
}

impl Fixture {
    async fn new() -> Self {
        let dir = tempfile::tempdir().unwrap();
        let store = SqlStore::open(&url(&dir)).await.unwrap();
        Self { store, ids: IdSource::new(Arc::new(ManualClock::new(1_000)), None), dir }
    }

    async fn insert(&self) -> Job {
        let id = self.ids.next();
        let input = StoredInput { key: format!("{id}/input"), size: 84, sha256: "ab".repeat(32) };
        let job = Job::accepted(id, input, JobSpec::default(), 1_000);
        self.store.insert(&job).await.unwrap();
        job
    }

    async fn get(&self, id: JobId) -> Job {
        self.store.get(id).await.unwrap().unwrap()
    }

    /// A claimed job and its lease.
    async fn claim(&self) -> (Job, Lease) {
        let lease = Lease::new();
        (self.store.claim(&lease, 2_000).await.unwrap().unwrap(), lease)
    }

    /// The statement's first column, by a connection of its own.
    async fn ask(&self, sql: &'static str) -> String {
        let mut connection = sqlx::AnyConnection::connect(&url(&self.dir)).await.unwrap();
        sqlx::query(sql).fetch_one(&mut connection).await.unwrap().get(0)
    }
}

fn url(dir: &TempDir) -> String {
    format!("sqlite://{}/jobs.sqlite?mode=rwc", dir.path().display())
}

fn artifact(id: JobId) -> StoredArtifact {
    StoredArtifact {
        format: OutputFormat::Glb,
        key: format!("{id}/x/glb"),
        size: 7,
        sha256: "cd".repeat(32),
        coding: Coding::Zstd,
    }
}

#[tokio::test]
async fn what_was_deleted_is_in_no_file_after_a_round_of_the_housekeeping() {
    let fixture = Fixture::new().await;
    let mut job = fixture.insert().await;
    job.id = fixture.ids.next();
    job.spec.origin.request_id = Some("DOE^JANE".to_owned());
    fixture.store.insert(&job).await.unwrap();
    let found = || {
        let files = std::fs::read_dir(fixture.dir.path()).unwrap().map(|entry| entry.unwrap().path());
        let bytes = files.flat_map(|path| std::fs::read(path).unwrap()).collect::<Vec<u8>>();
        bytes.windows(8).filter(|word| *word == b"DOE^JANE").count()
    };
    assert_ne!(found(), 0);
    assert!(fixture.store.dismiss(job.id, 2_000).await.unwrap());
    assert!(fixture.store.delete(job.id).await.unwrap());
    fixture.store.forget_expired(0).await.unwrap();
    assert_eq!(found(), 0);
}

#[tokio::test]
async fn a_job_reads_back_as_it_was_inserted_also_after_reopening() {
    let fixture = Fixture::new().await;
    let mut job = fixture.insert().await;
    assert_eq!(fixture.get(job.id).await, job);
    job.id = fixture.ids.next();
    job.spec.name = Some(FileName::new("d'oe\"; DROP TABLE jobs; -- ñ.stl"));
    job.spec.units = Units::Inches;
    job.spec.priority = Priority::Urgent;
    job.spec.hint = FormatHint { extension: Some("stl".into()), content_type: Some("model/stl".into()) };
    job.spec.parameters.values.insert("omega".into(), 0.1 + 0.2);
    job.spec.origin = Origin {
        request_id: Some("r'1".into()),
        client_reference: Some("ñ \"x\"".into()),
        traceparent: Some("00-4bf92f3577b34da6a3ce929d0e0e4736-00f067aa0ba902b7-01".into()),
    };
    job.spec.idempotency = Some(Idempotency { key: "k".into(), fingerprint: "f".into() });
    job.stage = Some("tips".into());
    (job.progress, job.started, job.finished, job.attempts) = (57, Some(3), Some(4), 2);
    job.error = Some(JobFailure::new("code", 422, "title", "detail"));
    job.artifacts = vec![artifact(job.id)];
    job.lease = Some(Lease::new());
    fixture.store.insert(&job).await.unwrap();
    fixture.store.close().await;
    let reopened = SqlStore::open(&url(&fixture.dir)).await.unwrap();
    assert_eq!(reopened.get(job.id).await.unwrap(), Some(job.clone()));
    assert_eq!(reopened.newest().await.unwrap(), Some(job.id));
    assert!(reopened.insert(&job).await.is_err(), "an id is taken once");
}

#[tokio::test]
async fn commits_survive_a_power_cut_and_readers_do_not_wait() {
    let fixture = Fixture::new().await;
    assert_eq!(fixture.ask("SELECT CAST(journal_mode AS TEXT) FROM pragma_journal_mode").await, "wal");
    // `synchronous` is a connection's own: ask the store's.
    for pool in fixture.store.pools() {
        let row = sqlx::query("SELECT synchronous FROM pragma_synchronous").fetch_one(pool).await.unwrap();
        assert_eq!(row.get::<i64, _>(0), 2, "FULL");
    }
}

#[tokio::test]
async fn jobs_are_claimed_oldest_first_and_once() {
    let fixture = Fixture::new().await;
    let (first, second) = (fixture.insert().await, fixture.insert().await);
    let (claimed, lease) = fixture.claim().await;
    assert_eq!((claimed.id, claimed.status, claimed.attempts), (first.id, JobStatus::Running, 1));
    assert_eq!((claimed.lease, claimed.started), (Some(lease), Some(2_000)));
    assert_eq!(fixture.claim().await.0.id, second.id);
    assert_eq!(fixture.store.claim(&Lease::new(), 2_000).await.unwrap(), None);
}

#[tokio::test]
async fn fifty_claims_at_once_get_fifty_different_jobs() {
    let fixture = Fixture::new().await;
    for _ in 0..50 {
        fixture.insert().await;
    }
    let claims = (0..60).map(|_| async {
        let lease = Lease::new();
        fixture.store.claim(&lease, 2_000).await.unwrap().map(|job| job.id)
    });
    let claimed: Vec<JobId> = futures::future::join_all(claims).await.into_iter().flatten().collect();
    assert_eq!(claimed.len(), 50);
    assert_eq!(claimed.iter().collect::<HashSet<_>>().len(), 50);
}

#[tokio::test]
async fn an_update_without_the_lease_changes_nothing() {
    let fixture = Fixture::new().await;
    fixture.insert().await;
    let (job, lease) = fixture.claim().await;
    let (store, failure, other) = (&fixture.store, JobFailure::panicked(), Lease::new());
    assert!(!store.progress(job.id, &other, 50, Some("tips"), 3_000).await.unwrap());
    assert!(!store.succeed(job.id, &other, &[artifact(job.id)], 3_000).await.unwrap());
    assert!(!store.fail(job.id, &other, &failure, 3_000).await.unwrap());
    assert!(!store.release(job.id, &other, 3_000).await.unwrap());
    assert_eq!(fixture.get(job.id).await, job);
    assert!(store.progress(job.id, &lease, 50, Some("tips"), 3_000).await.unwrap());
    let running = fixture.get(job.id).await;
    assert_eq!((running.progress, running.stage.as_deref(), running.updated), (50, Some("tips"), 3_000));
    assert!(store.succeed(job.id, &lease, &[artifact(job.id)], 4_000).await.unwrap());
    let done = fixture.get(job.id).await;
    assert_eq!((done.status, done.progress, done.finished), (JobStatus::Successful, 100, Some(4_000)));
    assert_eq!((done.artifacts, done.lease), (vec![artifact(job.id)], None));
    assert!(!store.fail(job.id, &lease, &failure, 5_000).await.unwrap(), "a job ends once");
    assert!(!store.dismiss(job.id, 5_000).await.unwrap());
}

#[tokio::test]
async fn a_dismissed_job_cannot_be_finished_by_its_worker() {
    let fixture = Fixture::new().await;
    fixture.insert().await;
    let (job, lease) = fixture.claim().await;
    assert!(!fixture.store.delete(job.id).await.unwrap(), "an active job is not deleted");
    assert!(fixture.store.dismiss(job.id, 3_000).await.unwrap());
    assert!(!fixture.store.dismiss(job.id, 3_000).await.unwrap());
    assert!(!fixture.store.succeed(job.id, &lease, &[], 4_000).await.unwrap());
    assert!(!fixture.store.release(job.id, &lease, 4_000).await.unwrap());
    assert_eq!(fixture.get(job.id).await.status, JobStatus::Dismissed);
    assert!(fixture.store.delete(job.id).await.unwrap());
    assert!(!fixture.store.delete(job.id).await.unwrap());
    assert_eq!(fixture.store.get(job.id).await.unwrap(), None);
}

#[tokio::test]
async fn an_orderly_release_does_not_count_as_an_attempt() {
    let fixture = Fixture::new().await;
    fixture.insert().await;
    for _ in 0..5 {
        let (job, lease) = fixture.claim().await;
        assert_eq!(job.attempts, 1);
        assert!(fixture.store.release(job.id, &lease, 3_000).await.unwrap());
    }
    assert_eq!(fixture.store.recover(3, 4_000).await.unwrap(), Recovered::default());
}

#[tokio::test]
async fn a_job_that_crashes_three_times_is_given_up() {
    let fixture = Fixture::new().await;
    let job = fixture.insert().await;
    for _ in 0..2 {
        let (_, lease) = fixture.claim().await;
        assert_eq!(fixture.store.recover(3, 3_000).await.unwrap(), Recovered { requeued: 1, failed: 0 });
        assert!(!fixture.store.succeed(job.id, &lease, &[], 3_000).await.unwrap(), "its old lease is void");
    }
    fixture.claim().await;
    assert_eq!(fixture.store.recover(3, 5_000).await.unwrap(), Recovered { requeued: 0, failed: 1 });
    let failed = fixture.get(job.id).await;
    assert_eq!((failed.status, failed.finished), (JobStatus::Failed, Some(5_000)));
    assert_eq!(failed.error.map(|error| error.code).as_deref(), Some("crashed"));
}

#[tokio::test]
async fn jobs_that_were_running_at_a_crash_run_one_at_a_time() {
    let fixture = Fixture::new().await;
    let (first, second) = (fixture.insert().await, fixture.insert().await);
    fixture.claim().await;
    fixture.claim().await;
    fixture.store.recover(3, 3_000).await.unwrap();
    let fresh = fixture.insert().await;
    let (suspect, lease) = fixture.claim().await;
    assert_eq!(suspect.id, first.id);
    assert_eq!(fixture.claim().await.0.id, fresh.id, "new jobs go on beside a suspect");
    assert_eq!(fixture.store.claim(&Lease::new(), 3_000).await.unwrap(), None);
    assert!(fixture.store.succeed(first.id, &lease, &[], 4_000).await.unwrap());
    assert_eq!(fixture.claim().await.0.id, second.id);
}

#[tokio::test]
async fn kills_in_company_give_nobody_up_and_lead_to_a_trial_alone() {
    let fixture = Fixture::new().await;
    let (first, second) = (fixture.insert().await, fixture.insert().await);
    let (store, nothing) = (&fixture.store, Recovered::default());
    for beside in [second.id, fixture.insert().await.id] {
        assert_eq!([fixture.claim().await.0.id, fixture.claim().await.0.id], [first.id, beside]);
        // With one crash a job would be given up.
        assert_eq!(store.recover(1, 3_000).await.unwrap(), Recovered { requeued: 2, ..nothing });
    }
    for _ in 0..3 {
        let (alone, lease) = fixture.claim().await;
        assert_eq!((alone.id, alone.attempts), (first.id, 3));
        fixture.insert().await;
        assert_eq!(store.claim(&Lease::new(), 3_000).await.unwrap(), None, "nobody beside it");
        assert!(store.release(alone.id, &lease, 3_000).await.unwrap(), "an orderly stop does not count");
        assert_eq!(store.recover(1, 3_000).await.unwrap(), nothing);
    }
    fixture.claim().await;
    assert_eq!(store.recover(1, 4_000).await.unwrap(), Recovered { failed: 1, ..nothing });
    assert_eq!(fixture.get(first.id).await.error.map(|error| error.code).as_deref(), Some("crashed"));
    assert_eq!(fixture.claim().await.0.id, second.id);
}

#[tokio::test]
async fn a_trial_alone_waits_for_those_that_run_and_goes_before_those_that_wait() {
    let fixture = Fixture::new().await;
    let (busy, mut tried) = (fixture.insert().await, fixture.insert().await);
    let (_, lease) = fixture.claim().await;
    fixture.store.dismiss(tried.id, 2_000).await.unwrap();
    fixture.store.delete(tried.id).await.unwrap();
    fixture.insert().await;
    tried.attempts = 2;
    fixture.store.insert(&tried).await.unwrap();
    assert_eq!(fixture.store.claim(&Lease::new(), 3_000).await.unwrap(), None, "it waits for the busy one");
    assert!(fixture.store.succeed(busy.id, &lease, &[], 4_000).await.unwrap());
    assert_eq!(fixture.claim().await.0.id, tried.id);
}

#[tokio::test]
async fn the_blobs_of_jobs_are_named() {
    let fixture = Fixture::new().await;
    let (mut job, other) = (fixture.insert().await, fixture.insert().await);
    job.id = fixture.ids.next();
    job.artifacts = vec![artifact(job.id)];
    fixture.store.insert(&job).await.unwrap();
    let keys = fixture.store.blob_keys(&[job.id, fixture.ids.next()]).await.unwrap();
    assert_eq!(keys, HashSet::from([job.input.key, artifact(job.id).key]));
    assert!(!keys.contains(&other.input.key));
}

#[tokio::test]
async fn an_unreadable_row_does_not_stop_the_queue() {
    let fixture = Fixture::new().await;
    let (broken, sound) = (fixture.insert().await, fixture.insert().await);
    let sql = "UPDATE jobs SET parameters = '{' WHERE id = (SELECT MIN(id) FROM jobs) RETURNING id";
    assert_eq!(fixture.ask(sql).await, broken.id.to_string());
    let error = fixture.store.claim(&Lease::new(), 2_000).await.unwrap_err();
    assert!(matches!(error, StoreError::Corrupt { column: "parameters", .. }), "{error}");
    assert_eq!(fixture.claim().await.0.id, sound.id);
    let counts = fixture.store.counts().await.unwrap();
    assert_eq!(counts, Counts { running: 1, failed: 1, ..Counts::default() });
}

#[tokio::test]
async fn an_unreadable_row_hides_no_other() {
    let fixture = Fixture::new().await;
    let (oldest, sound, newest) = (fixture.insert().await, fixture.insert().await, fixture.insert().await);
    let sql = "UPDATE jobs SET parameters = '{' WHERE id != (SELECT id FROM jobs ORDER BY id LIMIT 1 OFFSET 1) \
               RETURNING id";
    fixture.ask(sql).await;
    let store = &fixture.store;
    assert_eq!(store.newest().await.unwrap(), Some(newest.id), "ids go on from it");
    let list = async |before, limit| {
        let page = store.list(ListQuery { before, limit, ..ListQuery::default() }).await.unwrap();
        (page.jobs.iter().map(|job| job.id).collect::<Vec<_>>(), page.next)
    };
    assert_eq!(list(None, 10).await, (vec![sound.id], None));
    assert_eq!(list(None, 1).await, (vec![], Some(newest.id)));
    assert_eq!(list(Some(newest.id), 1).await, (vec![sound.id], Some(sound.id)));
    assert_eq!(list(Some(sound.id), 1).await, (vec![], None));
    assert!(store.dismiss(oldest.id, 2_000).await.unwrap() && store.delete(oldest.id).await.unwrap());
}

#[tokio::test]
async fn an_idempotency_key_belongs_to_one_job_as_long_as_that_is_kept() {
    let fixture = Fixture::new().await;
    let mut job = fixture.insert().await;
    let mut insert = async |key: &str| {
        job.id = fixture.ids.next();
        job.spec.idempotency = Some(Idempotency { key: key.to_owned(), fingerprint: "f".to_owned() });
        fixture.store.insert(&job).await.map(|()| job.clone())
    };
    let first = insert("a").await.unwrap();
    assert!(matches!(insert("a").await, Err(StoreError::KeyTaken)));
    insert("b").await.unwrap();
    fixture.insert().await;
    assert_eq!(fixture.store.by_key("a").await.unwrap(), Some(first.clone()));
    assert_eq!(fixture.store.by_key("c").await.unwrap(), None);
    fixture.store.dismiss(first.id, 2_000).await.unwrap();
    fixture.store.delete(first.id).await.unwrap();
    assert_eq!(fixture.store.by_key("a").await.unwrap(), None);
    insert("a").await.unwrap();
}
