//! A file of a name that nobody can foresee: whoever owns the folder has put no link in its place.

use std::fs::{self, File, OpenOptions};
use std::io;
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};

/// Such a file, for its owner's eyes only; removed when it is dropped before it has another name.
#[derive(Debug)]
pub(super) struct FreshFile {
    file: File,
    path: PathBuf,
    is_renamed: bool,
}

impl FreshFile {
    /// Makes one in `folder`. What is there already is never opened, nor is a link followed.
    ///
    /// # Errors
    /// When it cannot be made.
    pub(super) fn create(folder: &Path, prefix: &str, suffix: &str) -> io::Result<Self> {
        let path = folder.join(format!("{prefix}{}{suffix}", random()?));
        let file = OpenOptions::new().write(true).create_new(true).mode(0o600).open(&path)?;
        Ok(Self { file, path, is_renamed: false })
    }

    /// Whether this part of a name is the one that [`FreshFile::create`] makes.
    pub(super) fn is_random(part: &str) -> bool {
        part.len() == 16 && part.bytes().all(|byte| byte.is_ascii_digit() || (b'a'..=b'f').contains(&byte))
    }

    pub(super) fn file(&mut self) -> &mut File {
        &mut self.file
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Gives it a name, in place of what has that.
    pub(super) fn rename(&mut self, path: &Path) -> io::Result<()> {
        fs::rename(&self.path, path)?;
        self.is_renamed = true;
        Ok(())
    }
}

impl Drop for FreshFile {
    fn drop(&mut self) {
        if !self.is_renamed {
            // What is left of it is of no use to anyone; the error that led here is the one to tell.
            fs::remove_file(&self.path).ok();
        }
    }
}

/// 64 random bits, as 16 hexadecimal digits.
fn random() -> io::Result<String> {
    let number = getrandom::u64().map_err(|error| io::Error::other(error.to_string()))?;
    Ok(format!("{number:016x}"))
}
