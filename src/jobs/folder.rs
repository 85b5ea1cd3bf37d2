//! The data folder: created on first start, locked to one process.

use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{self, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use rustix::fs::OFlags;

use super::JobId;
use super::checkup::free;
use super::faults::{Operation, between};
use super::presence::{Anchor, Displaced};

/// Bytes kept free for changes of the database on a full disk: a start, a cancellation, a purge.
const RESERVE: usize = 1 << 20;
const DATABASE: &str = "jobs.sqlite";
const LOCK: &str = "lock";
const LOCK_TRIES: u32 = 5;
const LOCK_WAIT: Duration = Duration::from_millis(20);
const RESERVE_STEP: usize = 4 << 10;

/// Why the data folder cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum FolderError {
    #[error(
        "the data folder {path} is in use by another rosaline process; stop that one or choose another folder"
    )]
    InUse { path: String },
    #[error("the data folder {path} cannot be used: {source}; choose a folder that this user may write")]
    Io { path: String, source: io::Error },
    #[error("the data folder cannot be written: {0}; see to its disk and to who owns it")]
    Unwritable(io::Error),
    #[error("{} MiB are free on the data folder's disk and {} should be; free space on it", free >> 20, least >> 20)]
    NoRoom { free: u64, least: u64 },
    #[error(transparent)]
    Displaced(#[from] Displaced),
    #[error(
        "there are files of jobs in {blobs} and their database {database} is not there: it was moved or removed, or its disk \
         is not mounted; put the database back, or move {blobs} away to begin without these jobs, or choose another folder \
         with --data"
    )]
    NoDatabase { blobs: String, database: String },
}

/// An open data folder. Dropping it (or the death of the process) frees the lock.
#[derive(Debug)]
pub struct DataFolder {
    path: PathBuf,
    locks: Locks,
    /// What the service was started on, once that is there.
    anchors: Vec<Anchor>,
    /// Whether some of it was not in its place when that was last asked.
    is_away: AtomicBool,
}

/// The locks of a folder: on a file in it, and on the folder itself, which holds when somebody removes the file.
#[derive(Debug)]
struct Locks {
    _file: File,
    folder: Option<File>,
}

impl DataFolder {
    /// Creates the folder if it is missing and locks it.
    ///
    /// # Errors
    /// [`FolderError::InUse`] while another process holds it.
    pub fn open(path: &Path) -> Result<Self, FolderError> {
        let failed = |source| FolderError::Io { path: path.display().to_string(), source };
        create(path).map_err(failed)?;
        let path = fs::canonicalize(path).map_err(failed)?;
        match Locks::take(&path) {
            Ok(locks) => Ok(Self { path, locks, anchors: Vec::new(), is_away: AtomicBool::new(false) }),
            Err(TryLockError::WouldBlock) => Err(FolderError::InUse { path: path.display().to_string() }),
            Err(TryLockError::Error(source)) => Err(failed(source)),
        }
    }

    /// Sees that only its owner can read the database, which holds names: SQLite gives its log and its index the mode that
    /// the database has.
    ///
    /// # Errors
    /// When it cannot be made or written.
    pub(super) fn keep_database_private(&self) -> Result<(), FolderError> {
        let private = |name: &str| {
            let path = self.path.join(name);
            private(&path, name == DATABASE)
                .map_err(|source| FolderError::Io { path: path.display().to_string(), source })
        };
        [DATABASE, "jobs.sqlite-wal", "jobs.sqlite-shm"].into_iter().try_for_each(private)
    }

    /// Sees that there are no files of jobs whose database is not there: the next step would make an empty one, and then they
    /// would be files that no job owns.
    ///
    /// # Errors
    /// [`FolderError::NoDatabase`]
    pub(super) fn check_database(&self) -> Result<(), FolderError> {
        match lost_database(&self.path) {
            Ok(None) => Ok(()),
            Ok(Some(error)) => Err(error),
            Err(source) => Err(FolderError::Io { path: self.blobs().display().to_string(), source }),
        }
    }

    /// Notes what is in its place now: [`DataFolder::in_place`] says from then on whether it still is.
    pub(super) fn anchor(&mut self) -> Result<(), FolderError> {
        let (path, blobs) = (&self.path, self.blobs());
        let anchors = || {
            let mut anchors = vec![Anchor::folder("the data folder", path)?];
            // Only where it is all that keeps a second process out: else, who removes it does no harm.
            if self.locks.folder.is_none() {
                anchors.push(Anchor::file("the file 'lock' in the data folder", &path.join(LOCK))?);
            }
            anchors.push(Anchor::file("the job database", &path.join(DATABASE))?);
            anchors.push(Anchor::folder("the folder of meshes and results", &blobs)?);
            Ok(anchors)
        };
        let failed = |source| FolderError::Io { path: path.display().to_string(), source };
        self.anchors = anchors().map_err(failed)?;
        Ok(())
    }

    /// Fails while the folder, its database or its blobs are not those that the service was started on.
    ///
    /// Blocks.
    ///
    /// # Errors
    /// [`FolderError::Displaced`]; logged when it begins and ends.
    pub(super) fn in_place(&self) -> Result<(), FolderError> {
        let found = self.anchors.iter().try_for_each(Anchor::check);
        match (&found, self.is_away.swap(found.is_err(), Ordering::Relaxed)) {
            (Err(error), false) => tracing::error!(%error, "no job is taken, run or purged until then"),
            (Ok(()), true) => tracing::info!("the data folder is in its place again"),
            _ => {}
        }
        Ok(found?)
    }

    /// Whether files can be made here, and so many bytes are free for them.
    ///
    /// Blocks.
    pub(super) fn check(&self, least: u64) -> Result<(), FolderError> {
        self.in_place()?;
        try_write(&self.path.join("probe")).map_err(FolderError::Unwritable)?;
        let free = free(&self.path).map_err(FolderError::Unwritable)?;
        if free < least { Err(FolderError::NoRoom { free, least }) } else { Ok(()) }
    }

    /// Of a database that is there: one that is gone must not come again, empty, with the next connection.
    pub fn database_url(&self) -> String {
        format!("sqlite://{}?mode=rw", percent_encoded(&self.path.join(DATABASE)))
    }

    /// Gives the reserve back to the disk, so that a change of the database fits on a full one.
    pub(super) fn release_reserve(&self) {
        // Where there is none, or it stays, the change fails as it would have without.
        fs::remove_file(self.reserve()).ok();
    }

    /// Keeps some of the disk for [`DataFolder::release_reserve`]; of a full disk, what is left.
    ///
    /// Blocks.
    pub(super) fn keep_reserve(&self) {
        if self.in_place().is_err() {
            return;
        }
        let Ok(mut file) = own(OpenOptions::new().create(true).append(true)).open(self.reserve()) else {
            return;
        };
        let kept = file.metadata().map_or(0, |found| usize::try_from(found.len()).unwrap_or(RESERVE));
        let missing = incompressible(RESERVE.saturating_sub(kept));
        let mut write = || missing.chunks(RESERVE_STEP).try_for_each(|chunk| file.write_all(chunk));
        // A full disk ends this early: the next round goes on.
        if !missing.is_empty() && between(Operation::ReserveWrite, &mut write).is_ok() {
            file.sync_all().ok();
        }
    }

    fn reserve(&self) -> PathBuf {
        self.path.join("reserve")
    }

    pub fn blobs(&self) -> PathBuf {
        self.path.join("blobs")
    }
}

impl Locks {
    fn take(path: &Path) -> Result<Self, TryLockError> {
        let folder = File::open(path).map_err(TryLockError::Error)?;
        let folder = match patient_lock(&folder) {
            Ok(()) => Some(folder),
            Err(TryLockError::WouldBlock) => return Err(TryLockError::WouldBlock),
            // Not every file system locks folders (NFS does not).
            Err(TryLockError::Error(_)) => None,
        };
        let file = own(OpenOptions::new().create(true).truncate(false).write(true)).open(path.join(LOCK));
        let file = file.map_err(TryLockError::Error)?;
        patient_lock(&file)?;
        Ok(Self { _file: file, folder })
    }
}

/// Whether a service uses the folder now. Its locks are asked for and given back at once.
pub fn is_in_use(path: &Path) -> bool {
    let is_taken = |lock: &File| matches!(lock.try_lock(), Err(TryLockError::WouldBlock));
    let locks = [File::open(path), own(OpenOptions::new().write(true)).open(path.join(LOCK))];
    locks.iter().flatten().any(is_taken)
}

/// Whether a data folder has files of jobs and no database of them.
///
/// # Errors
/// When the folder cannot be read.
pub(super) fn lost_database(path: &Path) -> io::Result<Option<FolderError>> {
    let (blobs, database) = (path.join("blobs"), path.join(DATABASE));
    // An empty file is none: it is what a start makes first.
    let is_there = fs::metadata(&database).is_ok_and(|found| found.len() > 0);
    if is_there || !has_files_of_jobs(&blobs)? {
        return Ok(None);
    }
    let [blobs, database] = [blobs, database].map(|path| path.display().to_string());
    Ok(Some(FolderError::NoDatabase { blobs, database }))
}

/// Whether a start would take something in this folder for files of jobs.
fn has_files_of_jobs(blobs: &Path) -> io::Result<bool> {
    let entries = match fs::read_dir(blobs) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(false),
        entries => entries?,
    };
    for entry in entries {
        let entry = entry?;
        let is_of_job = entry.file_name().to_str().is_some_and(|name| name.parse::<JobId>().is_ok());
        if is_of_job && entry.file_type()?.is_dir() && fs::read_dir(entry.path())?.next().is_some() {
            return Ok(true);
        }
    }
    Ok(false)
}

/// Whether a file can be made and written here; it is removed again.
///
/// Blocks.
pub(super) fn try_write(probe: &Path) -> io::Result<()> {
    let file = own(OpenOptions::new().create(true).truncate(true).write(true)).open(probe);
    let written = file.and_then(|mut file| file.write_all(b"rosaline"));
    fs::remove_file(probe).ok();
    written
}

/// For a file of the service's own: a link in its place, which another user may have put there, is not followed, and a pipe
/// not waited for.
fn own(options: &mut OpenOptions) -> &mut OpenOptions {
    options.custom_flags((OFlags::NOFOLLOW | OFlags::NONBLOCK).bits().cast_signed())
}

/// Takes the lock; one that is taken is asked for a few times, as a look at it (`rosaline doctor`) takes it too.
fn patient_lock(lock: &File) -> Result<(), TryLockError> {
    for _ in 0..LOCK_TRIES {
        match lock.try_lock() {
            Err(TryLockError::WouldBlock) => std::thread::sleep(LOCK_WAIT),
            other => return other,
        }
    }
    lock.try_lock()
}

/// Bytes that no file system stores in less.
fn incompressible(length: usize) -> Vec<u8> {
    let mut state = 1_u64;
    let next = |_| {
        // Knuth's MMIX generator; its high bits are the good ones.
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 56) as u8
    };
    (0..length).map(next).collect()
}

/// From now on whatever this process and its children make is for their user alone, whatever that user's umask is: meshes
/// and results may be patient data.
pub fn keep_files_to_owner() {
    rustix::process::umask(rustix::fs::Mode::RWXG | rustix::fs::Mode::RWXO);
}

/// Takes a file away from all but its owner; one that is not there is made where `made`.
fn private(path: &Path, made: bool) -> io::Result<()> {
    let mut options = OpenOptions::new();
    options.append(true).create(made);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    let file = match options.open(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound && !made => return Ok(()),
        opened => opened?,
    };
    #[cfg(unix)]
    if std::os::unix::fs::MetadataExt::mode(&file.metadata()?) & 0o077 != 0
        && let Err(error) = file.set_permissions(std::os::unix::fs::PermissionsExt::from_mode(0o600))
    {
        // It may be another user's that this one may write; that is no reason not to start.
        tracing::warn!(%error, path = %path.display(), "others may read the database");
    }
    Ok(())
}

/// Creates `path`, readable by its owner only, and makes the new entries durable.
pub(super) fn create(path: &Path) -> io::Result<()> {
    let mut builder = fs::DirBuilder::new();
    builder.recursive(true);
    #[cfg(unix)]
    std::os::unix::fs::DirBuilderExt::mode(&mut builder, 0o700);
    let missing: Vec<&Path> = path.ancestors().take_while(|each| !each.exists()).collect();
    between(Operation::FolderCreate, || builder.create(path))?;
    for each in missing {
        let parent = each.parent().filter(|parent| !parent.as_os_str().is_empty());
        File::open(parent.unwrap_or(Path::new(".")))?.sync_all()?;
    }
    Ok(())
}

/// The path with everything that a URL reads as its own escaped.
pub(super) fn percent_encoded(path: &Path) -> String {
    let mut text = String::new();
    for byte in path.as_os_str().as_encoded_bytes() {
        match byte {
            b'/' | b'.' | b'-' | b'_' | b'~' => text.push(char::from(*byte)),
            _ if byte.is_ascii_alphanumeric() => text.push(char::from(*byte)),
            _ => text.push_str(&format!("%{byte:02X}")),
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_second_process_is_refused_until_the_first_ends() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a b?#%/data");
        let first = DataFolder::open(&path).unwrap();
        let error = DataFolder::open(&path).unwrap_err();
        assert!(
            matches!(error, FolderError::InUse { .. })
                && error.to_string().contains("another rosaline process")
        );
        assert!(first.database_url().ends_with("a%20b%3F%23%25/data/jobs.sqlite?mode=rw"));
        // As who finds the file left over would do.
        fs::remove_file(path.join(LOCK)).unwrap();
        assert!(matches!(DataFolder::open(&path), Err(FolderError::InUse { .. })) && is_in_use(&path));
        drop(first);
        let second = DataFolder::open(&path).unwrap();
        second.keep_reserve();
        assert_eq!(fs::metadata(path.join("reserve")).unwrap().len(), 1 << 20);
        second.release_reserve();
        assert!(!path.join("reserve").exists());
        second.check(1).unwrap();
        assert!(matches!(second.check(u64::MAX), Err(FolderError::NoRoom { .. })));
        assert!(!path.join("probe").exists());
    }

    #[test]
    fn a_file_in_the_way_is_reported() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("data");
        fs::write(&path, b"").unwrap();
        assert!(matches!(DataFolder::open(&path), Err(FolderError::Io { .. })));
    }
}
