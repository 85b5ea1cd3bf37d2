//! The store on SQL through sqlx's `Any` driver.
//!
//! Statements keep to what SQLite and PostgreSQL share: `$N` binds, `RETURNING`, no upserts.

use std::collections::HashSet;

use futures::future::BoxFuture;
use futures::{FutureExt, TryStreamExt};
use sqlx::any::{AnyArguments, AnyRow};
use sqlx::query::Query;
use sqlx::{Any, AnyPool, AssertSqlSafe, Row, Transaction};

use super::connection::{is_repeated, sqlite_pool};
use super::row::{bigint, id, job, json};
use super::{JobStore, ListQuery, Page, Recovered, StoreError, StoreFuture, listing, turns};
use crate::jobs::{Counts, Job, JobFailure, JobId, JobStatus, Lease, StoredArtifact};

const READERS: u32 = 4;

/// Jobs in an SQL table.
pub struct SqlStore {
    readers: AnyPool,
    /// SQLite has one writer at a time: one connection queues writes fairly where locks would not.
    writer: AnyPool,
}

/// A statement with its binds.
pub(super) type Statement<'q> = Query<'q, Any, AnyArguments>;

impl SqlStore {
    /// Opens the database at `url` and brings its tables to this version's form.
    ///
    /// # Errors
    /// [`StoreError`] when it cannot be opened, or was written by a newer version.
    pub async fn open(url: &str) -> Result<Self, StoreError> {
        sqlx::any::install_default_drivers();
        let scheme = url.split(':').next().unwrap_or_default();
        if scheme != "sqlite" {
            return Err(StoreError::Scheme { scheme: scheme.to_owned() });
        }
        let writer = sqlite_pool(1).connect(url).await?;
        sqlx::migrate!("src/jobs/store/migrations").run(&writer).await?;
        let readers = sqlite_pool(READERS).connect(url).await?;
        Ok(Self { readers, writer })
    }

    #[cfg(test)]
    pub(super) fn pools(&self) -> [&AnyPool; 2] {
        [&self.readers, &self.writer]
    }

    /// Runs a change; the number of rows changed.
    pub(super) async fn change(&self, statement: Statement<'_>) -> Result<u64, StoreError> {
        Ok(statement.execute(&self.writer).await?.rows_affected())
    }

    /// Runs a change; the rows that it returns.
    pub(super) async fn changed(&self, statement: Statement<'_>) -> Result<Vec<AnyRow>, StoreError> {
        // All rows, so that the statement is stepped to its end and commits.
        Ok(statement.fetch_all(&self.writer).await?)
    }

    pub(super) async fn begin(&self) -> Result<Transaction<'static, Any>, StoreError> {
        Ok(self.writer.begin().await?)
    }

    pub(super) async fn rows(&self, statement: Statement<'_>) -> Result<Vec<AnyRow>, StoreError> {
        Ok(statement.fetch_all(&self.readers).await?)
    }

    /// Runs a change of one job that is in the right state; whether it was.
    async fn fenced(&self, statement: Statement<'_>) -> Result<bool, StoreError> {
        Ok(self.change(statement).await? > 0)
    }

    /// Fails the job under `lease`, of which no more is known.
    async fn fail_unreadable(&self, lease: &Lease, now: i64) -> Result<u64, StoreError> {
        let sql = "UPDATE jobs SET status = 'failed', error = $1, updated = $2, finished = $2, lease = NULL \
                   WHERE lease = $3 AND status = 'running'";
        let failure = json(&JobFailure::unreadable_row())?;
        self.change(sqlx::query(sql).bind(failure).bind(now).bind(lease.as_str())).await
    }
}

impl JobStore for SqlStore {
    fn insert<'a>(&'a self, job: &'a Job) -> StoreFuture<'a, ()> {
        async move {
            let sql = "INSERT INTO jobs (id, status, progress, stage, created, started, updated, finished, error, \
                       input_key, input_size, input_sha256, hint_extension, hint_content_type, name, units, parameters, artifacts, \
                       attempts, lease, request_id, client_reference, idempotency_key, idempotency_fingerprint, \
                       priority, turn, owner, traceparent) \
                       VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11, $12, $13, $14, $15, $16, $17, $18, $19, $20, \
                       $21, $22, $23, $24, $25, $26, $27, $28)";
            let error = job.error.as_ref().map(json).transpose()?;
            let statement = sqlx::query(sql)
                .bind(job.id.to_string())
                .bind(job.status.name())
                .bind(i64::from(job.progress))
                .bind(job.stage.clone())
                .bind(job.created)
                .bind(job.started)
                .bind(job.updated)
                .bind(job.finished)
                .bind(error)
                .bind(job.input.key.clone())
                .bind(bigint(job.input.size))
                .bind(job.input.sha256.clone())
                .bind(job.spec.hint.extension.clone())
                .bind(job.spec.hint.content_type.clone())
                .bind(job.spec.name.as_ref().map(|name| name.expose().to_owned()))
                .bind(job.spec.units.name())
                .bind(json(&job.spec.parameters)?)
                .bind(json(&job.artifacts)?)
                .bind(i64::from(job.attempts))
                .bind(job.lease.as_ref().map(|lease| lease.as_str().to_owned()))
                .bind(job.spec.origin.request_id.clone())
                .bind(job.spec.origin.client_reference.clone())
                .bind(job.spec.idempotency.as_ref().map(|request| request.key.clone()))
                .bind(job.spec.idempotency.as_ref().map(|request| request.fingerprint.clone()))
                .bind(job.spec.priority.name())
                .bind(job.spec.priority.turn(bigint(job.id.millis())))
                .bind(job.spec.owner.clone())
                .bind(job.spec.origin.traceparent.clone());
            self.change(statement).await.map_err(|error| match error {
                // Ids are made here and never repeat, so it is the key.
                StoreError::Database(error) if is_repeated(&error) => StoreError::KeyTaken,
                error => error,
            })?;
            Ok(())
        }
        .boxed()
    }

    fn get(&self, id: JobId) -> StoreFuture<'_, Option<Job>> {
        async move {
            let query = sqlx::query("SELECT * FROM jobs WHERE id = $1").bind(id.to_string());
            let row = query.fetch_optional(&self.readers).await?;
            row.as_ref().map(job).transpose()
        }
        .boxed()
    }

    fn by_key<'a>(&'a self, key: &'a str) -> StoreFuture<'a, Option<Job>> {
        async move {
            let query = sqlx::query("SELECT * FROM jobs WHERE idempotency_key = $1").bind(key);
            let row = query.fetch_optional(&self.readers).await?;
            row.as_ref().map(job).transpose()
        }
        .boxed()
    }

    fn list(&self, query: ListQuery) -> StoreFuture<'_, Page> {
        listing::list(query, &self.readers).boxed()
    }

    fn claim<'a>(&'a self, lease: &'a Lease, now: i64) -> StoreFuture<'a, Option<Job>> {
        async move {
            let rows = self.changed(sqlx::query(turns::CLAIM).bind(lease.as_str()).bind(now)).await?;
            let claimed = rows.first().map(job).transpose();
            if let Err(StoreError::Corrupt { .. }) = &claimed {
                self.fail_unreadable(lease, now).await?;
            }
            claimed
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
        let sql = "UPDATE jobs SET progress = $3, stage = $4, updated = $5 \
                   WHERE id = $1 AND lease = $2 AND status = 'running'";
        let statement = sqlx::query(sql)
            .bind(id.to_string())
            .bind(lease.as_str())
            .bind(i64::from(percent))
            .bind(stage)
            .bind(now);
        self.fenced(statement).boxed()
    }

    fn succeed<'a>(
        &'a self,
        id: JobId,
        lease: &'a Lease,
        artifacts: &'a [StoredArtifact],
        now: i64,
    ) -> StoreFuture<'a, bool> {
        async move {
            let sql = "UPDATE jobs SET status = 'successful', artifacts = $3, updated = $4, finished = $4, \
                       progress = 100, stage = NULL, lease = NULL \
                       WHERE id = $1 AND lease = $2 AND status = 'running'";
            let artifacts = json(&artifacts)?;
            let statement =
                sqlx::query(sql).bind(id.to_string()).bind(lease.as_str()).bind(artifacts).bind(now);
            self.fenced(statement).await
        }
        .boxed()
    }

    fn fail<'a>(
        &'a self,
        id: JobId,
        lease: &'a Lease,
        failure: &'a JobFailure,
        now: i64,
    ) -> StoreFuture<'a, bool> {
        async move {
            let sql = "UPDATE jobs SET status = 'failed', error = $3, updated = $4, finished = $4, lease = NULL \
                       WHERE id = $1 AND lease = $2 AND status = 'running'";
            let failure = json(failure)?;
            let statement = sqlx::query(sql).bind(id.to_string()).bind(lease.as_str()).bind(failure).bind(now);
            self.fenced(statement).await
        }
        .boxed()
    }

    fn release<'a>(&'a self, id: JobId, lease: &'a Lease, now: i64) -> StoreFuture<'a, bool> {
        let sql = "UPDATE jobs SET status = 'accepted', attempts = attempts - 1, updated = $3, progress = 0, \
                   stage = NULL, started = NULL, lease = NULL \
                   WHERE id = $1 AND lease = $2 AND status = 'running'";
        self.fenced(sqlx::query(sql).bind(id.to_string()).bind(lease.as_str()).bind(now)).boxed()
    }

    fn unclaim<'a>(&'a self, lease: &'a Lease, now: i64) -> StoreFuture<'a, bool> {
        let sql = "UPDATE jobs SET status = 'accepted', attempts = attempts - 1, updated = $2, progress = 0, \
                   stage = NULL, started = NULL, lease = NULL WHERE lease = $1 AND status = 'running'";
        self.fenced(sqlx::query(sql).bind(lease.as_str()).bind(now)).boxed()
    }

    fn retry(&self, id: JobId, now: i64) -> StoreFuture<'_, bool> {
        self.fenced(sqlx::query(turns::RETRY).bind(id.to_string()).bind(now)).boxed()
    }

    fn dismiss(&self, id: JobId, now: i64) -> StoreFuture<'_, bool> {
        let sql = "UPDATE jobs SET status = 'dismissed', updated = $2, finished = $2, lease = NULL \
                   WHERE id = $1 AND status IN ('accepted', 'running')";
        self.fenced(sqlx::query(sql).bind(id.to_string()).bind(now)).boxed()
    }

    fn begin_purge(&self, id: JobId, now: i64) -> StoreFuture<'_, bool> {
        let sql = "UPDATE jobs SET purging = COALESCE(purging, $2) \
                   WHERE id = $1 AND status NOT IN ('accepted', 'running')";
        self.fenced(sqlx::query(sql).bind(id.to_string()).bind(now)).boxed()
    }

    fn purging(&self) -> StoreFuture<'_, Vec<JobId>> {
        async move {
            let query = sqlx::query("SELECT id FROM jobs WHERE purging IS NOT NULL");
            Ok(query.fetch_all(&self.readers).await?.iter().filter_map(|row| id(row).ok()).collect())
        }
        .boxed()
    }

    fn delete(&self, id: JobId) -> StoreFuture<'_, bool> {
        let sql = "DELETE FROM jobs WHERE id = $1 AND status NOT IN ('accepted', 'running')";
        self.fenced(sqlx::query(sql).bind(id.to_string())).boxed()
    }

    fn recover(&self, max_crashes: u32, now: i64) -> StoreFuture<'_, Recovered> {
        async move {
            let failure = json(&JobFailure::crashed(max_crashes))?;
            let give_up = sqlx::query(turns::GIVE_UP).bind(failure).bind(now).bind(i64::from(max_crashes));
            // All or nothing: a start that dies here must not count a crash twice.
            let mut transaction = self.begin().await?;
            sqlx::query(turns::COUNT).execute(&mut *transaction).await?;
            let failed = give_up.execute(&mut *transaction).await?.rows_affected();
            let put_back = sqlx::query(turns::PUT_BACK).bind(now);
            let requeued = put_back.execute(&mut *transaction).await?.rows_affected();
            transaction.commit().await?;
            Ok(Recovered { requeued, failed })
        }
        .boxed()
    }

    fn counts(&self) -> StoreFuture<'_, Counts> {
        async move {
            let query = sqlx::query("SELECT status, COUNT(*) AS jobs FROM jobs GROUP BY status");
            let mut counts = Counts::default();
            for row in query.fetch_all(&self.readers).await? {
                let (status, jobs): (String, i64) = (row.try_get("status")?, row.try_get("jobs")?);
                let slot = match status.parse() {
                    Ok(JobStatus::Accepted) => &mut counts.accepted,
                    Ok(JobStatus::Running) => &mut counts.running,
                    Ok(JobStatus::Successful) => &mut counts.successful,
                    Ok(JobStatus::Failed) => &mut counts.failed,
                    Ok(JobStatus::Dismissed) => &mut counts.dismissed,
                    Err(_) => continue,
                };
                *slot = u64::try_from(jobs).unwrap_or(0);
            }
            Ok(counts)
        }
        .boxed()
    }

    fn waiting(&self) -> StoreFuture<'_, u64> {
        async move {
            let query = sqlx::query("SELECT COUNT(*) AS jobs FROM jobs WHERE status = 'accepted'");
            let jobs: i64 = query.fetch_one(&self.readers).await?.try_get("jobs")?;
            Ok(u64::try_from(jobs).unwrap_or(0))
        }
        .boxed()
    }

    fn oldest_waiting(&self) -> StoreFuture<'_, Option<i64>> {
        async move {
            let sql = "SELECT created FROM jobs WHERE status = 'accepted' ORDER BY id LIMIT 1";
            let rows = self.rows(sqlx::query(sql)).await?;
            rows.first().map(|row| row.try_get("created")).transpose().map_err(StoreError::from)
        }
        .boxed()
    }

    fn active_of<'a>(&'a self, owner: &'a str) -> StoreFuture<'a, u64> {
        async move {
            let sql =
                "SELECT COUNT(*) AS jobs FROM jobs WHERE owner = $1 AND status IN ('accepted', 'running')";
            let jobs: i64 = sqlx::query(sql).bind(owner).fetch_one(&self.readers).await?.try_get("jobs")?;
            Ok(u64::try_from(jobs).unwrap_or(0))
        }
        .boxed()
    }

    fn newest(&self) -> StoreFuture<'_, Option<JobId>> {
        async move {
            let mut rows = sqlx::query("SELECT id FROM jobs ORDER BY id DESC").fetch(&self.readers);
            while let Some(row) = rows.try_next().await? {
                if let Ok(id) = id(&row) {
                    return Ok(Some(id));
                }
            }
            Ok(None)
        }
        .boxed()
    }

    fn blob_keys<'a>(&'a self, ids: &'a [JobId]) -> StoreFuture<'a, HashSet<String>> {
        async move {
            let binds: Vec<String> = (1..=ids.len()).map(|place| format!("${place}")).collect();
            let sql = format!("SELECT * FROM jobs WHERE id IN ({})", binds.join(", "));
            // Safe: the text is made of `$N` alone.
            let mut query = sqlx::query(AssertSqlSafe(sql)).persistent(false);
            for id in ids {
                query = query.bind(id.to_string());
            }
            let mut keys = HashSet::new();
            for row in query.fetch_all(&self.readers).await? {
                let job = job(&row)?;
                keys.insert(job.input.key);
                keys.extend(job.artifacts.into_iter().map(|artifact| artifact.key));
            }
            Ok(keys)
        }
        .boxed()
    }

    fn check(&self) -> StoreFuture<'_, ()> {
        async move {
            // Takes the write lock and writes nothing.
            self.change(sqlx::query("DELETE FROM jobs WHERE id = ''")).await?;
            Ok(())
        }
        .boxed()
    }

    fn close(&self) -> BoxFuture<'_, ()> {
        async move {
            self.readers.close().await;
            self.writer.close().await;
        }
        .boxed()
    }
}
