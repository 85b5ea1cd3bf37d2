//! The store's part in retention.

use sqlx::Row;
use sqlx::any::AnyRow;

use super::row::id;
use super::sql::SqlStore;
use super::{RetentionStore, StoreError, StoreFuture};
use crate::jobs::JobId;
use futures::FutureExt;

impl RetentionStore for SqlStore {
    fn newest_created(&self) -> StoreFuture<'_, Option<i64>> {
        async move {
            let rows = self.rows(sqlx::query("SELECT MAX(created) AS newest FROM jobs")).await?;
            Ok(rows.first().map(|row| row.try_get("newest")).transpose()?.flatten())
        }
        .boxed()
    }

    fn ended_before(&self, time: i64, limit: u32) -> StoreFuture<'_, Vec<JobId>> {
        async move {
            let sql = "SELECT id FROM jobs WHERE finished <= $1 AND status NOT IN ('accepted', 'running') \
                       ORDER BY finished LIMIT $2";
            let rows = self.rows(sqlx::query(sql).bind(time).bind(i64::from(limit))).await?;
            Ok(rows.iter().filter_map(|row| id(row).ok()).collect())
        }
        .boxed()
    }

    fn inputs_before(&self, time: i64, limit: u32) -> StoreFuture<'_, Vec<(JobId, String)>> {
        async move {
            let sql = "SELECT id, input_key FROM jobs WHERE finished <= $1 AND input_removed IS NULL \
                       AND purging IS NULL AND status NOT IN ('accepted', 'running') ORDER BY finished LIMIT $2";
            let rows = self.rows(sqlx::query(sql).bind(time).bind(i64::from(limit))).await?;
            let read = |row: &AnyRow| Some((id(row).ok()?, row.try_get("input_key").ok()?));
            Ok(rows.iter().filter_map(read).collect())
        }
        .boxed()
    }

    fn input_removed(&self, id: JobId, now: i64) -> StoreFuture<'_, ()> {
        async move {
            let sql = "UPDATE jobs SET input_removed = $2 WHERE id = $1";
            self.change(sqlx::query(sql).bind(id.to_string()).bind(now)).await?;
            Ok(())
        }
        .boxed()
    }

    fn note_expired(&self, id: JobId, now: i64) -> StoreFuture<'_, ()> {
        async move {
            let sql = "INSERT INTO expired (id, owner, at) SELECT id, owner, $2 FROM jobs WHERE id = $1 \
                       AND NOT EXISTS (SELECT 1 FROM expired AS other WHERE other.id = $1)";
            self.change(sqlx::query(sql).bind(id.to_string()).bind(now)).await?;
            Ok(())
        }
        .boxed()
    }

    fn expired(&self, id: JobId) -> StoreFuture<'_, Option<Option<String>>> {
        async move {
            let rows = self
                .rows(sqlx::query("SELECT owner FROM expired WHERE id = $1").bind(id.to_string()))
                .await?;
            rows.first().map(|row| row.try_get("owner")).transpose().map_err(StoreError::from)
        }
        .boxed()
    }

    fn ended_by(&self, now: i64) -> StoreFuture<'_, ()> {
        async move {
            self.change(sqlx::query("UPDATE jobs SET finished = $1 WHERE finished > $1").bind(now)).await?;
            Ok(())
        }
        .boxed()
    }

    fn forget_expired(&self, time: i64) -> StoreFuture<'_, ()> {
        async move {
            self.change(sqlx::query("DELETE FROM expired WHERE at <= $1").bind(time)).await?;
            // What was purged, a patient's name perhaps, is overwritten in the database, and still stands in the
            // write-ahead log: it is emptied, or with the next round where somebody reads meanwhile.
            self.change(sqlx::query("PRAGMA wal_checkpoint(TRUNCATE)")).await?;
            Ok(())
        }
        .boxed()
    }
}
