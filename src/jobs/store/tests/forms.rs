//! Databases of other versions, and what is noted of a purge.

use sqlx::Connection;

use super::*;

#[tokio::test]
async fn a_database_of_every_released_form_is_brought_to_this_one() {
    use sqlx::migrate::Migrator;
    let fixture = Fixture::new().await;
    let all = sqlx::migrate!("src/jobs/store/migrations");
    assert!(all.migrations.len() >= 4);
    for released in 1..=all.migrations.len() {
        let form = Migrator { migrations: all.migrations[..released].to_vec().into(), ..Migrator::DEFAULT };
        let old = tempfile::tempdir().unwrap();
        let mut connection = sqlx::AnyConnection::connect(&url(&old)).await.unwrap();
        form.run(&mut connection).await.unwrap();
        let id = fixture.ids.next().to_string();
        let sql = "INSERT INTO jobs (id, status, progress, created, updated, input_key, input_size, input_sha256, units, \
                   parameters, artifacts, attempts) VALUES ($1, 'accepted', 0, 1, 1, 'k', 2, 'ab', 'mm', \
                   '{\"preset\":\"default\",\"values\":{}}', '[]', 0)";
        sqlx::query(sql).bind(&id).execute(&mut connection).await.unwrap();
        connection.close().await.unwrap();
        let store = SqlStore::open(&url(&old)).await.unwrap();
        let job = store.get(id.parse().unwrap()).await.unwrap().unwrap();
        let spec = &job.spec;
        assert_eq!((&spec.origin, &spec.idempotency), (&Origin::default(), &None), "form {released}");
        assert_eq!((job.input.size, job.purging), (2, None));
        let claimed = store.claim(&Lease::new(), 5).await.unwrap().unwrap();
        assert_eq!(claimed.id.to_string(), id);
        assert!(store.dismiss(job.id, 6).await.unwrap() && store.begin_purge(job.id, 7).await.unwrap());
    }
}

#[tokio::test]
async fn a_purge_is_noted_until_the_row_is_gone() {
    let fixture = Fixture::new().await;
    let job = fixture.insert().await;
    assert!(!fixture.store.begin_purge(job.id, 3_000).await.unwrap(), "an active job is not purged");
    fixture.store.dismiss(job.id, 2_000).await.unwrap();
    assert!(fixture.store.purging().await.unwrap().is_empty());
    assert!(fixture.store.begin_purge(job.id, 3_000).await.unwrap());
    assert!(fixture.store.begin_purge(job.id, 4_000).await.unwrap(), "again, after one that did not end");
    assert_eq!(fixture.get(job.id).await.purging, Some(3_000));
    assert_eq!(fixture.store.purging().await.unwrap(), [job.id]);
    fixture.store.delete(job.id).await.unwrap();
    assert!(fixture.store.purging().await.unwrap().is_empty());
}

#[tokio::test]
async fn other_databases_and_newer_ones_are_refused() {
    let error = SqlStore::open("mysql://localhost/x").await.err().unwrap();
    assert!(matches!(error, StoreError::Scheme { .. }), "{error}");
    let fixture = Fixture::new().await;
    let sql = "INSERT INTO _sqlx_migrations VALUES (9999, 'later', '2030-01-01', TRUE, x'00', 0) RETURNING description";
    assert_eq!(fixture.ask(sql).await, "later");
    let error = SqlStore::open(&url(&fixture.dir)).await.err().unwrap();
    assert!(
        matches!(error, StoreError::Migrate(_)) && error.to_string().contains("newer version"),
        "{error}"
    );
}

#[tokio::test]
async fn a_check_fails_when_the_database_is_locked_away() {
    let fixture = Fixture::new().await;
    fixture.store.check().await.unwrap();
    fixture.store.close().await;
    assert!(fixture.store.check().await.is_err());
}

#[tokio::test]
async fn urgent_jobs_go_first_and_pass_nobody_for_ever() {
    let fixture = Fixture::new().await;
    let clock = Arc::new(ManualClock::new(0));
    let ids = IdSource::new(clock.clone(), None);
    let insert = async |millis: i64, priority: Priority| {
        clock.set(millis);
        let id = ids.next();
        let input = StoredInput { key: "k".into(), size: 1, sha256: "00".into() };
        let job = Job::accepted(id, input, JobSpec { priority, ..JobSpec::default() }, millis);
        fixture.store.insert(&job).await.unwrap();
        id
    };
    let minute = 60_000;
    let old = insert(0, Priority::Normal).await;
    let first = insert(minute, Priority::Normal).await;
    let urgent = insert(2 * minute, Priority::Urgent).await;
    let second = insert(2 * minute, Priority::Urgent).await;
    // Eleven minutes after the oldest: it has waited long enough.
    let late = insert(11 * minute - 1, Priority::Urgent).await;
    let mut order = Vec::new();
    while let Some(job) = fixture.store.claim(&Lease::new(), 12 * minute).await.unwrap() {
        order.push(job.id);
    }
    assert_eq!(order, [urgent, second, old, late, first]);
}

#[tokio::test]
async fn a_retried_job_waits_as_at_first_and_alone_after_crashes() {
    let fixture = Fixture::new().await;
    let job = fixture.insert().await;
    assert!(!fixture.store.retry(job.id, 3_000).await.unwrap(), "it waits already");
    let (_, lease) = fixture.claim().await;
    let failure = JobFailure::new("code", 422, "title", "detail");
    assert!(fixture.store.fail(job.id, &lease, &failure, 2_500).await.unwrap());
    assert!(fixture.store.retry(job.id, 3_000).await.unwrap());
    let expected = Job { updated: 3_000, ..job.clone() };
    assert_eq!(fixture.get(job.id).await, expected, "as it was accepted");
    for _ in 0..5 {
        if fixture.store.claim(&Lease::new(), 2_000).await.unwrap().is_some() {
            fixture.store.recover(3, 2_500).await.unwrap();
        }
    }
    assert_eq!(fixture.get(job.id).await.status, JobStatus::Failed);
    assert!(fixture.store.retry(job.id, 4_000).await.unwrap());
    let (again, _) = fixture.claim().await;
    fixture.insert().await;
    assert!(again.attempts > 2, "{again:?}");
    assert_eq!(fixture.store.claim(&Lease::new(), 2_000).await.unwrap(), None, "beside no other");
}
