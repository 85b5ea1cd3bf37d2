//! Connections to SQLite, and what its error codes mean.

use std::time::Duration;

use sqlx::AssertSqlSafe;
use sqlx::any::AnyPoolOptions;

use super::StoreError;

/// How long a statement waits for another process that holds SQLite's lock (a backup, say).
const BUSY: Duration = Duration::from_secs(10);

/// KiB of the database that a connection keeps, of SQLite's usual 2,000: the system keeps what is read often.
const CACHE: u32 = 512;

/// WAL lets readers work beside the writer; FULL makes a commit survive a power cut.
pub(super) fn sqlite_pool(connections: u32) -> AnyPoolOptions {
    AnyPoolOptions::new()
        .min_connections(connections)
        .max_connections(connections)
        .idle_timeout(None)
        .max_lifetime(None)
        .after_connect(|connection, _| {
            Box::pin(async move {
                // A purged row may have held a patient's name: its bytes are overwritten.
                let pragmas = format!(
                    "PRAGMA busy_timeout = {}; PRAGMA journal_mode = WAL; PRAGMA synchronous = FULL; \
                     PRAGMA secure_delete = ON; PRAGMA cache_size = -{CACHE};",
                    BUSY.as_millis()
                );
                sqlx::raw_sql(AssertSqlSafe(pragmas)).execute(connection).await?;
                Ok(())
            })
        })
}

/// SQLite's primary result codes of a disk or database that cannot be used now: SQLITE_BUSY, SQLITE_LOCKED,
/// SQLITE_READONLY, SQLITE_IOERR and SQLITE_CANTOPEN.
const UNAVAILABLE: [u32; 5] = [5, 6, 8, 10, 14];
/// SQLITE_FULL.
const FULL: u32 = 13;

impl From<sqlx::Error> for StoreError {
    /// Tells a full disk and a database that cannot be used now from other failures.
    fn from(error: sqlx::Error) -> Self {
        let code = error.as_database_error().and_then(|inner| inner.code()?.parse::<u32>().ok());
        // The low byte of an extended code is the primary one.
        match code.map(|code| code & 0xff) {
            Some(FULL) => StoreError::Full(error),
            Some(code) if UNAVAILABLE.contains(&code) => StoreError::Unavailable(error),
            _ if matches!(error, sqlx::Error::PoolTimedOut | sqlx::Error::Io(_)) => {
                StoreError::Unavailable(error)
            }
            _ => StoreError::Database(error),
        }
    }
}

/// Whether a row with the same unique value is there already.
pub(super) fn is_repeated(error: &sqlx::Error) -> bool {
    error.as_database_error().is_some_and(|inner| inner.is_unique_violation())
}
