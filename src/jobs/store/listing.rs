//! Pages of jobs, newest first.

use sqlx::AnyPool;

use super::row::page;
use super::{ListQuery, Page, StoreError};
use crate::jobs::JobStatus;

/// `$1` is where the page begins, `$2` its size, `$3` the owner.
const ALL: &str = "SELECT * FROM jobs WHERE id < $1 AND ($3 IS NULL OR owner = $3) ORDER BY id DESC LIMIT $2";

/// In the state `$4`.
const IN_STATE: &str = "SELECT * FROM jobs WHERE id < $1 AND ($3 IS NULL OR owner = $3) AND status = $4 \
    ORDER BY id DESC LIMIT $2";

/// With their client's word `$5`, by an index of its own, and in the state `$4`.
pub(super) const OF_CLIENT: &str = "SELECT * FROM jobs WHERE client_reference = $5 AND id < $1 \
    AND ($3 IS NULL OR owner = $3) AND ($4 IS NULL OR status = $4) ORDER BY id DESC LIMIT $2";

pub(super) async fn list(query: ListQuery, readers: &AnyPool) -> Result<Page, StoreError> {
    // The text of every id sorts below "~".
    let before = query.before.map_or_else(|| "~".to_owned(), |id| id.to_string());
    let limit = query.limit.max(1);
    let of = |sql| sqlx::query(sql).bind(before).bind(i64::from(limit) + 1).bind(query.owner);
    let status = query.status.map(JobStatus::name);
    let statement = match (status, query.client_reference) {
        (None, None) => of(ALL),
        (Some(status), None) => of(IN_STATE).bind(status),
        (status, Some(word)) => of(OF_CLIENT).bind(status).bind(word),
    };
    let rows = statement.fetch_all(readers).await?;
    let limit = usize::try_from(limit).unwrap_or(usize::MAX);
    Ok(page(&rows[..limit.min(rows.len())], rows.len() > limit))
}
