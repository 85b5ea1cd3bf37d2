//! `Idempotency-Key` (IETF draft-ietf-httpapi-idempotency-key-header): a request that is sent again makes no second
//! job.

use std::collections::HashSet;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use axum::http::{HeaderMap, HeaderName, header};
use sha2::{Digest, Sha256};

use super::problem::{IDEMPOTENCY_IN_FLIGHT, IDEMPOTENCY_KEY_REUSED, INVALID_PARAMETER, Problem};
use crate::jobs::{Idempotency, Job, JobSpec, Priority};

pub const IDEMPOTENCY_KEY: HeaderName = HeaderName::from_static("idempotency-key");

/// What a key looks like, with or without the quotes of a structured field.
pub const KEY_PATTERN: &str = "^\"?[A-Za-z0-9._:-]{1,128}\"?$";
const KEY_CHARS: usize = 128;

/// The keys of requests under way; clones share them.
#[derive(Clone, Default)]
pub struct InFlight(Arc<Mutex<HashSet<String>>>);

/// A request's hold on its key; dropping it gives the key free.
pub struct Claim {
    key: String,
    others: InFlight,
}

impl InFlight {
    fn keys(&self) -> MutexGuard<'_, HashSet<String>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The hold on the request's key, if it has one.
    ///
    /// # Errors
    /// 400 when the header is no key, 409 while another request with this key is under way.
    pub fn claim(&self, headers: &HeaderMap, owner: Option<&str>) -> Result<Option<Claim>, Problem> {
        let Some(key) = key(headers)? else { return Ok(None) };
        // Two principals may use one key; neither a name nor a key has a slash.
        let key = owner.map_or(key.clone(), |owner| format!("{owner}/{key}"));
        if !self.keys().insert(key.clone()) {
            return Err(in_flight());
        }
        Ok(Some(Claim { key, others: self.clone() }))
    }
}

impl Claim {
    /// What the job is remembered by: its key, and everything of the request that the job depends on.
    pub fn of(&self, spec: &JobSpec, sha256: &str) -> Idempotency {
        let name = spec.name.as_ref().map(|name| name.expose());
        let told = (sha256, name, spec.units.name(), &spec.parameters, spec.origin.client_reference.as_ref());
        // Strings and numbers always serialise.
        let mut text = serde_json::to_vec(&told).unwrap_or_default();
        // Requests that say nothing of it keep the fingerprint that they had before there were priorities.
        if spec.priority != Priority::default() {
            text.extend_from_slice(spec.priority.name().as_bytes());
        }
        let fingerprint = Sha256::digest(text).iter().map(|byte| format!("{byte:02x}")).collect();
        Idempotency { key: self.key.clone(), fingerprint }
    }
}

impl Drop for Claim {
    fn drop(&mut self) {
        self.others.keys().remove(&self.key);
    }
}

/// The job that the key's first request made, if this request is the same.
///
/// # Errors
/// 422 when it is another one.
pub fn first(job: Job, asked: &Idempotency) -> Result<Job, Problem> {
    if job.spec.idempotency.as_ref() == Some(asked) {
        return Ok(job);
    }
    let detail = "this key came with another mesh or other parameters before; use a new key for a new job";
    Err(Problem::new(&IDEMPOTENCY_KEY_REUSED, detail).about(job.id))
}

pub fn in_flight() -> Problem {
    let detail = "a request with this key is under way; send yours again once that one is answered";
    Problem::new(&IDEMPOTENCY_IN_FLIGHT, detail).header(header::RETRY_AFTER, 1)
}

fn key(headers: &HeaderMap) -> Result<Option<String>, Problem> {
    let mut values = headers.get_all(&IDEMPOTENCY_KEY).iter();
    let Some(value) = values.next() else { return Ok(None) };
    if values.next().is_some() {
        let detail = "the request has two keys; send one";
        return Err(Problem::new(&INVALID_PARAMETER, detail).with("parameter", IDEMPOTENCY_KEY.as_str()));
    }
    let text = value.to_str().unwrap_or_default();
    let key = text.strip_prefix('"').unwrap_or(text);
    let key = key.strip_suffix('"').unwrap_or(key);
    let fits = |byte: u8| byte.is_ascii_alphanumeric() || b"._:-".contains(&byte);
    if key.is_empty() || key.len() > KEY_CHARS || !key.bytes().all(fits) {
        let detail =
            format!("a key has 1 to {KEY_CHARS} letters, digits, '.', '_', ':' and '-'; a UUID is good");
        return Err(Problem::new(&INVALID_PARAMETER, detail).with("parameter", IDEMPOTENCY_KEY.as_str()));
    }
    Ok(Some(key.to_owned()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn headers(value: &str) -> HeaderMap {
        HeaderMap::from_iter([(IDEMPOTENCY_KEY, value.parse().unwrap())])
    }

    #[test]
    fn a_key_is_held_by_one_request_at_a_time() {
        let keys = InFlight::default();
        let first = keys.claim(&headers("a-1"), None).unwrap();
        assert_eq!(
            keys.claim(&headers("\"a-1\""), None).err().map(|problem| problem.status().as_u16()),
            Some(409)
        );
        assert!(keys.claim(&headers("a-2"), None).unwrap().is_some());
        assert!(keys.claim(&headers("a-1"), Some("pacs")).unwrap().is_some(), "another's");
        drop(first);
        assert!(keys.claim(&headers("a-1"), None).unwrap().is_some());
        assert!(keys.claim(&HeaderMap::new(), None).unwrap().is_none());
    }

    #[test]
    fn what_is_no_key_is_refused() {
        for value in ["", "\"\"", "a b", "ä", "a,b", &"x".repeat(129)] {
            assert!(key(&headers(value)).is_err(), "{value}");
        }
        assert_eq!(key(&headers(&"x".repeat(128))).unwrap().unwrap().len(), 128);
        let mut two = headers("a");
        two.append(IDEMPOTENCY_KEY, "a".parse().unwrap());
        assert!(key(&two).is_err());
    }
}
