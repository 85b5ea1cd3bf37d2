//! Looks at a data folder without using it: for `rosaline doctor`, also while a service runs there.

use std::cmp::Ordering;
use std::fs::{self, File};
use std::io::{self, Write};
use std::path::Path;

use futures::TryStreamExt;
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use sqlx::{AnyConnection, AssertSqlSafe, Connection};

use super::StoredArtifact;
use super::clock::SILENCE;
pub use super::folder::is_in_use;
use super::folder::{lost_database, percent_encoded};
use super::fresh_file::FreshFile;

/// What was found, in words for the operator.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Finding {
    Well(String),
    /// Works, and should be known.
    Note(String),
    /// Does not work, or not for long: what it is, and what to do.
    Wrong(String, String),
}

impl Finding {
    pub fn wrong(what: impl Into<String>, todo: impl Into<String>) -> Self {
        Self::Wrong(what.into(), todo.into())
    }

    pub fn is_wrong(&self) -> bool {
        matches!(self, Finding::Wrong(..))
    }
}

/// Bytes that must fit: the reserve for a full disk, and a little.
pub const ROOM: usize = 4 << 20;

/// Whether a service could keep its files here: writes, syncs and renames work, and there is room.
///
/// What is written has a name of its own, which nobody can foresee, and is removed.
pub fn folder(path: &Path) -> Vec<Finding> {
    if !path.exists() {
        let parent = path.ancestors().skip(1).find(|each| each.as_os_str().is_empty() || each.exists());
        let parent = parent.filter(|each| !each.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let created = format!(
            "the data folder {} is not there; the first start creates it, unless --data should be another",
            path.display()
        );
        return vec![tried(parent, path).map_or_else(|wrong| wrong, |()| Finding::Note(created))];
    }
    if !path.is_dir() {
        let what = format!("{} is not a folder", path.display());
        return vec![Finding::wrong(what, "choose another folder with --data")];
    }
    let mut found = vec![match tried(path, path) {
        Ok(()) => {
            Finding::Well(format!("the data folder {}: writes, syncs and renames work", path.display()))
        }
        Err(wrong) => wrong,
    }];
    found.extend(secrecy(path, "the data folder", "700"));
    found
}

/// Tries in `place` what a service does in its folder; `named` is what the finding is about.
fn tried(place: &Path, named: &Path) -> Result<(), Finding> {
    try_files(place).map_err(|(step, error)| {
        let what = format!("the data folder {}: it {step}: {error}", named.display());
        Finding::wrong(
            what,
            match error.kind() {
                io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => "free space on its disk",
                io::ErrorKind::ReadOnlyFilesystem => "mount its disk for writing",
                io::ErrorKind::PermissionDenied => "give it to the user that runs the service",
                _ => "choose another folder with --data, or see to its disk",
            },
        )
    })
}

fn try_files(folder: &Path) -> Result<(), (&'static str, io::Error)> {
    let step = |name: &'static str| move |error| (name, error);
    let mut probe = FreshFile::create(folder, "doctor-", ".probe").map_err(step("cannot be written"))?;
    probe.file().write_all(&vec![0x5a; ROOM]).map_err(step("cannot be written"))?;
    probe.file().sync_all().map_err(step("cannot be synced"))?;
    let moved = probe.path().with_extension("moved");
    probe.rename(&moved).map_err(step("cannot rename files"))?;
    let kept = try_renamed(folder, &moved);
    fs::remove_file(&moved).ok();
    kept
}

fn try_renamed(folder: &Path, moved: &Path) -> Result<(), (&'static str, io::Error)> {
    let step = |name: &'static str| move |error| (name, error);
    File::open(folder).and_then(|folder| folder.sync_all()).map_err(step("cannot be synced"))?;
    let kept = fs::symlink_metadata(moved).map_err(step("loses files"))?.len();
    if kept == ROOM as u64 { Ok(()) } else { Err(("loses bytes", io::ErrorKind::UnexpectedEof.into())) }
}

/// Whether others than its owner may read it.
pub fn secrecy(path: &Path, what: &str, mode: &str) -> Option<Finding> {
    #[cfg(unix)]
    if let Ok(found) = fs::metadata(path)
        && std::os::unix::fs::MetadataExt::mode(&found) & 0o077 != 0
    {
        let open = format!("{what} {} can be read by other users of this machine", path.display());
        return Some(Finding::wrong(open, format!("chmod {mode} {}", path.display())));
    }
    #[cfg(not(unix))]
    let _ = (path, what, mode);
    None
}

/// Whether the database is whole, of a form that this version knows, and of this time. Reads only.
pub async fn database(path: &Path, now_ms: i64) -> Vec<Finding> {
    let file = path.join("jobs.sqlite");
    // A folder that cannot be read is told elsewhere.
    if let Ok(Some(error)) = lost_database(path) {
        return vec![Finding::wrong(error.to_string(), "the service does not start")];
    }
    if !file.exists() {
        return vec![Finding::Note("there is no job database yet; the first start creates it".to_owned())];
    }
    match examine(&file, now_ms).await {
        Ok(found) => found,
        Err(error) => {
            let what = format!("the job database {} cannot be read: {error}", file.display());
            vec![Finding::wrong(what, "put a copy back that was made while the service was stopped")]
        }
    }
}

/// Whether there are jobs that belong to somebody. Reads only.
///
/// # Errors
/// When the database cannot be read.
pub async fn has_owners(path: &Path) -> Result<bool, sqlx::Error> {
    let file = path.join("jobs.sqlite");
    if !file.exists() {
        return Ok(false);
    }
    let mut store = connected(&file).await?;
    // Before the first start has ended there is no table, and that of an old version has no owners.
    let column = "SELECT COUNT(*) FROM pragma_table_info('jobs') WHERE name = 'owner'";
    let mut count: i64 = sqlx::query_scalar(column).fetch_one(&mut store).await?;
    if count > 0 {
        let sql = "SELECT COUNT(*) FROM (SELECT 1 FROM jobs WHERE owner IS NOT NULL LIMIT 1) AS owned";
        count = sqlx::query_scalar(sql).fetch_one(&mut store).await?;
    }
    store.close().await?;
    Ok(count > 0)
}

async fn connected(file: &Path) -> Result<AnyConnection, sqlx::Error> {
    sqlx::any::install_default_drivers();
    // Without a log of changes nobody writes: no file is made beside the database to read it.
    let calm = !file.with_extension("sqlite-wal").exists();
    AnyConnection::connect(&format!("sqlite://{}?mode=ro&immutable={calm}", percent_encoded(file))).await
}

/// How far a job may be ahead of the clock.
const AHEAD_MS: i64 = 60 * 60 * 1000;

async fn examine(file: &Path, now_ms: i64) -> Result<Vec<Finding>, sqlx::Error> {
    let mut store = connected(file).await?;
    let integrity: String = sqlx::query_scalar("SELECT integrity_check FROM pragma_integrity_check LIMIT 1")
        .fetch_one(&mut store)
        .await?;
    let version: i64 = sqlx::query_scalar("SELECT COALESCE(MAX(version), 0) FROM _sqlx_migrations")
        .fetch_one(&mut store)
        .await?;
    let (jobs, newest): (i64, i64) =
        sqlx::query_as("SELECT COUNT(*), COALESCE(MAX(created), 0) FROM jobs").fetch_one(&mut store).await?;
    let known =
        sqlx::migrate!("src/jobs/store/migrations").iter().map(|each| each.version).max().unwrap_or(0);
    let results = if version == known { results(&mut store, file).await? } else { None };
    store.close().await?;
    let mut found = vec![wholeness(&integrity, jobs)];
    found.extend(results);
    found.push(form(version, known));
    found.extend(timeliness(newest, now_ms));
    Ok(found)
}

fn wholeness(integrity: &str, jobs: i64) -> Finding {
    // One line, whatever it lists.
    let integrity = integrity.split_whitespace().collect::<Vec<_>>().join(" ");
    match (integrity.as_str(), jobs) {
        ("ok", 1) => Finding::Well("the job database is whole: 1 job".to_owned()),
        ("ok", _) => Finding::Well(format!("the job database is whole: {jobs} jobs")),
        _ => Finding::wrong(
            format!("the job database is damaged: {integrity}"),
            "stop the service and put a copy back that was made while it was stopped",
        ),
    }
}

fn form(version: i64, known: i64) -> Finding {
    match version.cmp(&known) {
        Ordering::Equal => Finding::Well(format!("the job database has this version's form, {known}")),
        Ordering::Less => Finding::Note(format!(
            "the job database has the form {version}; the next start brings it to {known}, and older versions \
             cannot use it then: keep a copy"
        )),
        Ordering::Greater => Finding::wrong(
            format!("the job database has the form {version} of a newer version; this one knows {known}"),
            "install that version again, or use another data folder",
        ),
    }
}

/// What the newest job's time says of this machine's clock.
fn timeliness(newest: i64, now_ms: i64) -> Option<Finding> {
    if newest > now_ms.saturating_add(AHEAD_MS) {
        let hours = (newest - now_ms) / 3_600_000;
        return Some(Finding::wrong(
            format!("the newest job is {hours} hours ahead of this machine's clock"),
            "set the clock; jobs made meanwhile are kept longer than they should be",
        ));
    }
    let silent = now_ms.saturating_sub(newest);
    if newest > 0 && u128::try_from(silent).is_ok_and(|silent| silent > SILENCE.as_millis()) {
        let days = silent / 86_400_000;
        return Some(Finding::Note(format!(
            "by this machine's clock no job came for {days} days: for a day after the next start nothing is removed for its age"
        )));
    }
    None
}

/// Whether every result's file is there with its length; what is in them is looked at when they are asked for.
async fn results(store: &mut AnyConnection, database: &Path) -> Result<Option<Finding>, sqlx::Error> {
    const KEPT: &str = "status = 'successful' AND purging IS NULL";
    let blobs = database.with_file_name("blobs");
    let sql = format!("SELECT id, artifacts FROM jobs WHERE {KEPT}");
    let mut damaged = Vec::new();
    // Safe: the text has no part of a client's.
    let mut rows = sqlx::query_as::<_, (String, String)>(AssertSqlSafe(sql)).fetch(&mut *store);
    while let Some((id, artifacts)) = rows.try_next().await? {
        let artifacts: Vec<StoredArtifact> = serde_json::from_str(&artifacts).unwrap_or_default();
        let is_whole = |artifact: &StoredArtifact| {
            fs::metadata(blobs.join(&artifact.key)).is_ok_and(|file| file.len() == artifact.size)
        };
        if artifacts.is_empty() || !artifacts.iter().all(is_whole) {
            damaged.push(id);
        }
    }
    drop(rows);
    // A service may have purged some meanwhile.
    let mut first = None;
    let mut count = 0;
    for id in damaged {
        let sql = format!("SELECT COUNT(*) FROM jobs WHERE id = $1 AND {KEPT}");
        let still: i64 = sqlx::query_scalar(AssertSqlSafe(sql)).bind(&id).fetch_one(&mut *store).await?;
        if still > 0 {
            count += 1;
            first.get_or_insert(id);
        }
    }
    Ok(first.map(|id| match count {
        1 => Finding::wrong(
            format!("the results of job {id} are missing or have another length"),
            "put copies of their files back, or delete this job and have its mesh posted again",
        ),
        _ => Finding::wrong(
            format!("results of {count} jobs are missing or have another length, those of {id} first"),
            "put copies of their files back, or delete these jobs and have their meshes posted again",
        ),
    }))
}

/// Bytes that are free for this user on the disk of `path`, or of the folder that it would be made in.
pub fn free(path: &Path) -> io::Result<u64> {
    let place = path.ancestors().find(|each| each.exists()).unwrap_or(Path::new("."));
    let found = rustix::fs::statvfs(place)?;
    Ok(found.f_bavail * found.f_frsize)
}

/// How many files a process may have open where it [asks for them](raise_descriptors).
pub fn descriptors() -> u64 {
    getrlimit(Resource::Nofile).maximum.unwrap_or(u64::MAX)
}

/// Lets this process have as many files open as it may ask for: systemd and shells begin with 1024, whatever that is. How many
/// it may have open now, also where the system refuses that.
pub fn raise_descriptors() -> (u64, io::Result<()>) {
    let maximum = getrlimit(Resource::Nofile).maximum;
    let raised = setrlimit(Resource::Nofile, Rlimit { current: maximum, maximum });
    (getrlimit(Resource::Nofile).current.unwrap_or(u64::MAX), raised.map_err(io::Error::from))
}
