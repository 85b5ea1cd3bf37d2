//! A small file of the operator's, for its owner's eyes only: keys, webhook targets. Changed whole or not at all, by one
//! process at a time; a running service sees by its [`stamp`] when it, or a certificate, was changed.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::path::Path;

use super::faults::{Operation, between};
use super::stamp;

/// Waits until nobody else changes the file at `path`; held until it is dropped: of two changes none is lost.
///
/// # Errors
/// When the lock beside the file cannot be made.
pub fn lock(path: &Path) -> io::Result<File> {
    let lock = private().truncate(false).open(path.with_extension("lock"))?;
    keep_owner(&lock, path)?;
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
    keep_owner(&file, path)?;
    between(Operation::OperatorFileWrite, || file.write_all(text))?;
    between(Operation::OperatorFileSync, || file.sync_all())?;
    between(Operation::OperatorFileRename, || fs::rename(&temporary, path))?;
    File::open(folder(path))?.sync_all()
}

/// Reads the file whole, where it is a regular one that is no larger than an operator writes: at a pipe a reader would
/// wait for ever.
///
/// # Errors
/// When it is another or larger, or cannot be read.
pub fn read(path: &Path) -> io::Result<Vec<u8>> {
    const MOST: u64 = 16 << 20;
    let found = fs::metadata(path)?;
    if !found.is_file() {
        return Err(io::Error::new(io::ErrorKind::InvalidInput, "it is no regular file"));
    }
    if found.len() > MOST {
        let detail = format!("it has {} bytes, more than the {MOST} of the largest", found.len());
        return Err(io::Error::new(io::ErrorKind::FileTooLarge, detail));
    }
    fs::read(path)
}

/// Gives a file that root makes to who owns the one in whose place it comes, else the folder: the service that is to read
/// it runs as them.
fn keep_owner(file: &File, path: &Path) -> io::Result<()> {
    #[cfg(unix)]
    {
        use std::os::unix::fs::{MetadataExt, fchown};
        let own = file.metadata()?;
        let like = fs::metadata(path).or_else(|_| fs::metadata(folder(path)))?;
        if own.uid() == 0 && (like.uid(), like.gid()) != (0, own.gid()) {
            fchown(file, Some(like.uid()), Some(like.gid()))?;
        }
    }
    #[cfg(not(unix))]
    let _ = (file, path);
    Ok(())
}

fn folder(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

fn private() -> OpenOptions {
    let mut options = OpenOptions::new();
    options.write(true).create(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    options
}

/// What tells one state of a file from the next, a change of the right to read it among them; `None`: it is not there.
pub type Stamp = Option<stamp::Stamp>;

/// The file's stamp now. One that is replaced whole is another file.
pub fn stamp(path: &Path) -> Stamp {
    Some(stamp::Stamp::of(&fs::metadata(path).ok()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_regular_file_of_some_size_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("keys.json");
        assert_eq!(read(&path).unwrap_err().kind(), io::ErrorKind::NotFound);
        assert_eq!(read(folder.path()).unwrap_err().kind(), io::ErrorKind::InvalidInput);
        fs::write(&path, b"{}").unwrap();
        assert_eq!(read(&path).unwrap(), b"{}");
        File::options().write(true).open(&path).unwrap().set_len(17 << 20).unwrap();
        assert_eq!(read(&path).unwrap_err().kind(), io::ErrorKind::FileTooLarge);
    }

    #[cfg(unix)]
    #[test]
    fn what_root_changes_stays_the_services() {
        use std::os::unix::fs::{MetadataExt, chown};
        let folder = tempfile::tempdir().unwrap();
        if chown(folder.path(), Some(65534), Some(65534)).is_err() {
            eprintln!("skipped: only root may give a folder away");
            return;
        }
        let path = folder.path().join("keys.json");
        let owner = |path: &Path| (fs::metadata(path).unwrap().uid(), fs::metadata(path).unwrap().gid());
        replace(&path, b"{}").unwrap();
        assert_eq!(owner(&path), (65534, 65534));
        drop(lock(&path).unwrap());
        assert_eq!(owner(&path.with_extension("lock")), (65534, 65534));
        chown(&path, Some(65533), Some(65532)).unwrap();
        replace(&path, b"{}").unwrap();
        assert_eq!(owner(&path), (65533, 65532));
    }
}
