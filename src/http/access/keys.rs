//! The file of API keys: hashes only, changed by `rosaline keys`, read by the service.

use std::io;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use time::OffsetDateTime;
use time::format_description::well_known::Rfc3339;

use crate::jobs::operator_file;

/// What every key begins with, so that leaked ones can be searched for.
pub(super) const PREFIX: &str = "rosaline_";
/// Bytes of a key's id, which is no secret, and of its secret.
const ID_BYTES: usize = 6;
const SECRET_BYTES: usize = 32;
const NAME_CHARS: usize = 64;

/// Why the keys could not be read or changed.
#[derive(Debug, thiserror::Error)]
pub enum KeyError {
    #[error("the key file {path} cannot be used: {source}; it must be readable and its folder writable")]
    Io { path: String, source: io::Error },
    #[error(
        "the key file {path} is damaged: {detail}; restore it from a copy, or remove it and make new keys"
    )]
    Damaged { path: String, detail: String },
    #[error("the key file {path} is gone; put a copy back, or make new keys")]
    Missing { path: String },
    #[error(
        "the key file {path} is not there, although it was named: make a key with 'rosaline keys add NAME --scope \
         submit,read --keys {path}', or name none"
    )]
    Named { path: String },
    #[error(
        "there are jobs that belong to somebody, and without the key file {path} everybody could see them: put a copy of \
         it back, make a key with 'rosaline keys add NAME --scope submit,read --keys {path}', accept tokens with \
         --jwt-issuer, or let everybody in with --insecure"
    )]
    Lost { path: String },
    #[error("a name has 1 to {NAME_CHARS} letters, digits, '.', '_' and '-'")]
    Name,
    #[error(
        "there is a key '{0}' already; 'rosaline keys rotate {0}' gives it a new secret, or choose another name"
    )]
    Taken(String),
    #[error(
        "the key '{0}' was revoked, and its jobs still belong to that name; 'rosaline keys add {0} --inherit' with its \
         scopes makes a new key that has them, or choose another name"
    )]
    Revoked(String),
    #[error("there is no key '{0}'; 'rosaline keys list' shows what there is")]
    Unknown(String),
    #[error("the system gives no random numbers: {0}")]
    Random(getrandom::Error),
}

/// What a key lets its holder do.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Scope {
    /// Make, try again, cancel and purge one's own jobs.
    Submit,
    /// See one's own jobs and results.
    Read,
    /// All of it, with the jobs of everybody.
    Admin,
}

impl Scope {
    pub const ALL: [Scope; 3] = [Scope::Submit, Scope::Read, Scope::Admin];

    pub fn name(self) -> &'static str {
        match self {
            Scope::Submit => "submit",
            Scope::Read => "read",
            Scope::Admin => "admin",
        }
    }
}

/// A word that is none of [`Scope`]'s names.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("a scope is submit, read or admin")]
pub struct UnknownScope;

impl FromStr for Scope {
    type Err = UnknownScope;

    fn from_str(text: &str) -> Result<Self, UnknownScope> {
        Scope::ALL.into_iter().find(|scope| scope.name() == text).ok_or(UnknownScope)
    }
}

/// A key as it is kept: its secret is not.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Key {
    pub id: String,
    /// The principal.
    pub name: String,
    pub scopes: Vec<Scope>,
    /// SHA-256 of the whole key, lower-case hex. A secret of 256 random bits needs no slow hash.
    pub sha256: String,
    /// RFC 3339, UTC.
    pub created: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub revoked: Option<String>,
}

#[derive(Default, Serialize, Deserialize)]
struct Kept {
    keys: Vec<Key>,
}

/// The key file.
#[derive(Debug, Clone)]
pub struct KeyFile {
    path: PathBuf,
    must_exist: bool,
}

impl KeyFile {
    pub fn new(path: impl Into<PathBuf>) -> Self {
        Self { path: path.into(), must_exist: false }
    }

    /// One that must be there, as the operator named it.
    pub fn named(path: impl Into<PathBuf>) -> Self {
        Self { path: path.into(), must_exist: true }
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The keys; none where there is no file.
    pub fn list(&self) -> Result<Vec<Key>, KeyError> {
        Ok(self.read()?.unwrap_or_default())
    }

    /// The keys in the file; `None` where there is none.
    ///
    /// # Errors
    /// [`KeyError::Named`] where there is none although it was named.
    pub fn read(&self) -> Result<Option<Vec<Key>>, KeyError> {
        self.parsed(operator_file::read(&self.path))
    }

    fn parsed(&self, read: io::Result<Vec<u8>>) -> Result<Option<Vec<Key>>, KeyError> {
        let path = || self.path.display().to_string();
        let text = match read {
            Ok(text) => text,
            Err(error) if is_absent(&error) && self.must_exist => {
                return Err(KeyError::Named { path: path() });
            }
            Err(error) if is_absent(&error) => return Ok(None),
            Err(source) => return Err(KeyError::Io { path: path(), source }),
        };
        let kept: Kept = serde_json::from_slice(&text)
            .map_err(|error| KeyError::Damaged { path: path(), detail: error.to_string() })?;
        Ok(Some(kept.keys))
    }

    /// Makes a key; its text, which is kept nowhere. With `inherits` also for the name of a revoked one, whose jobs are
    /// the new one's then; the revoked one stays listed.
    ///
    /// # Errors
    /// [`KeyError::Revoked`] for a revoked key's name where nobody said that its jobs may be handed on.
    pub fn add(&self, name: &str, scopes: &[Scope], inherits: bool) -> Result<String, KeyError> {
        let fits = |byte: u8| byte.is_ascii_alphanumeric() || b"._-".contains(&byte);
        if !(1..=NAME_CHARS).contains(&name.len()) || !name.bytes().all(fits) {
            return Err(KeyError::Name);
        }
        self.change(|keys| {
            match in_force(keys, name) {
                Ok(_) => return Err(KeyError::Taken(name.to_owned())),
                Err(error @ KeyError::Revoked(_)) if !inherits => return Err(error),
                Err(_) => {}
            }
            let (text, key) = fresh(name, scopes)?;
            keys.push(key);
            Ok(text)
        })
    }

    /// Gives a principal a new key in place of its old one, which ends at once; the new one's text.
    pub fn rotate(&self, name: &str) -> Result<String, KeyError> {
        self.change(|keys| {
            let key = in_force(keys, name)?;
            let (text, new) = fresh(name, &key.scopes)?;
            *key = new;
            Ok(text)
        })
    }

    /// Ends a key at once.
    pub fn revoke(&self, name: &str) -> Result<(), KeyError> {
        self.change(|keys| {
            in_force(keys, name)?.revoked = Some(now());
            Ok(())
        })
    }

    fn change<T>(&self, change: impl FnOnce(&mut Vec<Key>) -> Result<T, KeyError>) -> Result<T, KeyError> {
        let failed = |source| KeyError::Io { path: self.path.display().to_string(), source };
        if self.must_exist {
            // Before a lock is made beside it.
            self.read()?;
        }
        let file = operator_file::Change::begin(&self.path).map_err(failed)?;
        let mut keys = self.parsed(file.read())?.unwrap_or_default();
        let changed = change(&mut keys)?;
        let text = serde_json::to_vec_pretty(&Kept { keys }).map_err(|error| failed(error.into()))?;
        file.replace(&text).map_err(failed)?;
        Ok(changed)
    }
}

/// The key of this name that is not revoked: there is one at most.
fn in_force<'k>(keys: &'k mut [Key], name: &str) -> Result<&'k mut Key, KeyError> {
    let was_there = keys.iter().any(|key| key.name == name);
    let found = keys.iter_mut().find(|key| key.name == name && key.revoked.is_none());
    found.ok_or_else(|| {
        if was_there { KeyError::Revoked(name.to_owned()) } else { KeyError::Unknown(name.to_owned()) }
    })
}

fn is_absent(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::NotFound | io::ErrorKind::NotADirectory)
}

fn fresh(name: &str, scopes: &[Scope]) -> Result<(String, Key), KeyError> {
    let mut random = [0; ID_BYTES + SECRET_BYTES];
    getrandom::fill(&mut random).map_err(KeyError::Random)?;
    let (id, secret) = random.split_at(ID_BYTES);
    let id = hex(id);
    let text = format!("{PREFIX}{id}_{}", hex(secret));
    let key = Key {
        id,
        name: name.to_owned(),
        scopes: scopes.to_vec(),
        sha256: hash(&text),
        created: now(),
        revoked: None,
    };
    Ok((text, key))
}

/// The id in a key's text.
pub(super) fn id_of(text: &str) -> Option<&str> {
    Some(text.strip_prefix(PREFIX)?.split_once('_')?.0)
}

pub(super) fn hash(text: &str) -> String {
    hex(&Sha256::digest(text))
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn now() -> String {
    OffsetDateTime::now_utc().format(&Rfc3339).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn keys_are_made_rotated_and_revoked_and_their_secrets_are_kept_nowhere() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("keys.json");
        let file = KeyFile::new(&path);
        assert!(file.list().unwrap().is_empty());
        let first = file.add("pacs", &[Scope::Submit, Scope::Read], false).unwrap();
        let other = file.add("viewer", &[Scope::Read], false).unwrap();
        assert!(first != other && first.len() == PREFIX.len() + 12 + 1 + 64, "{first}");
        assert!(matches!(file.add("pacs", &[Scope::Read], false), Err(KeyError::Taken(_))));
        for name in ["", "a b", "a/b", "ä", &"x".repeat(65)] {
            assert!(matches!(file.add(name, &[Scope::Read], false), Err(KeyError::Name)), "{name}");
        }
        let second = file.rotate("pacs").unwrap();
        let keys = file.list().unwrap();
        assert_eq!((keys.len(), &keys[0].sha256), (2, &hash(&second)));
        assert_eq!(keys[0].scopes, [Scope::Submit, Scope::Read]);
        file.revoke("viewer").unwrap();
        assert!(matches!(file.revoke("viewer"), Err(KeyError::Revoked(_))));
        assert!(matches!(file.rotate("viewer"), Err(KeyError::Revoked(_))));
        assert!(matches!(file.rotate("nobody"), Err(KeyError::Unknown(_))));
        assert!(matches!(file.add("viewer", &[Scope::Read], false), Err(KeyError::Revoked(_))));
        assert!(matches!(file.add("pacs", &[Scope::Read], true), Err(KeyError::Taken(_))));
        let heir = file.add("viewer", &[Scope::Submit], true).unwrap();
        let keys = file.list().unwrap();
        assert_eq!(
            (keys.len(), &keys[2].sha256, &keys[2].scopes[..]),
            (3, &hash(&heir), &[Scope::Submit][..])
        );
        assert!(keys[1].revoked.is_some() && keys[2].revoked.is_none());
        assert!(matches!(file.add("viewer", &[Scope::Read], true), Err(KeyError::Taken(_))));
        let text = fs::read_to_string(&path).unwrap();
        for secret in [&first, &second, &other, &heir] {
            assert!(!text.contains(secret.rsplit('_').next().unwrap()));
        }
        #[cfg(unix)]
        assert_eq!(std::os::unix::fs::MetadataExt::mode(&fs::metadata(&path).unwrap()) & 0o777, 0o600);
        fs::write(&path, "{").unwrap();
        assert!(matches!(file.list(), Err(KeyError::Damaged { .. })));
    }
}
