//! The store's part in telling of jobs' ends. What is to be told is written by triggers (`0008_webhooks.sql`).

use futures::FutureExt;
use sqlx::Row;
use sqlx::any::AnyRow;

use super::row::Columns;
use super::sql::SqlStore;
use super::{DeliveryStore, StoreError, StoreFuture};
use crate::jobs::{Delivery, DeliveryCounts, JobStatus, LONGEST_WAIT, Lease, Listener, Told};

/// A delivery that is due further ahead than any waits, and an hour, was written before the clock was set back: it is due
/// now. Milliseconds.
const FURTHEST: i64 = (LONGEST_WAIT.as_millis() as i64) + 60 * 60 * 1000;

/// Why what waits for a target that is gone is given up.
const GONE: &str = "its target is no longer set";

/// The ends of jobs that a target hears of, as the trigger looks for them.
fn events(listener: &Listener) -> String {
    let ends: Vec<&str> = listener.ends.iter().map(|end| end.name()).collect();
    format!(",{},", ends.join(","))
}

impl SqlStore {
    /// Whether these targets are those of before, and nothing waits for another one.
    async fn hears(&self, listeners: &[Listener]) -> Result<bool, StoreError> {
        let orphans = "SELECT id FROM webhook_deliveries WHERE state = 'waiting' AND lease IS NULL \
                       AND target NOT IN (SELECT name FROM webhook_targets) LIMIT 1";
        if !self.rows(sqlx::query(orphans)).await?.is_empty() {
            return Ok(false);
        }
        let told = self.rows(sqlx::query("SELECT name, owner, events FROM webhook_targets")).await?;
        let mut known: Vec<(String, Option<String>, String)> = Vec::with_capacity(told.len());
        for row in &told {
            known.push((row.try_get("name")?, row.try_get("owner")?, row.try_get("events")?));
        }
        let mut wanted: Vec<_> =
            listeners.iter().map(|one| (one.name.clone(), one.owner.clone(), events(one))).collect();
        known.sort();
        wanted.sort();
        Ok(known == wanted)
    }
}

impl DeliveryStore for SqlStore {
    fn set_listeners<'a>(&'a self, listeners: &'a [Listener], now: i64) -> StoreFuture<'a, ()> {
        async move {
            // A full disk must not keep a service from starting whose targets are as they were.
            if self.hears(listeners).await? {
                return Ok(());
            }
            let mut transaction = self.begin().await?;
            sqlx::query("DELETE FROM webhook_targets").execute(&mut *transaction).await?;
            for listener in listeners {
                sqlx::query("INSERT INTO webhook_targets (name, owner, events) VALUES ($1, $2, $3)")
                    .bind(listener.name.clone())
                    .bind(listener.owner.clone())
                    .bind(events(listener))
                    .execute(&mut *transaction)
                    .await?;
            }
            let sql = "UPDATE webhook_deliveries SET state = 'dead', died = $1, lease = NULL, failure = $2 \
                       WHERE state = 'waiting' AND lease IS NULL AND target NOT IN (SELECT name FROM webhook_targets)";
            sqlx::query(sql).bind(now).bind(GONE).execute(&mut *transaction).await?;
            transaction.commit().await?;
            Ok(())
        }
        .boxed()
    }

    fn count_listeners(&self) -> StoreFuture<'_, u64> {
        async move {
            let rows = self.rows(sqlx::query("SELECT COUNT(*) AS targets FROM webhook_targets")).await?;
            let count: i64 = rows.first().map_or(Ok(0), |row| row.try_get("targets"))?;
            Ok(u64::try_from(count).unwrap_or(0))
        }
        .boxed()
    }

    fn release_deliveries(&self, now: i64) -> StoreFuture<'_, u64> {
        let sql = "UPDATE webhook_deliveries SET lease = NULL, due = $1 WHERE lease IS NOT NULL";
        async move { self.change(sqlx::query(sql).bind(now)).await }.boxed()
    }

    fn is_due<'a>(&'a self, listener: &'a str, now: i64) -> StoreFuture<'a, bool> {
        async move {
            let sql = "SELECT id FROM webhook_deliveries WHERE target = $1 AND state = 'waiting' \
                       AND (due <= $2 OR due > $3) LIMIT 1";
            let further = now.saturating_add(FURTHEST);
            Ok(!self.rows(sqlx::query(sql).bind(listener).bind(now).bind(further)).await?.is_empty())
        }
        .boxed()
    }

    fn claim_delivery<'a>(
        &'a self,
        listener: &'a str,
        lease: &'a Lease,
        now: i64,
        until: i64,
    ) -> StoreFuture<'a, Option<Delivery>> {
        async move {
            let sql = "UPDATE webhook_deliveries SET lease = $1, due = $2, attempts = attempts + 1 WHERE id = ( \
                       SELECT id FROM webhook_deliveries WHERE target = $3 AND state = 'waiting' \
                       AND (due <= $4 OR due > $5) ORDER BY due, id LIMIT 1) RETURNING *";
            let further = now.saturating_add(FURTHEST);
            let query = sqlx::query(sql).bind(lease.as_str()).bind(until).bind(listener).bind(now).bind(further);
            self.changed(query).await?.first().map(delivery).transpose()
        }
        .boxed()
    }

    fn settle_delivery<'a>(
        &'a self,
        id: &'a str,
        lease: &'a Lease,
        told: &'a Told,
        now: i64,
    ) -> StoreFuture<'a, bool> {
        async move {
            let statement = match told {
                Told::Yes => {
                    let sql = "DELETE FROM webhook_deliveries WHERE id = $1 AND lease = $2";
                    sqlx::query(sql).bind(id).bind(lease.as_str())
                }
                Told::Later { after, failure } => {
                    let sql = "UPDATE webhook_deliveries SET lease = NULL, due = $3, failure = $4, \
                               state = CASE WHEN target IN (SELECT name FROM webhook_targets) \
                               THEN 'waiting' ELSE 'dead' END, \
                               died = CASE WHEN target IN (SELECT name FROM webhook_targets) \
                               THEN NULL ELSE $5 END \
                               WHERE id = $1 AND lease = $2";
                    let due = now.saturating_add(*after);
                    let query = sqlx::query(sql).bind(id).bind(lease.as_str()).bind(due);
                    query.bind(failure.clone()).bind(now)
                }
                Told::Never { failure } => {
                    let sql = "UPDATE webhook_deliveries SET lease = NULL, state = 'dead', died = $3, failure = $4 \
                               WHERE id = $1 AND lease = $2";
                    sqlx::query(sql).bind(id).bind(lease.as_str()).bind(now).bind(failure.clone())
                }
            };
            Ok(self.change(statement).await? > 0)
        }
        .boxed()
    }

    fn dead<'a>(&'a self, before: Option<&'a str>, limit: u32) -> StoreFuture<'a, Vec<Delivery>> {
        async move {
            let sql = "SELECT * FROM webhook_deliveries WHERE state = 'dead' AND ($1 IS NULL OR (died, id) < ( \
                       SELECT last.died, last.id FROM webhook_deliveries AS last WHERE last.id = $1)) \
                       ORDER BY died DESC, id DESC LIMIT $2";
            let query = sqlx::query(sql).bind(before.map(str::to_owned)).bind(i64::from(limit));
            self.rows(query).await?.iter().map(delivery).collect()
        }
        .boxed()
    }

    fn revive<'a>(&'a self, id: &'a str, now: i64) -> StoreFuture<'a, bool> {
        let sql = "UPDATE webhook_deliveries SET state = 'waiting', attempts = 0, due = $2, died = NULL \
                   WHERE id = $1 AND state = 'dead' AND target IN (SELECT name FROM webhook_targets)";
        async move { Ok(self.change(sqlx::query(sql).bind(id).bind(now)).await? > 0) }.boxed()
    }

    fn forget_dead(&self, time: i64) -> StoreFuture<'_, u64> {
        let sql = "DELETE FROM webhook_deliveries WHERE state = 'dead' AND died <= $1";
        async move { self.change(sqlx::query(sql).bind(time)).await }.boxed()
    }

    fn count_deliveries(&self) -> StoreFuture<'_, DeliveryCounts> {
        async move {
            let sql = "SELECT state, COUNT(*) AS deliveries FROM webhook_deliveries GROUP BY state";
            let mut counts = DeliveryCounts::default();
            for row in self.rows(sqlx::query(sql)).await? {
                let (state, deliveries): (String, i64) = (row.try_get("state")?, row.try_get("deliveries")?);
                let slot = if state == "dead" { &mut counts.dead } else { &mut counts.waiting };
                *slot += u64::try_from(deliveries).unwrap_or(0);
            }
            Ok(counts)
        }
        .boxed()
    }
}

fn delivery(row: &AnyRow) -> Result<Delivery, StoreError> {
    let columns = Columns::of(row)?;
    let error = columns.optional_text("error")?;
    Ok(Delivery {
        id: columns.text("id")?,
        listener: columns.text("target")?,
        job: columns.parsed("job")?,
        status: columns.parsed::<JobStatus>("status")?,
        created: row.try_get("created")?,
        started: row.try_get("started")?,
        finished: row.try_get("finished")?,
        client_reference: columns.optional_text("client_reference")?,
        error: error.map(|text| columns.json("error", &text)).transpose()?,
        attempts: columns.number("attempts")?,
        failure: columns.optional_text("failure")?,
        died: row.try_get("died")?,
    })
}
