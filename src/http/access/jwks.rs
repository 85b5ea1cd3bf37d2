//! The public keys of a token issuer (RFC 7517), from a file or a URL of the operator's, or from where the issuer says.

use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::{Arc, PoisonError, RwLock};
use std::time::{Duration, Instant};

use jsonwebtoken::{Algorithm, DecodingKey};
use tokio::sync::Mutex;
use tokio_util::sync::CancellationToken;

use super::broken::Broken;
use super::discovery::DiscoveryError;
use super::fetching::Way;
use super::key_set::{PublicKey, parse};
use crate::jobs::operator_file::{self, Stamp, stamp};
use crate::outbound::{OutboundError, Url};

/// How often the keys at a URL are fetched again, and how soon after a failure.
const REFRESH: Duration = Duration::from_secs(5 * 60);
const RETRY: Duration = Duration::from_secs(10);
/// Of tokens with an unknown key, one in this long makes the keys be fetched: strangers must not make the service ask
/// its issuer as often as they like.
const ASK: Duration = Duration::from_secs(5);
/// Keys that could not be fetched again for this long are no longer trusted: one may have been withdrawn.
const STALE: Duration = Duration::from_secs(24 * 60 * 60);

/// Why there are no keys.
#[derive(Debug, thiserror::Error)]
pub enum JwksError {
    #[error("the key set {path} cannot be read: {source}")]
    Io { path: String, source: std::io::Error },
    #[error("the key set cannot be fetched: {0}")]
    Fetch(#[from] OutboundError),
    #[error("the key set cannot be found: {0}")]
    Discovery(#[from] DiscoveryError),
    #[error("the key set is damaged: {0}; it is a JSON object with a list 'keys' (RFC 7517, section 5)")]
    Damaged(String),
    #[error("the key set has no public key for signatures by RSA, ECDSA or EdDSA")]
    Empty,
}

/// Where the keys are, where the operator says it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum JwksSource {
    File(PathBuf),
    Url(Url),
}

impl JwksSource {
    /// Whether the keys cross a network in the clear.
    pub fn is_in_the_clear(&self) -> bool {
        matches!(self, Self::Url(url) if url.is_in_the_clear())
    }
}

impl FromStr for JwksSource {
    type Err = OutboundError;

    /// Whatever has a scheme is a URL.
    fn from_str(text: &str) -> Result<Self, OutboundError> {
        if text.contains("://") { Ok(Self::Url(text.parse()?)) } else { Ok(Self::File(text.into())) }
    }
}

/// The keys in force.
pub(super) struct Jwks {
    source: Place,
    state: RwLock<State>,
    /// Held from the look at a file until what it held is noted: nothing older comes in place of something newer.
    turn: std::sync::Mutex<()>,
}

enum Place {
    File(PathBuf),
    Away {
        way: Box<Way>,
        /// When an unknown key last made the keys be fetched. Held meanwhile: those that come then wait for it.
        asked: Arc<Mutex<Option<Instant>>>,
    },
}

#[derive(Default)]
struct State {
    keys: Vec<PublicKey>,
    stamp: Stamp,
    fetched: Option<Instant>,
    /// Of a file that cannot be used now: it is tried again, also when it has not changed.
    broken: Option<Broken>,
}

impl State {
    fn is_there(&self, source: &Place, now: Instant) -> bool {
        match source {
            Place::File(_) => self.broken.is_none(),
            Place::Away { .. } => {
                self.fetched.is_some_and(|fetched| now.saturating_duration_since(fetched) <= STALE)
            }
        }
    }
}

/// There are no keys that a token could be checked with: the file cannot be used, or they were not fetched for too long.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct NoKeys;

impl Jwks {
    /// The keys of a file are read at once; others come with the first fetch of [`Jwks::follow`], so that a service starts
    /// also while its issuer is away. Without a `source` the issuer of this name is asked where they are.
    ///
    /// # Errors
    /// When the file cannot be used, the issuer's name is no address to ask, or no client can be made.
    pub(super) fn open(source: Option<JwksSource>, issuer: &str) -> Result<Self, JwksError> {
        let away = |way| (Place::Away { way: Box::new(way), asked: Arc::default() }, State::default());
        let (source, state) = match source {
            Some(JwksSource::File(path)) => {
                let stamp = stamp(&path);
                let keys = read(&path)?;
                (Place::File(path), State { keys, stamp, ..State::default() })
            }
            Some(JwksSource::Url(url)) => away(Way::to(url)?),
            None => away(Way::by(issuer)?),
        };
        Ok(Self { source, state: RwLock::new(state), turn: std::sync::Mutex::default() })
    }

    /// The key for a token that names `id` and `algorithm`, if there is one; without an id, the only one of the set that
    /// fits.
    ///
    /// # Errors
    /// [`NoKeys`] where that is not known.
    pub(super) async fn find(
        self: &Arc<Self>,
        id: Option<&str>,
        algorithm: Algorithm,
    ) -> Result<Option<DecodingKey>, NoKeys> {
        if let Place::File(path) = &self.source {
            self.renew(path);
        }
        let Place::Away { asked, .. } = &self.source else { return self.known(id, algorithm) };
        if let Ok(Some(key)) = self.known(id, algorithm) {
            return Ok(Some(key));
        }
        let mut asked = asked.clone().lock_owned().await;
        if asked.is_none_or(|asked| asked.elapsed() >= ASK) {
            *asked = Some(Instant::now());
            let keys = self.clone();
            // A task of its own, which holds the lock: a client that hangs up neither breaks the fetch off nor frees the
            // way to the next one. What comes of it is logged.
            let fetched = tokio::spawn(async move {
                keys.fetch().await;
                drop(asked);
            });
            fetched.await.ok();
        }
        self.known(id, algorithm)
    }

    /// Whether there are keys that a token can be checked with at `now`.
    fn is_there(&self, now: Instant) -> bool {
        self.state.read().unwrap_or_else(PoisonError::into_inner).is_there(&self.source, now)
    }

    /// Whether one may fit: an issuer may have withdrawn all of them.
    pub(super) fn has_keys(&self, now: Instant) -> bool {
        let state = self.state.read().unwrap_or_else(PoisonError::into_inner);
        state.is_there(&self.source, now) && !state.keys.is_empty()
    }

    fn known(&self, id: Option<&str>, algorithm: Algorithm) -> Result<Option<DecodingKey>, NoKeys> {
        let state = self.state.read().unwrap_or_else(PoisonError::into_inner);
        if !state.is_there(&self.source, Instant::now()) {
            return Err(NoKeys);
        }
        let fits = |key: &&PublicKey| {
            key.key.family() == algorithm.family() && key.algorithm.is_none_or(|only| only == algorithm)
        };
        let mut fitting = state.keys.iter().filter(fits);
        let found = match id {
            Some(id) => fitting.find(|key| key.id.as_deref() == Some(id)),
            None => fitting.next().filter(|_| fitting.next().is_none()),
        };
        Ok(found.map(|key| key.key.clone()))
    }

    /// Whether the keys can be read where they are in a file: also one that has not changed since it could be. What is found
    /// counts for the next token, so that readiness and the tokens say the same. Blocks.
    ///
    /// # Errors
    /// [`JwksError`] where they cannot.
    pub(super) fn check(&self) -> Result<(), JwksError> {
        match &self.source {
            Place::File(path) => {
                let _turn = self.turn.lock().unwrap_or_else(PoisonError::into_inner);
                self.read_again(path, stamp(path))
            }
            Place::Away { .. } => Ok(()),
        }
    }

    fn renew(&self, path: &Path) {
        if self.is_known(stamp(path)) {
            return;
        }
        let _turn = self.turn.lock().unwrap_or_else(PoisonError::into_inner);
        let stamp = stamp(path);
        // Of those that waited one reads it.
        if !self.is_known(stamp) {
            // Noted and logged.
            self.read_again(path, stamp).ok();
        }
    }

    fn is_known(&self, stamp: Stamp) -> bool {
        let state = self.state.read().unwrap_or_else(PoisonError::into_inner);
        state.stamp == stamp && !state.broken.as_ref().is_some_and(Broken::is_due)
    }

    /// Reads a file again, in its turn; `stamp` is that of before. One that cannot be used lets nobody in, as a key may
    /// have been withdrawn, and is tried again.
    fn read_again(&self, path: &Path, stamp: Stamp) -> Result<(), JwksError> {
        let found = read(path);
        let mut state = self.state.write().unwrap_or_else(PoisonError::into_inner);
        state.stamp = stamp;
        match found {
            Ok(keys) => {
                (state.keys, state.broken) = (keys, None);
                Ok(())
            }
            Err(error) => {
                state.keys = Vec::new();
                // Once for each reason, not at each token.
                if Broken::note(&mut state.broken, error.to_string()) {
                    tracing::error!(%error, "no token is let in");
                }
                Err(error)
            }
        }
    }

    /// Whether the keys were fetched. An answer that is no key set takes none away: that it was sent by the issuer is not
    /// known, and a key that was withdrawn is gone with the next good answer, or after [`STALE`]. A set without a key, or
    /// with others alone, is a good answer, by which all are withdrawn.
    async fn fetch(&self) -> bool {
        let Place::Away { way, .. } = &self.source else { return true };
        let keys = match way.text().await.and_then(|text| parse(&text)) {
            Ok(keys) => keys,
            Err(error @ JwksError::Empty) if self.has_keys(Instant::now()) => {
                tracing::error!(%error, "the issuer has withdrawn its keys: no token is let in until it has another");
                Vec::new()
            }
            Err(error @ JwksError::Empty) => {
                tracing::error!(%error, "the issuer has no keys: no token is let in until it has one");
                Vec::new()
            }
            Err(error) if self.is_there(Instant::now()) => {
                tracing::error!(%error, "the issuer's keys stay those known before, for a day at most");
                return false;
            }
            Err(error) => {
                tracing::error!(%error, "no keys of the issuer are known: no token is let in until they come");
                return false;
            }
        };
        let mut state = self.state.write().unwrap_or_else(PoisonError::into_inner);
        *state = State { keys, fetched: Some(Instant::now()), ..State::default() };
        true
    }

    /// Fetches keys that are in no file again and again, until `closing`.
    pub(super) async fn follow(&self, closing: CancellationToken) {
        while let Place::Away { .. } = self.source {
            let pause = if self.fetch().await { REFRESH } else { RETRY };
            tokio::select! {
                () = tokio::time::sleep(pause) => {}
                () = closing.cancelled() => return,
            }
        }
    }
}

fn read(path: &Path) -> Result<Vec<PublicKey>, JwksError> {
    let text = operator_file::read(path);
    parse(&text.map_err(|source| JwksError::Io { path: path.display().to_string(), source })?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_that_were_fetched_are_trusted_for_a_day() {
        let source = "http://127.0.0.1:9/keys".parse().unwrap();
        let jwks = Jwks::open(Some(source), "https://login.example").unwrap();
        let now = Instant::now();
        assert!(!jwks.is_there(now), "none came yet");
        jwks.state.write().unwrap().fetched = Some(now);
        assert!(jwks.is_there(now) && jwks.is_there(now + STALE));
        assert!(!jwks.is_there(now + STALE + Duration::from_secs(1)));
    }
}
