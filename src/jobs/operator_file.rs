//! A small file of the operator's, for its owner's eyes only: keys, webhook targets. Changed whole or not at all, by one
//! process at a time; a running service sees by its [`stamp`] when it, or a certificate, was changed.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::path::Path;
use std::time::SystemTime;

use super::faults::{Operation, between};

/// Waits until nobody else changes the file at `path`; held until it is dropped: of two changes none is lost.
///
/// # Errors
/// When the lock beside the file cannot be made.
pub fn lock(path: &Path) -> io::Result<File> {
    let lock = private().truncate(false).open(path.with_extension("lock"))?;
    lock.lock()?;
    Ok(lock)
}

/// Puts `text` in place of what the file holds, and sees that it stays so.
///
/// # Errors
/// When it cannot be written, synced or renamed; the file is as it was then, or whole.
pub fn replace(path: &Path, text: &[u8]) -> io::Result<()> {
    let temporary = path.with_extension("new");
    let mut file = private().truncate(true).open(&temporary)?;
    between(Operation::OperatorFileWrite, || file.write_all(text))?;
    between(Operation::OperatorFileSync, || file.sync_all())?;
    between(Operation::OperatorFileRename, || fs::rename(&temporary, path))?;
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    File::open(folder.unwrap_or(Path::new(".")))?.sync_all()
}

fn private() -> OpenOptions {
    let mut options = OpenOptions::new();
    options.write(true).create(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    options
}

/// Tells one state of a file from the next; `None`: it is not there.
pub type Stamp = Option<(SystemTime, u64, u64)>;

/// When the file was written, its length, and which file it is: one that is replaced whole is another one.
pub fn stamp(path: &Path) -> Stamp {
    let found = fs::metadata(path).ok()?;
    #[cfg(unix)]
    let file = std::os::unix::fs::MetadataExt::ino(&found);
    #[cfg(not(unix))]
    let file = 0;
    Some((found.modified().ok()?, found.len(), file))
}
