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
/// How long no job may have come before a start: a clock that says more is doubted.
pub(super) const SILENCE: Duration = Duration::from_secs(7 * 24 * 60 * 60);

/// Why a clock is doubted: nothing is removed for its age meanwhile.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Doubt {
    #[error("the clock was set while the service ran; nothing is removed for its age for a day")]
    Set,
    #[error(
        "the clock is {0} minutes behind the newest job; set it: nothing is removed for its age until it is right, or for a day"
    )]
    Behind(i64),
    #[error(
        "by the clock no job came for {0} days; set it if that is wrong: nothing is removed for its age until it is right, or \
         for a day"
    )]
    Ahead(i64),
}

/// Tells a clock that was set from time that has passed: nothing should be removed for its age because of it.
pub(super) struct Steadiness {
    /// The clock and the passed time when they last went together.
    last: (i64, Instant),
    /// Since when they do not.
    leapt: Option<Instant>,
    /// When the service started, and when the newest job came by the clock of then; until the clock is believed.
    start: Option<(Instant, i64)>,
}

fn milliseconds(span: Duration) -> i64 {
    i64::try_from(span.as_millis()).unwrap_or(i64::MAX)
}

impl Steadiness {
    /// `newest` is when the newest job came that was there before the start.
    pub(super) fn new(now_ms: i64, newest: Option<i64>, at: Instant) -> Self {
        Self { last: (now_ms, at), leapt: None, start: newest.map(|newest| (at, newest)) }
    }

    /// Whether the clock goes on from the newest job, and went on as time did since the start. One that does not is
    /// believed when it has kept to that for a day, or when it is where it should be again.
    ///
    /// # Errors
    /// Why it is doubted.
    pub(super) fn holds(&mut self, now_ms: i64, at: Instant) -> Result<(), Doubt> {
        if let Some((since, newest)) = self.start {
            let passed = at.saturating_duration_since(since);
            let ahead = now_ms.saturating_sub(newest);
            let doubt = if ahead < -milliseconds(LEAP) {
                Doubt::Behind(-ahead / 60_000)
            } else {
                Doubt::Ahead(ahead / 86_400_000)
            };
            let fits =
                matches!(doubt, Doubt::Ahead(_)) && ahead <= milliseconds(SILENCE.saturating_add(passed));
            if !fits && passed < DOUBT {
                return Err(doubt);
            }
            (self.start, self.last, self.leapt) = (None, (now_ms, at), None);
        }
        let passed = milliseconds(at.saturating_duration_since(self.last.1));
        let expected = self.last.0.saturating_add(passed);
        if now_ms.abs_diff(expected) > milliseconds(LEAP).unsigned_abs() {
            let since = *self.leapt.get_or_insert(at);
            if at.saturating_duration_since(since) < DOUBT {
                return Err(Doubt::Set);
            }
        }
        (self.last, self.leapt) = ((now_ms, at), None);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HOUR: i64 = 3_600_000;
    const DAY: i64 = 24 * HOUR;

    #[test]
    fn a_clock_that_is_set_is_doubted_for_a_day() {
        let start = Instant::now();
        let at = |hours: u64| start + Duration::from_secs(hours * 3600);
        let mut clock = Steadiness::new(0, None, start);
        let mut holds = |now: i64, hours: u64| clock.holds(now, at(hours)).is_ok();
        assert!(holds(HOUR, 1) && holds(2 * HOUR + 500_000, 2), "small steps are none");
        assert!(!holds(3 * HOUR + 365 * DAY, 3) && !holds(26 * HOUR + 365 * DAY, 26));
        assert!(holds(27 * HOUR + 365 * DAY, 27), "a day later it is believed");
        assert!(!holds(28 * HOUR - 365 * DAY, 28), "backward");
        assert!(holds(29 * HOUR + 365 * DAY, 29), "it is back");
    }

    #[test]
    fn a_clock_that_is_wrong_at_the_start_is_doubted_until_it_is_right_or_for_a_day() {
        let start = Instant::now();
        let at = |hours: u64| start + Duration::from_secs(hours * 3600);
        let newest = 1000 * DAY;
        let begin = |now: i64| Steadiness::new(now, Some(newest), start);
        for now in [newest - 500_000, newest, newest + 6 * DAY] {
            assert_eq!(begin(now).holds(now, at(0)), Ok(()), "{}", now - newest);
        }
        for (now, doubt) in [
            (newest - HOUR, Doubt::Behind(60)),
            (newest + 8 * DAY, Doubt::Ahead(8)),
            (0, Doubt::Behind(1_440_000)),
        ] {
            let mut clock = begin(now);
            assert_eq!(clock.holds(now, at(0)), Err(doubt));
            // It is set right; from then on it is one that was never wrong.
            assert_eq!(clock.holds(newest + HOUR, at(1)), Ok(()));
            assert_eq!(clock.holds(newest + 2 * HOUR, at(2)), Ok(()));
            assert_eq!(clock.holds(newest + 365 * DAY, at(3)), Err(Doubt::Set));
        }
        for now in [newest + 8 * DAY, 0] {
            let mut clock = begin(now);
            let mut holds = |hours: u64| clock.holds(now + hours as i64 * HOUR, at(hours)).is_ok();
            assert!(!holds(23) && holds(24) && holds(25), "a day later it is believed");
        }
        // One that is behind by little has soon passed the newest job.
        let mut clock = begin(newest - HOUR);
        assert!(clock.holds(newest + HOUR, at(2)).is_ok());
    }
}
