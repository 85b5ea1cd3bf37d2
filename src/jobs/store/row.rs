//! Between a [`Job`] and its row.

use sqlx::any::AnyRow;
use sqlx::{Any, ColumnIndex, Decode, Row, Type};

use super::{Page, StoreError};
use crate::jobs::{FileName, FormatHint, Idempotency, Job, JobId, JobSpec, Lease, Origin, StoredInput};

/// Reads `column` of `row`.
fn column<'r, T>(row: &'r AnyRow, column: &'static str) -> Result<T, StoreError>
where
    T: Decode<'r, Any> + Type<Any>,
    &'static str: ColumnIndex<AnyRow>,
{
    Ok(row.try_get(column)?)
}

/// A decoder of the columns of one job, for errors that say which.
pub(super) struct Columns<'r> {
    row: &'r AnyRow,
    id: String,
}

impl<'r> Columns<'r> {
    /// Of a row with an `id`.
    pub(super) fn of(row: &'r AnyRow) -> Result<Self, StoreError> {
        Ok(Self { row, id: column(row, "id")? })
    }

    fn corrupt(&self, column: &'static str, detail: impl ToString) -> StoreError {
        StoreError::Corrupt { id: self.id.clone(), column, detail: detail.to_string() }
    }

    pub(super) fn text(&self, name: &'static str) -> Result<String, StoreError> {
        column(self.row, name)
    }

    pub(super) fn optional_text(&self, name: &'static str) -> Result<Option<String>, StoreError> {
        column(self.row, name)
    }

    pub(super) fn parsed<T: std::str::FromStr<Err: ToString>>(
        &self,
        name: &'static str,
    ) -> Result<T, StoreError> {
        self.text(name)?.parse().map_err(|error: T::Err| self.corrupt(name, error.to_string()))
    }

    pub(super) fn json<T: serde::de::DeserializeOwned>(
        &self,
        name: &'static str,
        text: &str,
    ) -> Result<T, StoreError> {
        serde_json::from_str(text).map_err(|error| self.corrupt(name, error))
    }

    pub(super) fn number<T: TryFrom<i64, Error: ToString>>(
        &self,
        name: &'static str,
    ) -> Result<T, StoreError> {
        let value: i64 = column(self.row, name)?;
        T::try_from(value).map_err(|error| self.corrupt(name, error.to_string()))
    }
}

/// The id in `row`, whatever its other columns hold.
pub(super) fn id(row: &AnyRow) -> Result<JobId, StoreError> {
    Columns::of(row)?.parsed("id")
}

/// The job in `row`, which has every column of the table.
pub(super) fn job(row: &AnyRow) -> Result<Job, StoreError> {
    let columns = Columns::of(row)?;
    let error = match columns.optional_text("error")? {
        Some(text) => Some(columns.json("error", &text)?),
        None => None,
    };
    Ok(Job {
        id: columns.parsed::<JobId>("id")?,
        status: columns.parsed("status")?,
        progress: columns.number("progress")?,
        stage: columns.optional_text("stage")?,
        created: column(row, "created")?,
        started: column(row, "started")?,
        updated: column(row, "updated")?,
        finished: column(row, "finished")?,
        error,
        input: StoredInput {
            key: columns.text("input_key")?,
            size: columns.number("input_size")?,
            sha256: columns.text("input_sha256")?,
        },
        spec: JobSpec {
            hint: FormatHint {
                extension: columns.optional_text("hint_extension")?,
                content_type: columns.optional_text("hint_content_type")?,
            },
            name: columns.optional_text("name")?.map(FileName::new),
            units: columns.parsed("units")?,
            parameters: columns.json("parameters", &columns.text("parameters")?)?,
            origin: Origin {
                request_id: columns.optional_text("request_id")?,
                client_reference: columns.optional_text("client_reference")?,
                traceparent: columns.optional_text("traceparent")?,
            },
            idempotency: columns
                .optional_text("idempotency_key")?
                .zip(columns.optional_text("idempotency_fingerprint")?)
                .map(|(key, fingerprint)| Idempotency { key, fingerprint }),
            priority: columns.parsed("priority")?,
            owner: columns.optional_text("owner")?,
        },
        artifacts: columns.json("artifacts", &columns.text("artifacts")?)?,
        attempts: columns.number("attempts")?,
        lease: columns.optional_text("lease")?.map(Lease::from_stored),
        purging: column(row, "purging")?,
        input_removed: column(row, "input_removed")?,
    })
}

/// The rows that can be read; one that cannot must not hide its neighbours.
pub(super) fn page(rows: &[AnyRow], more: bool) -> Page {
    let readable = |row| job(row).inspect_err(|error| tracing::error!(%error, "left out of the list")).ok();
    let next = if more { rows.iter().rev().find_map(|row| id(row).ok()) } else { None };
    Page { jobs: rows.iter().filter_map(readable).collect(), next }
}

/// JSON for a TEXT column.
pub(super) fn json(value: &impl serde::Serialize) -> Result<String, StoreError> {
    serde_json::to_string(value).map_err(|error| StoreError::Database(sqlx::Error::Encode(error.into())))
}

/// A count or size for a BIGINT column.
pub(super) fn bigint(value: u64) -> i64 {
    i64::try_from(value).unwrap_or(i64::MAX)
}
