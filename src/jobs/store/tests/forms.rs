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
