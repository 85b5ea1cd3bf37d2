//! The keys in force: read again when their file changes, so that a revoked key ends with the next request.
//!
//! While the file cannot be read, nobody is let in by a key, as one of those known before may have been revoked; and
//! nobody is told that their key is wrong, which is not known.

use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError, RwLock};

use super::broken::Broken;
use super::keys::{Key, KeyError, KeyFile, hash, id_of};
use super::{Caller, Principal};
use crate::jobs::operator_file::{Stamp, stamp};

/// The keys in force.
pub struct KeyRing {
    file: KeyFile,
    state: RwLock<State>,
    /// Held from the look at the file until what it held is noted: nothing older comes in place of something newer.
    turn: Mutex<()>,
}

struct State {
    stamp: Stamp,
    keys: Vec<Key>,
    /// There has been a key file: from then on nobody gets in without a key, also when it goes.
    closed: bool,
    /// Of a file that cannot be read now: it is tried again, also when it has not changed.
    broken: Option<Broken>,
}

/// Why a key lets nobody in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Refusal {
    /// There is none, it is wrong, or it was revoked.
    Invalid,
    /// The file of the keys cannot be read now.
    Unreadable,
}

impl KeyRing {
    /// # Errors
    /// When the file is there and cannot be read.
    pub fn open(path: impl Into<PathBuf>) -> Result<Self, KeyError> {
        Self::of(KeyFile::new(path))
    }

    /// # Errors
    /// Also when it is not there, and must be.
    pub fn of(file: KeyFile) -> Result<Self, KeyError> {
        let stamp = stamp(file.path());
        let found = file.read()?;
        let closed = found.is_some();
        let state = State { stamp, closed, keys: found.unwrap_or_default(), broken: None };
        // Later it is gone, not missing at a start.
        let file = KeyFile::new(file.path());
        Ok(Self { file, state: RwLock::new(state), turn: Mutex::default() })
    }

    /// Whether a key is needed.
    pub fn is_closed(&self) -> bool {
        self.state.read().unwrap_or_else(PoisonError::into_inner).closed
    }

    /// Whom a request with this token comes from.
    ///
    /// # Errors
    /// [`Refusal`], where it is nobody who is let in.
    pub fn caller(&self, token: Option<&str>) -> Result<Caller, Refusal> {
        self.renew();
        let state = self.state.read().unwrap_or_else(PoisonError::into_inner);
        if !state.closed {
            return Ok(Caller::Anyone);
        }
        let (token, id) = token.and_then(|token| Some((token, id_of(token)?))).ok_or(Refusal::Invalid)?;
        if state.broken.is_some() {
            return Err(Refusal::Unreadable);
        }
        let found = state.keys.iter().find(|key| key.id == id && key.revoked.is_none());
        let key = found.filter(|key| is_same(&hash(token), &key.sha256)).ok_or(Refusal::Invalid)?;
        Ok(Caller::Principal(Arc::new(Principal { name: key.name.clone(), scopes: key.scopes.clone() })))
    }

    /// Whether the keys can be read: also a file that has not changed since it could be. What is found counts for the next
    /// request, so that readiness and the keys say the same.
    ///
    /// # Errors
    /// [`KeyError::Missing`] where there was a file and is none now.
    pub fn check(&self) -> Result<(), KeyError> {
        let _turn = self.turn.lock().unwrap_or_else(PoisonError::into_inner);
        self.read_again(stamp(self.file.path()))
    }

    /// Whether there is a key that lets somebody in.
    pub fn has_keys(&self) -> bool {
        let state = self.state.read().unwrap_or_else(PoisonError::into_inner);
        state.broken.is_none() && state.keys.iter().any(|key| key.revoked.is_none())
    }

    fn renew(&self) {
        if self.is_known(stamp(self.file.path())) {
            return;
        }
        let _turn = self.turn.lock().unwrap_or_else(PoisonError::into_inner);
        let stamp = stamp(self.file.path());
        // Of those that waited one reads it.
        if !self.is_known(stamp) {
            // Noted and logged.
            self.read_again(stamp).ok();
        }
    }

    fn is_known(&self, stamp: Stamp) -> bool {
        let state = self.state.read().unwrap_or_else(PoisonError::into_inner);
        state.stamp == stamp && !state.broken.as_ref().is_some_and(Broken::is_due)
    }

    /// In its turn. `stamp`: the file's, of before it is read.
    fn read_again(&self, stamp: Stamp) -> Result<(), KeyError> {
        let found = self.file.read();
        let mut state = self.state.write().unwrap_or_else(PoisonError::into_inner);
        state.stamp = stamp;
        let error = match found {
            Ok(Some(keys)) => {
                (state.keys, state.closed, state.broken) = (keys, true, None);
                return Ok(());
            }
            Ok(None) if !state.closed => return Ok(()),
            Ok(None) => KeyError::Missing { path: self.file.path().display().to_string() },
            Err(error) => error,
        };
        (state.keys, state.closed) = (Vec::new(), true);
        // Once for each reason, not at each request.
        if Broken::note(&mut state.broken, error.to_string()) {
            tracing::error!(%error, "no key is let in");
        }
        Err(error)
    }
}

/// Compares in the same time wherever they differ.
fn is_same(one: &str, other: &str) -> bool {
    let differences = one.bytes().zip(other.bytes()).fold(0, |all, (a, b)| all | (a ^ b));
    one.len() == other.len() && differences == 0
}

#[cfg(test)]
mod tests {
    use super::super::Scope;
    use super::*;

    fn name(ring: &KeyRing, token: &str) -> Option<String> {
        ring.caller(Some(token)).ok().and_then(|caller| caller.owner().map(str::to_owned))
    }

    /// As when the disk could not be read for a moment: what tells one state of the file from the next stays the same.
    #[test]
    fn a_file_that_looks_as_it_did_is_tried_again_by_itself_or_by_readiness() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("keys.json");
        let token = KeyFile::new(&path).add("pacs", &[Scope::Read], false).unwrap();
        let ring = KeyRing::open(&path).unwrap();
        let fail = || Broken::note(&mut ring.state.write().unwrap().broken, "it is away".to_owned());
        fail();
        // Not at each request.
        assert_eq!(ring.caller(Some(&token)), Err(Refusal::Unreadable));
        assert!(!ring.has_keys());
        std::thread::sleep(std::time::Duration::from_millis(1100));
        assert!(name(&ring, &token).is_some() && ring.has_keys());
        fail();
        assert!(ring.check().is_ok() && name(&ring, &token).is_some(), "both at once");
    }

    #[test]
    fn what_waits_for_its_turn_notes_the_file_as_it_is_then() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("keys.json");
        let file = KeyFile::new(&path);
        file.add("pacs", &[Scope::Read], false).unwrap();
        let ring = KeyRing::open(&path).unwrap();
        std::thread::scope(|scope| {
            let turn = ring.turn.lock().unwrap();
            let probe = scope.spawn(|| ring.check());
            std::thread::sleep(std::time::Duration::from_millis(50));
            assert!(!probe.is_finished());
            file.rotate("pacs").unwrap();
            drop(turn);
            assert!(probe.join().unwrap().is_ok());
        });
        assert!(ring.is_known(stamp(&path)));
    }

    #[test]
    fn a_change_of_the_right_to_read_is_a_change() {
        use std::os::unix::fs::PermissionsExt;

        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("keys.json");
        std::fs::write(&path, "{}").unwrap();
        let mut stamps = vec![stamp(&path)];
        for mode in [0o000, 0o600] {
            // As long as a tick of the file system's clock.
            std::thread::sleep(std::time::Duration::from_millis(20));
            std::fs::set_permissions(&path, std::fs::Permissions::from_mode(mode)).unwrap();
            stamps.push(stamp(&path));
        }
        assert!(stamps[0] != stamps[1] && stamps[1] != stamps[2] && stamps[0].is_some());
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
            assert_eq!(ring.caller(Some(wrong)), Err(Refusal::Invalid), "{wrong}");
        }
        let second = file.rotate("pacs").unwrap();
        assert!(name(&ring, &first).is_none() && name(&ring, &second).is_some());
        let good = std::fs::read(&path).unwrap();
        let unreadable = |ring: &KeyRing| {
            assert_eq!(ring.caller(Some(&second)), Err(Refusal::Unreadable));
            assert!(ring.check().is_err() && ring.caller(None) == Err(Refusal::Invalid));
        };
        std::fs::write(&path, "{").unwrap();
        unreadable(&ring);
        std::fs::write(&path, &good).unwrap();
        assert!(name(&ring, &second).is_some() && ring.check().is_ok());
        std::fs::remove_file(&path).unwrap();
        unreadable(&ring);
        let third = file.add("pacs", &[Scope::Read], false).unwrap();
        assert!(name(&ring, &third).is_some());
        file.revoke("pacs").unwrap();
        assert!(name(&ring, &third).is_none() && ring.caller(None).is_err());
    }
}
