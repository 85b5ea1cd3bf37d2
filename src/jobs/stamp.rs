//! Tells one state of a file from the next.

use std::fs::Metadata;
use std::os::unix::fs::MetadataExt;
use std::time::{Duration, SystemTime};

/// A file that was changed less long ago may change again without a sign: file systems tell times by the tick.
pub(super) const SETTLED: Duration = Duration::from_millis(100);

/// Which file it is, its length, and when it and its inode were changed. Who changes a file can set its time of change
/// back, but not that of its inode, which a change of the right to read it leaves its mark on as well.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stamp {
    file: u64,
    length: u64,
    changed: (i64, i64),
    inode_changed: (i64, i64),
}

impl Stamp {
    pub(super) fn of(found: &Metadata) -> Self {
        Self {
            file: found.ino(),
            length: found.len(),
            changed: (found.mtime(), found.mtime_nsec()),
            inode_changed: (found.ctime(), found.ctime_nsec()),
        }
    }

    /// Whether it is the same file with the same bytes, as far as their length and time of change tell: also after a link
    /// to it, or the right to read it, was changed.
    pub(super) fn has_bytes_of(&self, before: &Self) -> bool {
        (self.file, self.length, self.changed) == (before.file, before.length, before.changed)
    }

    /// Whether its last change is so long ago that the next one will show.
    pub(super) fn is_settled(&self) -> bool {
        let (seconds, nanos) = self.inode_changed;
        let (Ok(seconds), Ok(nanos)) = (u64::try_from(seconds), u32::try_from(nanos)) else { return false };
        let changed = SystemTime::UNIX_EPOCH + Duration::new(seconds, nanos);
        changed.elapsed().is_ok_and(|age| age >= SETTLED)
    }
}
