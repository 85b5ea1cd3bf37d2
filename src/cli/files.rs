//! Files in and out: whole, or not at all.

use std::ffi::OsString;
use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};

use super::Failure;

/// Reads a whole file; a failure names it.
pub(super) fn read(path: &Path) -> Result<Vec<u8>, Failure> {
    fs::read(path).map_err(|error| Failure::new(format!("cannot read {}: {error}", path.display())))
}

/// Makes a folder, for its owner's eyes only, where there is none.
pub(super) fn create_private(folder: &Path) -> Result<(), Failure> {
    let mut builder = fs::DirBuilder::new();
    builder.recursive(true);
    #[cfg(unix)]
    std::os::unix::fs::DirBuilderExt::mode(&mut builder, 0o700);
    builder.create(folder).map_err(|error| Failure::new(format!("cannot make {}: {error}", folder.display())))
}

/// Fails when a file could not be written to `path` because its folder is not there.
pub(super) fn check_folder(path: &Path) -> Result<(), Failure> {
    let folder = folder(path);
    if folder.is_dir() && path.file_name().is_some() && !path.is_dir() {
        return Ok(());
    }
    let reason = if path.is_dir() { "it is a folder" } else { "its folder does not exist" };
    Err(Failure::new(format!("cannot write {}: {reason}", path.display())))
}

/// Writes `bytes` to a temporary file beside `path`, then renames it, so that nobody ever sees
/// half a file and an old one stays until the new one is whole.
pub(super) fn write(path: &Path, bytes: &[u8]) -> Result<(), Failure> {
    check_folder(path)?;
    let mut name = OsString::from(".");
    name.push(path.file_name().unwrap_or_default());
    name.push(format!(".{}.tmp", std::process::id()));
    let temporary = folder(path).join(name);
    let written = fill(&temporary, bytes).and_then(|()| fs::rename(&temporary, path));
    written.map_err(|error| {
        // What is left of it is of no use to anyone; the first error is the one to tell.
        let _ = fs::remove_file(&temporary);
        Failure::new(format!("cannot write {}: {error}", path.display()))
    })
}

fn fill(path: &Path, bytes: &[u8]) -> std::io::Result<()> {
    let mut file = File::create(path)?;
    file.write_all(bytes)?;
    file.sync_all()
}

fn folder(path: &Path) -> PathBuf {
    match path.parent() {
        Some(parent) if parent != Path::new("") => parent.to_owned(),
        _ => PathBuf::from("."),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_replaced_whole_and_nothing_is_left_beside_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("line.json");
        write(&path, b"first, and longer").unwrap();
        write(&path, b"second").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"second");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn a_missing_folder_and_a_folder_as_a_file_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        assert!(write(&folder.path().join("no/line.json"), b"").is_err());
        assert!(write(folder.path(), b"").is_err());
        assert!(check_folder(Path::new("line.json")).is_ok());
    }
}
