//! How soon a job should run.

use std::str::FromStr;

/// How soon a job should run.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Priority {
    #[default]
    Normal,
    /// Before every normal job that did not come well before it.
    Urgent,
}

/// Milliseconds that an urgent job is taken for older than it is. A normal job that has waited this long goes before
/// urgent ones that come after: however many those are, it is not passed over for ever.
const HEAD_START_MS: i64 = 10 * 60 * 1000;

impl Priority {
    pub const ALL: [Priority; 2] = [Priority::Normal, Priority::Urgent];

    /// The word in the API and the store.
    pub fn name(self) -> &'static str {
        match self {
            Priority::Normal => "normal",
            Priority::Urgent => "urgent",
        }
    }

    /// The job's place among those that wait, of which the lowest is next, if it came at `millis`.
    pub(super) fn turn(self, millis: i64) -> i64 {
        match self {
            Priority::Normal => millis,
            Priority::Urgent => millis.saturating_sub(HEAD_START_MS),
        }
    }
}

/// A word that is none of [`Priority`]'s names.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("this is not a priority; use normal or urgent")]
pub struct UnknownPriority;

impl FromStr for Priority {
    type Err = UnknownPriority;

    fn from_str(text: &str) -> Result<Self, UnknownPriority> {
        Priority::ALL.into_iter().find(|priority| priority.name() == text).ok_or(UnknownPriority)
    }
}
