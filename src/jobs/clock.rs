//! Wall-clock time, injected so that tests can move it.

use std::sync::atomic::{AtomicI64, Ordering};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

/// Where the queue reads wall-clock time.
pub trait Clock: Send + Sync + 'static {
    /// Milliseconds since 1970-01-01T00:00:00Z.
    fn now_ms(&self) -> i64;
}

/// The system's clock.
#[derive(Debug, Clone, Copy, Default)]
pub struct SystemClock;

impl Clock for SystemClock {
    fn now_ms(&self) -> i64 {
        let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        i64::try_from(since.as_millis()).unwrap_or(i64::MAX)
    }
}

/// A clock that stands until it is set; may be set backwards.
#[derive(Debug, Default)]
pub struct ManualClock(AtomicI64);

impl ManualClock {
    pub fn new(now_ms: i64) -> Self {
        Self(AtomicI64::new(now_ms))
    }

    pub fn set(&self, now_ms: i64) {
        self.0.store(now_ms, Ordering::SeqCst);
    }

    pub fn advance(&self, ms: i64) {
        self.0.fetch_add(ms, Ordering::SeqCst);
    }
}

impl Clock for ManualClock {
    fn now_ms(&self) -> i64 {
        self.0.load(Ordering::SeqCst)
    }
}

/// How far the clock may differ from the time that has passed before it is doubted.
const LEAP: Duration = Duration::from_secs(10 * 60);
/// How long a clock that has leapt is doubted.
const DOUBT: Duration = Duration::from_secs(24 * 60 * 60);

/// Tells a clock that was set from time that has passed: nothing should be removed for its age because of it.
pub(super) struct Steadiness {
    /// The clock and the passed time when they last went together.
    last: (i64, Instant),
    /// Since when they do not.
    leapt: Option<Instant>,
}

impl Steadiness {
    pub(super) fn new(now_ms: i64, at: Instant) -> Self {
        Self { last: (now_ms, at), leapt: None }
    }

    /// Whether the clock went on as time did. One that was set, ahead or back, is believed when it has kept to that for
    /// a day, or when it is where it should be again.
    pub(super) fn holds(&mut self, now_ms: i64, at: Instant) -> bool {
        let milliseconds = |span: Duration| i64::try_from(span.as_millis()).unwrap_or(i64::MAX);
        let passed = milliseconds(at.saturating_duration_since(self.last.1));
        let expected = self.last.0.saturating_add(passed);
        if now_ms.abs_diff(expected) > milliseconds(LEAP).unsigned_abs() {
            let since = *self.leapt.get_or_insert_with(|| {
                tracing::warn!("the clock was set; nothing is removed for its age for a day");
                at
            });
            if at.saturating_duration_since(since) < DOUBT {
                return false;
            }
        }
        (self.last, self.leapt) = ((now_ms, at), None);
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_clock_that_is_set_is_doubted_for_a_day() {
        const DAY: i64 = 86_400_000;
        let start = Instant::now();
        let at = |hours: u64| start + Duration::from_secs(hours * 3600);
        let hour = |hours: i64| hours * 3_600_000;
        let mut clock = Steadiness::new(0, start);
        assert!(clock.holds(hour(1), at(1)) && clock.holds(hour(2) + 500_000, at(2)), "small steps are none");
        assert!(!clock.holds(hour(3) + 365 * DAY, at(3)) && !clock.holds(hour(26) + 365 * DAY, at(26)));
        assert!(clock.holds(hour(27) + 365 * DAY, at(27)), "a day later it is believed");
        assert!(!clock.holds(hour(28) - 365 * DAY, at(28)), "backward");
        assert!(clock.holds(hour(29) + 365 * DAY, at(29)), "it is back");
    }
}
