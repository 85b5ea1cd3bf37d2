//! When a delivery that failed is tried again.

use std::num::NonZeroU32;
use std::time::Duration;

use crate::jobs::LONGEST_WAIT;

/// How much longer each wait is than the one before.
const FACTOR: u32 = 3;

/// Waits that grow, up to a number of tries.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Schedule {
    /// The wait after the first try.
    pub first: Duration,
    /// Tries after which a delivery is given up.
    pub attempts: NonZeroU32,
}

impl Schedule {
    /// How long to wait after this many tries; `None`: no more. `random` from 0 to 1 spreads those that failed together
    /// over the last quarter of the wait. A target that asked for more time (`Retry-After`) gets it.
    pub(super) fn wait(&self, tries: u32, asked: Option<Duration>, random: f64) -> Option<Duration> {
        if tries >= self.attempts.get() {
            return None;
        }
        let factor = FACTOR.saturating_pow(tries.saturating_sub(1));
        let wait = self.first.saturating_mul(factor).min(LONGEST_WAIT);
        let spread = wait.mul_f64(0.75 + 0.25 * random.clamp(0.0, 1.0));
        Some(spread.max(asked.unwrap_or_default().min(LONGEST_WAIT)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn waits_grow_to_half_a_day_and_end() {
        let schedule = Schedule { first: Duration::from_secs(5), attempts: NonZeroU32::new(12).unwrap() };
        let waits: Vec<u64> =
            (1..12).map(|tries| schedule.wait(tries, None, 1.0).unwrap().as_secs()).collect();
        assert_eq!(waits, [5, 15, 45, 135, 405, 1215, 3645, 10_935, 32_805, 43_200, 43_200]);
        assert_eq!(schedule.wait(12, None, 0.0), None);
        assert_eq!(schedule.wait(2, None, 0.0), Some(Duration::from_millis(11_250)));
        let asked = |seconds| schedule.wait(1, Some(Duration::from_secs(seconds)), 0.0).unwrap().as_secs();
        assert_eq!((asked(60), asked(1), asked(u64::MAX)), (60, 3, 43_200));
    }
}
