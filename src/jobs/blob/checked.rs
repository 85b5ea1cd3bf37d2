//! Blobs that were read through: each is hashed once as long as its file stays the one that it was, and few at a time.

use std::collections::HashMap;
use std::fs;
use std::hash::{BuildHasher, RandomState};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use super::BlobInfo;
use crate::jobs::stamp::Stamp;

/// Blobs that are remembered; with one more they are all forgotten.
const MOST: usize = 1024;
/// Blobs that are hashed at the same time: the threads that do it are those that uploads are synced on.
const LANES: usize = 4;
/// What was found in files.
pub(super) struct Checked {
    known: Mutex<HashMap<PathBuf, (Stamp, BlobInfo)>>,
    /// Files are spread over them: of those that ask for one file at once, one reads it.
    lanes: [Arc<tokio::sync::Mutex<()>>; LANES],
    spread: RandomState,
}

impl Checked {
    pub(super) fn new() -> Arc<Self> {
        Arc::new(Self { known: Mutex::default(), lanes: Default::default(), spread: RandomState::new() })
    }

    /// What `look` finds in a file, or has found in it, with the stamp that the file had then.
    pub(super) async fn info(
        self: &Arc<Self>,
        path: PathBuf,
        look: impl FnOnce(&Path) -> io::Result<BlobInfo> + Send + 'static,
    ) -> io::Result<(Stamp, BlobInfo)> {
        let (checked, asked) = (self.clone(), path.clone());
        if let Some(found) = aside(move || Ok(checked.known(&asked, stamp(&asked)?))).await? {
            return Ok(found);
        }
        // The remainder is less than their number.
        let lane = self.lanes[(self.spread.hash_one(&path) % LANES as u64) as usize].clone();
        let (turn, checked) = (lane.lock_owned().await, self.clone());
        aside(move || {
            let stamp = stamp(&path)?;
            let found = match checked.known(&path, stamp) {
                Some(found) => found,
                None => (stamp, look(&path)?),
            };
            checked.remember(path, &found)?;
            // Also when whoever asked has gone.
            drop(turn);
            Ok(found)
        })
        .await
    }

    fn known(&self, path: &Path, stamp: Stamp) -> Option<(Stamp, BlobInfo)> {
        let known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        known.get(path).filter(|(before, _)| *before == stamp).cloned()
    }

    /// Unless the file has changed meanwhile, or only just before.
    fn remember(&self, path: PathBuf, found: &(Stamp, BlobInfo)) -> io::Result<()> {
        let before = found.0;
        if stamp(&path)? != before || !before.is_settled() {
            return Ok(());
        }
        let mut known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        if known.len() >= MOST {
            known.clear();
        }
        known.insert(path, found.clone());
        Ok(())
    }
}

fn stamp(path: &Path) -> io::Result<Stamp> {
    Ok(Stamp::of(&fs::metadata(path)?))
}

/// Off the async threads.
pub(super) async fn aside<T: Send + 'static>(
    work: impl FnOnce() -> io::Result<T> + Send + 'static,
) -> io::Result<T> {
    tokio::task::spawn_blocking(work).await.unwrap_or_else(|error| Err(io::Error::other(error)))
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};
    use std::time::Duration;

    use super::*;
    use crate::jobs::stamp::SETTLED;

    #[tokio::test]
    async fn a_file_is_read_once_as_long_as_it_is_the_same() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("result");
        let (checked, reads) = (Checked::new(), Arc::new(AtomicUsize::new(0)));
        let asked = || {
            let (checked, path, reads) = (checked.clone(), path.clone(), reads.clone());
            async move {
                let look = move |path: &Path| {
                    reads.fetch_add(1, Ordering::SeqCst);
                    let text = fs::read_to_string(path)?;
                    Ok(BlobInfo { size: text.len() as u64, sha256: text })
                };
                checked.info(path, look).await.map(|(_, info)| info)
            }
        };
        let mut told = 0;
        for text in ["one", "two", "three"] {
            fs::write(&path, text).unwrap();
            let changed = fs::metadata(&path).unwrap().modified().unwrap();
            // Not yet remembered, in case that it changes within a tick; and changed back in time.
            assert_eq!(asked().await.unwrap().sha256, text);
            fs::File::options().write(true).open(&path).unwrap().set_modified(changed).unwrap();
            tokio::time::sleep(SETTLED + Duration::from_millis(20)).await;
            let all = futures::future::join_all((0..50).map(|_| asked())).await;
            assert!(all.into_iter().all(|info| info.unwrap().sha256 == text));
            assert_eq!(reads.load(Ordering::SeqCst), told + 2, "{text}");
            told += 2;
        }
        fs::remove_file(&path).unwrap();
        assert_eq!(asked().await.unwrap_err().kind(), io::ErrorKind::NotFound);
    }

    #[test]
    fn what_is_remembered_is_bounded() {
        let folder = tempfile::tempdir().unwrap();
        let checked = Checked::new();
        let path = folder.path().join("result");
        fs::write(&path, "x").unwrap();
        std::thread::sleep(SETTLED + Duration::from_millis(20));
        let info = BlobInfo { size: 1, sha256: String::new() };
        for place in 0..=MOST {
            let link = folder.path().join(place.to_string());
            std::os::unix::fs::symlink(&path, &link).unwrap();
            checked.remember(link.clone(), &(stamp(&link).unwrap(), info.clone())).unwrap();
        }
        assert_eq!(checked.known.lock().unwrap().len(), 1);
    }
}
