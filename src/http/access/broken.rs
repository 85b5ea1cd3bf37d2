//! A file that cannot be used now: it is tried again, and its fault is told once.

use std::time::{Duration, Instant};

/// How soon such a file is read again that looks as it did: its disk may only have been unreadable for a moment.
const RETRY: Duration = Duration::from_secs(1);

/// Why a file could not be used, and when that was last tried.
#[derive(Debug)]
pub(super) struct Broken {
    reason: String,
    tried: Instant,
}

impl Broken {
    /// Notes in `place` that a file could not be used just now; whether the reason is another than before.
    pub(super) fn note(place: &mut Option<Self>, reason: String) -> bool {
        let is_new = place.as_ref().is_none_or(|before| before.reason != reason);
        *place = Some(Self { reason, tried: Instant::now() });
        is_new
    }

    /// Whether it is to be tried again.
    pub(super) fn is_due(&self) -> bool {
        self.tried.elapsed() >= RETRY
    }
}
