//! The file of webhook targets: made by the operator, by hand or with `rosaline webhooks`.

use std::collections::HashSet;
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

use serde::{Deserialize, Serialize};
use time::OffsetDateTime;

use super::super::Url;
use super::signature::Secret;
use crate::jobs::{JobStatus, Listener, operator_file};

const NAME_CHARS: usize = 64;

/// Why the targets could not be read or changed.
#[derive(Debug, thiserror::Error)]
pub enum TargetError {
    #[error("the webhook file {path} cannot be used: {source}; it must be readable and its folder writable")]
    Io { path: String, source: io::Error },
    #[error("the webhook file {path} is damaged: {detail}; mend it, or remove it and add the targets again")]
    Damaged { path: String, detail: String },
    #[error(
        "the webhook file {0} is not there; put it back, or make one with 'rosaline webhooks add NAME --url URL --webhooks {0}'"
    )]
    Missing(String),
    #[error("a name has 1 to {NAME_CHARS} letters, digits, '.', '_' and '-'")]
    Name,
    #[error("there is a target '{0}' already; remove it first, or choose another name")]
    Taken(String),
    #[error("there is no target '{0}'; 'rosaline webhooks list' shows what there is")]
    Unknown(String),
    #[error("the old secret would be valid for thousands of years; give a shorter --overlap")]
    Overlap,
    #[error("the system gives no random numbers: {0}")]
    Random(getrandom::Error),
}

/// Somebody whom the service tells of the ends of jobs.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Target {
    pub name: String,
    pub url: Url,
    /// What its messages are signed with.
    pub secret: Secret,
    /// The secret before, with which they are signed as well until its time is up.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub former: Option<Former>,
    pub events: Vec<Event>,
    /// Only jobs of this principal; everybody's where there is none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub owner: Option<String>,
}

/// A secret that was replaced.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Former {
    secret: Secret,
    #[serde(with = "time::serde::rfc3339")]
    until: OffsetDateTime,
}

impl Target {
    /// The header `webhook-signature` of a message that is sent at this second: while a secret is exchanged a signature by
    /// each, with a space between (Standard Webhooks, "Signature scheme" and "Secret rotation").
    pub(super) fn sign(&self, id: &str, timestamp: i64, body: &str) -> String {
        let former = self.former.as_ref().filter(|former| timestamp < former.until.unix_timestamp());
        let secrets = std::iter::once(&self.secret).chain(former.map(|former| &former.secret));
        secrets.map(|secret| secret.sign(id, timestamp, body)).collect::<Vec<_>>().join(" ")
    }
}

/// An end of a job, as it is named in messages.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Event {
    #[serde(rename = "job.successful")]
    Successful,
    #[serde(rename = "job.failed")]
    Failed,
    #[serde(rename = "job.dismissed")]
    Dismissed,
}

impl Event {
    pub const ALL: [Event; 3] = [Event::Successful, Event::Failed, Event::Dismissed];

    pub fn status(self) -> JobStatus {
        match self {
            Event::Successful => JobStatus::Successful,
            Event::Failed => JobStatus::Failed,
            Event::Dismissed => JobStatus::Dismissed,
        }
    }
}

/// A word that names no [`Event`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("an event is successful, failed or dismissed")]
pub struct UnknownEvent;

impl std::str::FromStr for Event {
    type Err = UnknownEvent;

    /// With or without `job.` before it.
    fn from_str(text: &str) -> Result<Self, UnknownEvent> {
        let word = text.strip_prefix("job.").unwrap_or(text);
        Event::ALL.into_iter().find(|event| event.status().name() == word).ok_or(UnknownEvent)
    }
}

impl From<&Target> for Listener {
    fn from(target: &Target) -> Self {
        let ends = target.events.iter().map(|event| event.status()).collect();
        Self { name: target.name.clone(), owner: target.owner.clone(), ends }
    }
}

#[derive(Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Kept {
    targets: Vec<Target>,
}

/// The webhook file.
#[derive(Debug, Clone)]
pub struct TargetFile {
    path: PathBuf,
    must_exist: bool,
}

impl TargetFile {
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

    /// The targets; none where there is no file.
    pub fn list(&self) -> Result<Vec<Target>, TargetError> {
        Ok(self.read()?.unwrap_or_default())
    }

    /// The same as [`TargetFile::read`], off the async threads.
    pub(super) async fn read_aside(&self) -> Result<Option<Vec<Target>>, TargetError> {
        let file = self.clone();
        let read = tokio::task::spawn_blocking(move || file.read()).await;
        read.unwrap_or_else(|error| Err(self.failed(io::Error::other(error))))
    }

    /// The targets; `None` where there is no file. Blocks.
    ///
    /// # Errors
    /// [`TargetError::Missing`] where there is none although it was named.
    pub fn read(&self) -> Result<Option<Vec<Target>>, TargetError> {
        self.parsed(operator_file::read(&self.path))
    }

    fn parsed(&self, read: io::Result<Vec<u8>>) -> Result<Option<Vec<Target>>, TargetError> {
        let text = match read {
            Ok(text) => text,
            Err(error) if error.kind() == io::ErrorKind::NotFound && self.must_exist => {
                return Err(self.missing());
            }
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
            Err(source) => return Err(self.failed(source)),
        };
        let damaged = |detail: String| TargetError::Damaged { path: self.path.display().to_string(), detail };
        let kept: Kept = serde_json::from_slice(&text).map_err(|error| damaged(error.to_string()))?;
        let mut names = HashSet::new();
        for Target { name, .. } in &kept.targets {
            check_name(name)?;
            if !names.insert(name) {
                return Err(damaged(format!("'{name}' is there twice")));
            }
        }
        Ok(Some(kept.targets))
    }

    /// That it is not there.
    pub fn missing(&self) -> TargetError {
        TargetError::Missing(self.path.display().to_string())
    }

    /// Adds a target with a new secret; the secret's text.
    pub fn add(
        &self,
        name: &str,
        url: Url,
        events: &[Event],
        owner: Option<String>,
    ) -> Result<String, TargetError> {
        check_name(name)?;
        let secret = Secret::random().map_err(TargetError::Random)?;
        let text = secret.expose();
        self.change(|targets| {
            if targets.iter().any(|target| target.name == name) {
                return Err(TargetError::Taken(name.to_owned()));
            }
            let (name, events) = (name.to_owned(), events.to_vec());
            targets.push(Target { name, url, secret, former: None, events, owner });
            Ok(())
        })?;
        Ok(text)
    }

    pub fn remove(&self, name: &str) -> Result<(), TargetError> {
        self.change(|targets| {
            let place = targets.iter().position(|target| target.name == name);
            targets.remove(place.ok_or_else(|| TargetError::Unknown(name.to_owned()))?);
            Ok(())
        })
    }

    /// Gives a target a new secret; the old one's signature goes with messages for `overlap` from now on. The new one's
    /// text.
    pub fn rotate(&self, name: &str, overlap: Duration) -> Result<String, TargetError> {
        let secret = Secret::random().map_err(TargetError::Random)?;
        let text = secret.expose();
        self.change(|targets| {
            let target = targets.iter_mut().find(|target| target.name == name);
            let target = target.ok_or_else(|| TargetError::Unknown(name.to_owned()))?;
            let seconds = i64::try_from(overlap.as_secs()).unwrap_or(i64::MAX);
            let until = OffsetDateTime::now_utc().checked_add(time::Duration::seconds(seconds));
            let until = until.ok_or(TargetError::Overlap)?;
            let former = std::mem::replace(&mut target.secret, secret);
            target.former = (seconds > 0).then_some(Former { secret: former, until });
            Ok(())
        })?;
        Ok(text)
    }

    fn change(
        &self,
        change: impl FnOnce(&mut Vec<Target>) -> Result<(), TargetError>,
    ) -> Result<(), TargetError> {
        if self.must_exist {
            // Before a lock is made beside it.
            self.read()?;
        }
        let file = operator_file::Change::begin(&self.path).map_err(|source| self.failed(source))?;
        let mut targets = self.parsed(file.read())?.unwrap_or_default();
        change(&mut targets)?;
        let text = serde_json::to_vec_pretty(&Kept { targets }).map_err(|error| self.failed(error.into()))?;
        file.replace(&text).map_err(|source| self.failed(source))
    }

    fn failed(&self, source: io::Error) -> TargetError {
        TargetError::Io { path: self.path.display().to_string(), source }
    }
}

fn check_name(name: &str) -> Result<(), TargetError> {
    let fits = |byte: u8| byte.is_ascii_alphanumeric() || b"._-".contains(&byte);
    if (1..=NAME_CHARS).contains(&name.len()) && name.bytes().all(fits) {
        Ok(())
    } else {
        Err(TargetError::Name)
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn targets_are_added_and_removed_and_a_damaged_file_is_told() {
        let dir = tempfile::tempdir().unwrap();
        let file = TargetFile::new(dir.path().join("webhooks.json"));
        assert!(file.list().unwrap().is_empty());
        let url: Url = "https://pacs.example/hooks".parse().unwrap();
        let secret = file.add("pacs", url.clone(), &Event::ALL, Some("pacs".to_owned())).unwrap();
        let other = file.add("viewer", url.clone(), &[Event::Failed], None).unwrap();
        assert_ne!(secret, other);
        assert!(matches!(file.add("pacs", url.clone(), &Event::ALL, None), Err(TargetError::Taken(_))));
        for name in ["", "a b", "ä", &"x".repeat(65)] {
            assert!(
                matches!(file.add(name, url.clone(), &Event::ALL, None), Err(TargetError::Name)),
                "{name}"
            );
        }
        let targets = file.list().unwrap();
        assert_eq!((targets.len(), targets[0].secret.expose()), (2, secret.clone()));
        assert_eq!(Listener::from(&targets[1]).ends, [JobStatus::Failed]);
        #[cfg(unix)]
        assert_eq!(std::os::unix::fs::MetadataExt::mode(&fs::metadata(file.path()).unwrap()) & 0o777, 0o600);
        let minute = Duration::from_secs(60);
        let renewed = file.rotate("pacs", minute).unwrap();
        let target = file.list().unwrap().remove(0);
        assert_eq!(target.secret.expose(), renewed);
        let now = OffsetDateTime::now_utc().unix_timestamp();
        let by = |text: &str, at| Secret::try_from(text.to_owned()).unwrap().sign("a", at, "b");
        assert_eq!(target.sign("a", now, "b"), format!("{} {}", by(&renewed, now), by(&secret, now)));
        assert_eq!(target.sign("a", now + 61, "b"), by(&renewed, now + 61), "its time is up");
        // A second exchange leaves the last two, and one without an overlap the new one alone.
        let third = file.rotate("pacs", minute).unwrap();
        let target = file.list().unwrap().remove(0);
        assert_eq!(target.sign("a", now, "b"), format!("{} {}", by(&third, now), by(&renewed, now)));
        let fourth = file.rotate("pacs", Duration::ZERO).unwrap();
        assert_eq!(file.list().unwrap()[0].sign("a", now, "b"), by(&fourth, now));
        assert!(matches!(file.rotate("pacs", Duration::MAX), Err(TargetError::Overlap)));
        assert!(matches!(file.rotate("x", minute), Err(TargetError::Unknown(_))));
        file.remove("pacs").unwrap();
        assert!(matches!(file.remove("pacs"), Err(TargetError::Unknown(_))));
        let whole = fs::read_to_string(file.path()).unwrap();
        for (from, to) in [
            ("{", ""),
            ("https", "ftp"),
            ("whsec_", ""),
            ("job.failed", "job.begun"),
            ("\"name\"", "\"nome\""),
        ] {
            fs::write(file.path(), whole.replacen(from, to, 1)).unwrap();
            assert!(matches!(file.list(), Err(TargetError::Damaged { .. })), "{from}");
        }
    }
}
