//! Whether the folders and the database are still those that the service was started on. Who moves, replaces or unmounts them
//! while it runs would else get jobs accepted into whatever is in their place.

use std::fs::{self, File, Metadata};
use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::worker::Shared;
use super::{DataFolder, JobError};

/// What the service was started on is not in its place.
#[derive(Debug, thiserror::Error)]
pub enum Displaced {
    #[error(
        "{0} of this service is no longer in its place; put it back or mount its disk again, or stop the service and \
         start it where it is now"
    )]
    Gone(&'static str),
    #[error(
        "another one is in the place of {0} that the service was started on; put the former back, or stop the service and \
         start it on the right one"
    )]
    Replaced(&'static str),
    #[error("whether {what} is in its place cannot be seen: {source}; see to its disk and to who owns it")]
    Unseen { what: &'static str, source: io::Error },
}

/// A file or folder as it was at the start.
#[derive(Debug)]
pub(super) struct Anchor {
    what: &'static str,
    path: PathBuf,
    /// Device and inode.
    was: (u64, u64),
    _open: Option<File>,
}

impl Anchor {
    /// A folder; it is kept open, so that no other one gets the number of its inode.
    pub(super) fn folder(what: &'static str, path: &Path) -> io::Result<Self> {
        let open = File::open(path)?;
        let was = identity(&open.metadata()?);
        Ok(Self { what, path: path.to_owned(), was, _open: Some(open) })
    }

    /// A file that somebody else keeps open. (Not opened here: a database's locks end when a descriptor of it is closed.)
    pub(super) fn file(what: &'static str, path: &Path) -> io::Result<Self> {
        Ok(Self { what, path: path.to_owned(), was: identity(&fs::metadata(path)?), _open: None })
    }

    /// Whether it is at its path.
    ///
    /// Blocks.
    pub(super) fn check(&self) -> Result<(), Displaced> {
        match fs::metadata(&self.path) {
            Ok(found) if identity(&found) == self.was => Ok(()),
            Ok(_) => Err(Displaced::Replaced(self.what)),
            Err(error) if matches!(error.kind(), io::ErrorKind::NotFound | io::ErrorKind::NotADirectory) => {
                Err(Displaced::Gone(self.what))
            }
            Err(source) => Err(Displaced::Unseen { what: self.what, source }),
        }
    }
}

fn identity(found: &Metadata) -> (u64, u64) {
    (found.dev(), found.ino())
}

impl Shared {
    /// Fails while what the service was started on is not in its place: before something is promised that only its disk
    /// can keep.
    ///
    /// # Errors
    /// [`super::FolderError::Displaced`].
    pub(super) async fn in_place(self: &Arc<Self>) -> Result<(), JobError> {
        let shared = self.clone();
        let check = move || shared.folder.as_ref().map_or(Ok(()), DataFolder::in_place);
        Ok(tokio::task::spawn_blocking(check).await??)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_moved_or_replaced_is_told_until_it_is_back() {
        let dir = tempfile::tempdir().unwrap();
        let (path, away) = (dir.path().join("blobs"), dir.path().join("away"));
        fs::create_dir(&path).unwrap();
        let anchor = Anchor::folder("the folder", &path).unwrap();
        anchor.check().unwrap();
        fs::rename(&path, &away).unwrap();
        assert!(matches!(anchor.check(), Err(Displaced::Gone(_))));
        fs::create_dir(&path).unwrap();
        assert!(matches!(anchor.check(), Err(Displaced::Replaced(_))));
        fs::remove_dir(&path).unwrap();
        fs::rename(&away, &path).unwrap();
        anchor.check().unwrap();
        // A number that is free again goes to the next one on most file systems.
        fs::remove_dir(&path).unwrap();
        fs::create_dir(&path).unwrap();
        assert!(matches!(anchor.check(), Err(Displaced::Replaced(_))));
    }
}
