//! Time-ordered job ids.

use std::fmt;
use std::str::FromStr;
use std::sync::{Arc, Mutex, PoisonError};

use serde::{Deserialize, Serialize};
use uuid::{ContextV7, Timestamp, Uuid};

use super::Clock;

/// A job's id: a UUID version 7 (RFC 9562, section 5.7). Its text form sorts by age.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct JobId(Uuid);

impl JobId {
    pub fn as_uuid(self) -> Uuid {
        self.0
    }

    /// The milliseconds since the epoch that the id carries.
    pub(super) fn millis(self) -> u64 {
        let (seconds, nanos) = self.0.get_timestamp().map_or((0, 0), |stamp| stamp.to_unix());
        seconds * 1000 + u64::from(nanos / 1_000_000)
    }
}

impl fmt::Display for JobId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.hyphenated().fmt(f)
    }
}

/// Text that is not a job id.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("this is not a job id; a job id is a UUID version 7 in lower-case hyphenated form")]
pub struct ParseJobIdError;

impl FromStr for JobId {
    type Err = ParseJobIdError;

    /// Takes the canonical form only, so that a job has one URL.
    fn from_str(text: &str) -> Result<Self, ParseJobIdError> {
        let id = Uuid::try_parse(text).map_err(|_| ParseJobIdError)?;
        let id = if id.get_version_num() == 7 { JobId(id) } else { return Err(ParseJobIdError) };
        if id.to_string() == text { Ok(id) } else { Err(ParseJobIdError) }
    }
}

/// Makes ids that only ever grow, also when the clock goes back.
pub struct IdSource {
    clock: Arc<dyn Clock>,
    state: Mutex<(u64, ContextV7)>,
}

impl IdSource {
    /// Every id made is newer than `newest`, the newest one in the store.
    pub fn new(clock: Arc<dyn Clock>, newest: Option<JobId>) -> Self {
        let floor = newest.map_or(0, |id| id.millis() + 1);
        Self { clock, state: Mutex::new((floor, ContextV7::new())) }
    }

    pub fn next(&self) -> JobId {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        state.0 = state.0.max(u64::try_from(self.clock.now_ms()).unwrap_or(0));
        let (seconds, rest) = (state.0 / 1000, state.0 % 1000);
        let nanos = u32::try_from(rest * 1_000_000).unwrap_or(0);
        JobId(Uuid::new_v7(Timestamp::from_unix(&state.1, seconds, nanos)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::jobs::ManualClock;

    #[test]
    fn ids_grow_although_the_clock_goes_back() {
        let clock = Arc::new(ManualClock::new(1_700_000_000_000));
        let ids = IdSource::new(clock.clone(), None);
        let mut last = ids.next();
        for step in 0..5000 {
            clock.set(1_700_000_000_000 - step * 10);
            let id = ids.next();
            assert!(id > last && id.to_string() > last.to_string());
            last = id;
        }
        let next = IdSource::new(clock, Some(last)).next();
        assert!(next > last, "an id after a restart is newer than those in the store");
    }

    #[test]
    fn only_the_canonical_form_is_an_id() {
        let id = IdSource::new(Arc::new(ManualClock::new(1)), None).next();
        assert_eq!(id.to_string().parse(), Ok(id));
        let upper = id.to_string().to_uppercase();
        let simple = id.as_uuid().simple().to_string();
        let v4 = "936da01f-9abd-4d9d-80c7-02af85c822a8".to_owned();
        for text in [upper, simple, v4, String::new(), "../../etc/passwd".to_owned()] {
            assert_eq!(text.parse::<JobId>(), Err(ParseJobIdError), "{text}");
        }
    }
}
