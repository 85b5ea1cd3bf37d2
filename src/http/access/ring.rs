//! The keys in force: read again when their file changes, so that a revoked key ends with the next request.

use std::path::PathBuf;
use std::sync::{Arc, PoisonError, RwLock};

use super::keys::{Key, KeyError, hash, id_of, read};
use super::{Caller, Principal};
use crate::jobs::operator_file::{Stamp, stamp};

/// The keys in force.
pub struct KeyRing {
    path: PathBuf,
    state: RwLock<State>,
}

struct State {
    stamp: Stamp,
    keys: Vec<Key>,
    /// There has been a key file: from then on nobody gets in without a key, also when it goes.
    closed: bool,
}

impl KeyRing {
    /// # Errors
    /// When the file is there and cannot be read.
    pub fn open(path: impl Into<PathBuf>) -> Result<Self, KeyError> {
        let path = path.into();
        let stamp = stamp(&path);
        let found = read(&path)?;
        let state = State { stamp, closed: found.is_some(), keys: found.unwrap_or_default() };
        Ok(Self { path, state: RwLock::new(state) })
    }

    /// Whether a key is needed.
    pub fn is_closed(&self) -> bool {
        self.state.read().unwrap_or_else(PoisonError::into_inner).closed
    }

    /// Whom a request with this token comes from; `None`: nobody who is let in.
    pub fn caller(&self, token: Option<&str>) -> Option<Caller> {
        self.renew();
        let state = self.state.read().unwrap_or_else(PoisonError::into_inner);
        if !state.closed {
            return Some(Caller::Anyone);
        }
        let token = token?;
        let id = id_of(token)?;
        let key = state.keys.iter().find(|key| key.id == id && key.revoked.is_none())?;
        let principal = || Principal { name: key.name.clone(), scopes: key.scopes.clone() };
        is_same(&hash(token), &key.sha256).then(|| Caller::Principal(Arc::new(principal())))
    }

    fn renew(&self) {
        let stamp = stamp(&self.path);
        if self.state.read().unwrap_or_else(PoisonError::into_inner).stamp == stamp {
            return;
        }
        let found = read(&self.path);
        let mut state = self.state.write().unwrap_or_else(PoisonError::into_inner);
        state.stamp = stamp;
        match found {
            Ok(Some(keys)) => (state.keys, state.closed) = (keys, true),
            Ok(None) => state.keys.clear(),
            // A key that was to be revoked may be among those known before.
            Err(error) => {
                tracing::error!(%error, "no key is let in");
                (state.keys, state.closed) = (Vec::new(), true);
            }
        }
    }
}

/// Compares in the same time wherever they differ.
fn is_same(one: &str, other: &str) -> bool {
    let differences = one.bytes().zip(other.bytes()).fold(0, |all, (a, b)| all | (a ^ b));
    one.len() == other.len() && differences == 0
}

#[cfg(test)]
mod tests {
    use super::super::{KeyFile, Scope};
    use super::*;

    fn name(ring: &KeyRing, token: &str) -> Option<String> {
        ring.caller(Some(token)).and_then(|caller| caller.owner().map(str::to_owned))
    }

    #[test]
    fn changes_of_the_file_count_at_once_and_its_loss_opens_nothing() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("keys.json");
        let (file, ring) = (KeyFile::new(&path), KeyRing::open(&path).unwrap());
        assert!(!ring.is_closed() && matches!(ring.caller(None), Ok(Caller::Anyone)));
        let first = file.add("pacs", &[Scope::Read], false).unwrap();
        assert!(ring.caller(None) == Err(Refusal::Invalid) && ring.is_closed());
        assert_eq!(name(&ring, &first).as_deref(), Some("pacs"));
        for wrong in ["", "x", &first[..first.len() - 1], &format!("{first}0"), &first.to_uppercase()] {
            assert!(ring.caller(Some(wrong)).is_none(), "{wrong}");
        }
        let second = file.rotate("pacs").unwrap();
        assert!(name(&ring, &first).is_none() && name(&ring, &second).is_some());
        std::fs::write(&path, "{").unwrap();
        assert!(ring.caller(Some(&second)).is_none() && ring.caller(None).is_none());
        std::fs::remove_file(&path).unwrap();
        unreadable(&ring);
        let third = file.add("pacs", &[Scope::Read], false).unwrap();
        assert!(name(&ring, &third).is_some());
        file.revoke("pacs").unwrap();
        assert!(name(&ring, &third).is_none() && ring.caller(None).is_none());
    }
}
