//! The data folder: created on first start, locked to one process.

use std::fs::{self, File, OpenOptions, TryLockError};
use std::io;
use std::path::{Path, PathBuf};

/// Why the data folder cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum FolderError {
    #[error(
        "the data folder {path} is in use by another rosaline process; stop that one or choose another folder"
    )]
    InUse { path: String },
    #[error("the data folder {path} cannot be used: {source}; choose a folder that this user may write")]
    Io { path: String, source: io::Error },
}

/// An open data folder. Dropping it (or the death of the process) frees the lock.
#[derive(Debug)]
pub struct DataFolder {
    path: PathBuf,
    _lock: File,
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
        let lock = OpenOptions::new().create(true).truncate(false).write(true).open(path.join("lock"));
        let lock = lock.map_err(failed)?;
        match lock.try_lock() {
            Ok(()) => Ok(Self { path, _lock: lock }),
            Err(TryLockError::WouldBlock) => Err(FolderError::InUse { path: path.display().to_string() }),
            Err(TryLockError::Error(source)) => Err(failed(source)),
        }
    }

    pub fn database_url(&self) -> String {
        format!("sqlite://{}?mode=rwc", percent_encoded(&self.path.join("jobs.sqlite")))
    }

    pub fn blobs(&self) -> PathBuf {
        self.path.join("blobs")
    }
}

/// Creates `path`, readable by its owner only, and makes the new entries durable.
pub(super) fn create(path: &Path) -> io::Result<()> {
    let mut builder = fs::DirBuilder::new();
    builder.recursive(true);
    #[cfg(unix)]
    std::os::unix::fs::DirBuilderExt::mode(&mut builder, 0o700);
    let missing: Vec<&Path> = path.ancestors().take_while(|each| !each.exists()).collect();
    builder.create(path)?;
    for each in missing {
        let parent = each.parent().filter(|parent| !parent.as_os_str().is_empty());
        File::open(parent.unwrap_or(Path::new(".")))?.sync_all()?;
    }
    Ok(())
}

/// The path with everything that a URL reads as its own escaped.
fn percent_encoded(path: &Path) -> String {
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
        assert!(first.database_url().ends_with("a%20b%3F%23%25/data/jobs.sqlite?mode=rwc"));
        drop(first);
        DataFolder::open(&path).unwrap();
    }

    #[test]
    fn a_file_in_the_way_is_reported() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("data");
        fs::write(&path, b"").unwrap();
        assert!(matches!(DataFolder::open(&path), Err(FolderError::Io { .. })));
    }
}
