//! What the workers did since the start, counted for operators.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use super::{JobStage, JobStatus};

/// Upper bounds of the buckets of stage times, seconds: from a small mesh's stage to one of a million vertices.
const STAGE_BOUNDS: [f64; 8] = [0.005, 0.02, 0.1, 0.5, 2.0, 10.0, 60.0, 300.0];

/// How many times were no longer than each of some bounds.
#[derive(Debug, Clone, PartialEq)]
pub struct Histogram {
    bounds: &'static [f64],
    /// Times up to each bound that are longer than the bound before; the last for what is longer than all.
    counts: Vec<u64>,
    seconds: f64,
}

impl Histogram {
    /// Without any times. `bounds`: seconds, ascending.
    pub fn new(bounds: &'static [f64]) -> Self {
        Self { bounds, counts: vec![0; bounds.len() + 1], seconds: 0.0 }
    }

    pub fn add(&mut self, took: Duration) {
        let seconds = took.as_secs_f64();
        let bucket = self.bounds.partition_point(|bound| *bound < seconds);
        self.counts[bucket] += 1;
        self.seconds += seconds;
    }

    /// Each bound with the number of times up to it.
    pub fn cumulative(&self) -> impl Iterator<Item = (f64, u64)> + '_ {
        let sums = self.counts.iter().scan(0, |sum, count| {
            *sum += count;
            Some(*sum)
        });
        self.bounds.iter().copied().zip(sums)
    }

    pub fn count(&self) -> u64 {
        self.counts.iter().sum()
    }

    /// Of all times together.
    pub fn seconds(&self) -> f64 {
        self.seconds
    }
}

/// The times of one stage in runs of one preset.
#[derive(Debug, Clone, PartialEq)]
pub struct StageTimes {
    pub preset: &'static str,
    pub stage: &'static str,
    pub times: Histogram,
}

/// The counters; any thread may add.
#[derive(Default)]
pub(super) struct Meter {
    /// By preset and stage.
    stages: Mutex<BTreeMap<(&'static str, &'static str), Histogram>>,
    busy: AtomicUsize,
    successful: AtomicU64,
    failed: AtomicU64,
    dismissed: AtomicU64,
}

impl Meter {
    pub(super) fn stage(&self, preset: &'static str, stage: JobStage, took: Duration) {
        let mut stages = self.stages.lock().unwrap_or_else(PoisonError::into_inner);
        let times = stages.entry((preset, stage.name())).or_insert_with(|| Histogram::new(&STAGE_BOUNDS));
        times.add(took);
    }

    pub(super) fn stages(&self) -> Vec<StageTimes> {
        let stages = self.stages.lock().unwrap_or_else(PoisonError::into_inner);
        let times = |(&(preset, stage), times): (&(_, _), &Histogram)| StageTimes {
            preset,
            stage,
            times: times.clone(),
        };
        stages.iter().map(times).collect()
    }

    /// Counts a worker as busy until the answer is dropped.
    pub(super) fn begin(&self) -> Busy<'_> {
        self.busy.fetch_add(1, Ordering::Relaxed);
        Busy(self)
    }

    pub(super) fn busy(&self) -> usize {
        self.busy.load(Ordering::Relaxed)
    }

    /// A job has ended like this.
    pub(super) fn ended(&self, status: JobStatus) {
        if let Some(counter) = self.counter(status) {
            counter.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// How often jobs have ended in each way.
    pub(super) fn ends(&self) -> Vec<(JobStatus, u64)> {
        let count = |status| Some((status, self.counter(status)?.load(Ordering::Relaxed)));
        JobStatus::ALL.into_iter().filter_map(count).collect()
    }

    fn counter(&self, status: JobStatus) -> Option<&AtomicU64> {
        match status {
            JobStatus::Successful => Some(&self.successful),
            JobStatus::Failed => Some(&self.failed),
            JobStatus::Dismissed => Some(&self.dismissed),
            JobStatus::Accepted | JobStatus::Running => None,
        }
    }
}

pub(super) struct Busy<'a>(&'a Meter);

impl Drop for Busy<'_> {
    fn drop(&mut self) {
        self.0.busy.fetch_sub(1, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_time_counts_in_every_bucket_that_it_fits_in() {
        let mut times = Histogram::new(&[0.1, 1.0]);
        for millis in [50, 100, 700, 5000] {
            times.add(Duration::from_millis(millis));
        }
        assert_eq!(times.cumulative().collect::<Vec<_>>(), [(0.1, 2), (1.0, 3)]);
        assert_eq!(times.count(), 4);
        assert!((times.seconds() - 5.85).abs() < 1e-9);
    }

    #[test]
    fn a_worker_is_busy_until_its_run_ends() {
        let meter = Meter::default();
        let (first, second) = (meter.begin(), meter.begin());
        assert_eq!(meter.busy(), 2);
        drop((first, second));
        assert_eq!(meter.busy(), 0);
    }
}
