//! A small file of the operator's, for its owner's eyes only: keys, webhook targets. Changed whole or not at all, by one
//! process at a time; a running service sees by its [`stamp`] when it, or a certificate, was changed.
//!
//! Root changes such files in folders of other users, who may have put anything there: no link of theirs is followed, and
//! nothing is given to them that was not made here.

use std::ffi::OsStr;
use std::fs::{self, File, OpenOptions};
use std::io::{self, Read, Write};
use std::os::unix::fs::{MetadataExt, OpenOptionsExt, fchown};
use std::path::{Path, PathBuf};

use rustix::fs::OFlags;

use super::faults::{Operation, between};
use super::fresh_file::FreshFile;
use super::stamp;

/// A file that nobody else changes as long as this lives: of two changes none is lost.
#[derive(Debug)]
pub struct Change {
    /// Where the file is, behind the links to it.
    path: PathBuf,
    _lock: File,
}

impl Change {
    /// Waits until nobody else changes the file at `path`, or that to which it leads.
    ///
    /// # Errors
    /// When `path` is a link that leads nowhere or is another user's, or the lock beside the file cannot be made.
    pub fn begin(path: &Path) -> io::Result<Self> {
        let path = resolved(path)?;
        let lock = lock_file(&path)?;
        lock.lock()?;
        Ok(Self { path, _lock: lock })
    }

    /// What is in the file.
    ///
    /// # Errors
    /// Those of [`read`], and when a link has come in its place.
    pub fn read(&self) -> io::Result<Vec<u8>> {
        read_open(open(OpenOptions::new().read(true), &self.path)?)
    }

    /// Puts `text` in place of what the file holds, and sees that it stays so.
    ///
    /// # Errors
    /// When it cannot be written, synced or renamed; the file is as it was then, or whole.
    pub fn replace(&self, text: &[u8]) -> io::Result<()> {
        let folder = folder(&self.path);
        remove_unfinished(folder, &self.path);
        // Removed again unless it gets its name.
        let mut new = FreshFile::create(folder, &prefix(&self.path), UNFINISHED)?;
        keep_owner(new.file(), &self.path)?;
        between(Operation::OperatorFileWrite, || new.file().write_all(text))?;
        between(Operation::OperatorFileSync, || new.file().sync_all())?;
        between(Operation::OperatorFileRename, || new.rename(&self.path))?;
        File::open(folder)?.sync_all()
    }
}

/// The end of the name of a file that is being written.
const UNFINISHED: &str = ".new";

/// The start of the names of what is made beside a file.
fn prefix(path: &Path) -> String {
    format!("{}.", path.file_stem().unwrap_or(OsStr::new("file")).to_string_lossy())
}

/// Removes what a process that died while it wrote has left. Nobody else writes: the lock is held.
fn remove_unfinished(folder: &Path, path: &Path) {
    let prefix = prefix(path);
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let name = entry.file_name();
        let random = name.to_str().and_then(|name| name.strip_prefix(&prefix)?.strip_suffix(UNFINISHED));
        if random.is_some_and(FreshFile::is_random) {
            // The next change tries again.
            fs::remove_file(entry.path()).ok();
        }
    }
}

/// How many links one after the other are followed, as by the system.
const MOST_LINKS: usize = 40;

/// Where a link to a file leads, by way of links of this user's or root's only; another path as it is.
fn resolved(path: &Path) -> io::Result<PathBuf> {
    let refused = |detail: String| Err(io::Error::new(io::ErrorKind::InvalidInput, detail));
    let trusted = [0, rustix::process::geteuid().as_raw()];
    let mut place = path.to_owned();
    for followed in 0..MOST_LINKS {
        match fs::symlink_metadata(&place) {
            Ok(found) if !found.is_symlink() => return Ok(place),
            Ok(found) if !trusted.contains(&found.uid()) => {
                return refused(format!(
                    "it is a symbolic link of user {}; give the path of the file itself",
                    found.uid()
                ));
            }
            Ok(_) => place = folder(&place).join(fs::read_link(&place)?),
            Err(_) if followed == 0 => return Ok(place),
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                return refused("it is a symbolic link that leads nowhere; mend it, or remove it".to_owned());
            }
            Err(error) => return Err(error),
        }
    }
    refused(format!("it is a symbolic link to more than {MOST_LINKS} others; mend it, or remove it"))
}

/// The lock beside the file, made where there is none.
fn lock_file(path: &Path) -> io::Result<File> {
    let lock = path.with_extension("lock");
    let refused = |why: &str| {
        let detail = format!("its lock {} is {why}; remove that", lock.display());
        Err(io::Error::new(io::ErrorKind::InvalidInput, detail))
    };
    let found = match open(OpenOptions::new().write(true), &lock) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            match open(OpenOptions::new().write(true).create_new(true).mode(0o600), &lock) {
                Ok(made) => {
                    keep_owner(&made, path)?;
                    return Ok(made);
                }
                // Another one was quicker.
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {
                    open(OpenOptions::new().write(true), &lock)
                }
                Err(error) => Err(error),
            }
        }
        found => found,
    };
    match found {
        Ok(found) if found.metadata()?.is_file() => Ok(found),
        Ok(_) => refused("no regular file"),
        Err(_) if lock.is_symlink() => refused("a symbolic link"),
        Err(_) if fs::symlink_metadata(&lock).is_ok_and(|found| !found.is_file()) => {
            refused("no regular file")
        }
        Err(error) => Err(error),
    }
}

/// Opens the file itself: no link is followed, and a pipe not waited for.
fn open(options: &mut OpenOptions, path: &Path) -> io::Result<File> {
    options.custom_flags((OFlags::NOFOLLOW | OFlags::NONBLOCK).bits().cast_signed()).open(path)
}

/// Reads the file whole, where it is a regular one that is no larger than an operator writes: at a pipe a reader would
/// wait for ever.
///
/// # Errors
/// When it is another or larger, or cannot be read.
pub fn read(path: &Path) -> io::Result<Vec<u8>> {
    // Before it is opened: to open some devices does something.
    if !fs::metadata(path)?.is_file() {
        return Err(no_file());
    }
    read_open(OpenOptions::new().read(true).custom_flags(OFlags::NONBLOCK.bits().cast_signed()).open(path)?)
}

fn no_file() -> io::Error {
    io::Error::new(io::ErrorKind::InvalidInput, "it is no regular file")
}

fn read_open(mut file: File) -> io::Result<Vec<u8>> {
    const MOST: u64 = 16 << 20;
    let found = file.metadata()?;
    if !found.is_file() {
        return Err(no_file());
    }
    if found.len() > MOST {
        let detail = format!("it has {} bytes, more than the {MOST} of the largest", found.len());
        return Err(io::Error::new(io::ErrorKind::FileTooLarge, detail));
    }
    let mut bytes = Vec::new();
    file.read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// Gives a file that root has just made to who owns the one in whose place it comes, else the folder: the service that is to
/// read it runs as them.
fn keep_owner(made: &File, path: &Path) -> io::Result<()> {
    let own = made.metadata()?;
    let like = fs::symlink_metadata(path).or_else(|_| fs::metadata(folder(path)))?;
    if own.uid() == 0 && (like.uid(), like.gid()) != (0, own.gid()) {
        fchown(made, Some(like.uid()), Some(like.gid()))?;
    }
    Ok(())
}

fn folder(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
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

    /// The file as it is changed by the command line.
    fn changed(path: &Path, text: &[u8]) -> io::Result<()> {
        Change::begin(path)?.replace(text)
    }

    #[test]
    fn what_root_changes_stays_the_services() {
        use std::os::unix::fs::chown;
        let folder = tempfile::tempdir().unwrap();
        if chown(folder.path(), Some(65534), Some(65534)).is_err() {
            eprintln!("skipped: only root may give a folder away");
            return;
        }
        let path = folder.path().join("keys.json");
        let owner = |path: &Path| (fs::metadata(path).unwrap().uid(), fs::metadata(path).unwrap().gid());
        changed(&path, b"{}").unwrap();
        assert_eq!(owner(&path), (65534, 65534));
        assert_eq!(owner(&path.with_extension("lock")), (65534, 65534));
        chown(&path, Some(65533), Some(65532)).unwrap();
        changed(&path, b"{}").unwrap();
        assert_eq!(owner(&path), (65533, 65532));
        // What was there before is nobody's to give away.
        chown(path.with_extension("lock"), Some(0), Some(0)).unwrap();
        changed(&path, b"{}").unwrap();
        assert_eq!(owner(&path.with_extension("lock")), (0, 0));
    }

    #[test]
    fn no_link_beside_the_file_is_followed() {
        use std::os::unix::fs::symlink;
        let folder = tempfile::tempdir().unwrap();
        let (path, victim) = (folder.path().join("keys.json"), folder.path().join("victim"));
        fs::write(&victim, "of somebody else").unwrap();
        symlink(&victim, path.with_extension("new")).unwrap();
        let unfinished = path.with_extension("0123456789abcdef.new");
        symlink(&victim, &unfinished).unwrap();
        changed(&path, b"{}").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"{}");
        assert!(!unfinished.is_symlink());
        let lock = path.with_extension("lock");
        fs::remove_file(&lock).unwrap();
        for target in [&victim, &folder.path().join("nothing")] {
            symlink(target, &lock).unwrap();
            let error = changed(&path, b"other").unwrap_err().to_string();
            assert!(error.contains("keys.lock is a symbolic link; remove that"), "{error}");
            fs::remove_file(&lock).unwrap();
        }
        fs::create_dir(&lock).unwrap();
        assert!(changed(&path, b"other").unwrap_err().to_string().contains("no regular file"));
        assert_eq!(fs::read(&victim).unwrap(), b"of somebody else");
        assert!(!folder.path().join("nothing").exists());
        assert_eq!(fs::read(&path).unwrap(), b"{}");
    }

    #[test]
    fn a_link_to_the_file_stays_one_and_the_file_is_changed() {
        use std::os::unix::fs::{lchown, symlink};
        let folder = tempfile::tempdir().unwrap();
        for name in ["real", "link"] {
            fs::create_dir(folder.path().join(name)).unwrap();
        }
        let (real, link) = (folder.path().join("real/keys.json"), folder.path().join("link/keys.json"));
        symlink("../real/keys.json", &link).unwrap();
        assert!(changed(&link, b"new").unwrap_err().to_string().contains("leads nowhere"));
        fs::write(&real, "old").unwrap();
        let change = Change::begin(&link).unwrap();
        assert_eq!(change.read().unwrap(), b"old");
        change.replace(b"new").unwrap();
        drop(change);
        assert!(link.is_symlink() && real.with_extension("lock").exists());
        assert_eq!(fs::read(&real).unwrap(), b"new");
        // One that another user has put there, at once or behind one of root's.
        let chain = folder.path().join("chain.json");
        symlink("link/keys.json", &chain).unwrap();
        changed(&chain, b"newer").unwrap();
        assert_eq!(fs::read(&real).unwrap(), b"newer");
        if lchown(&link, Some(65534), Some(65534)).is_ok() {
            for path in [&link, &chain] {
                assert!(changed(path, b"x").unwrap_err().to_string().contains("link of user 65534"));
            }
            assert_eq!(fs::read(&real).unwrap(), b"newer");
        }
        symlink("loop.json", folder.path().join("loop.json")).unwrap();
        assert!(changed(&folder.path().join("loop.json"), b"x").unwrap_err().to_string().contains("40"));
        let change = Change::begin(&real).unwrap();
        fs::remove_file(&real).unwrap();
        symlink(folder.path().join("other"), &real).unwrap();
        fs::write(folder.path().join("other"), "secret").unwrap();
        assert!(change.read().is_err(), "a link that came in its place is not followed");
    }
}
