//! Tells whether a file of the operator's has changed.

use std::path::Path;
use std::time::SystemTime;

/// Tells one state of a file from the next; `None`: it is not there.
pub type Stamp = Option<(SystemTime, u64, u64)>;

/// When the file was written, its length, and which file it is: one that is replaced whole is another one.
pub fn stamp(path: &Path) -> Stamp {
    let found = std::fs::metadata(path).ok()?;
    #[cfg(unix)]
    let file = std::os::unix::fs::MetadataExt::ino(&found);
    #[cfg(not(unix))]
    let file = 0;
    Some((found.modified().ok()?, found.len(), file))
}
