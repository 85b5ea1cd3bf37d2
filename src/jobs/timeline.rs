//! Which stage one run is in, and how long it was in each.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use super::meter::Meter;
use super::{Job, JobStage, JobStatus};
use crate::centerline::Preset;

/// Gives the time between two changes of stage to the stage of the first. The components of a surface go through
/// the stages one by one, so a run may come into a stage several times: it counts once, with their sum.
pub(super) struct Timeline {
    preset: &'static str,
    meter: Arc<Meter>,
    /// Index of the stage: keeps the frequent reports off the lock.
    stage: AtomicUsize,
    /// None once the run is over.
    spent: Mutex<Option<Spent>>,
}

struct Spent {
    stage: JobStage,
    since: Instant,
    /// By the stages' indices; none for stages that the run was not in.
    times: [Option<Duration>; JobStage::COUNT],
}

impl Spent {
    fn change(&mut self, to: JobStage) {
        let now = Instant::now();
        *self.times[self.stage.index()].get_or_insert_default() += now - self.since;
        (self.stage, self.since) = (to, now);
    }
}

impl Timeline {
    /// A run that begins to read now.
    pub(super) fn start(job: &Job, meter: Arc<Meter>) -> Self {
        let preset = job.spec.parameters.preset.parse::<Preset>().map_or("other", Preset::name);
        let stage = JobStage::Reading;
        let spent = Spent { stage, since: Instant::now(), times: [None; JobStage::COUNT] };
        Self { preset, meter, stage: AtomicUsize::new(stage.index()), spent: Mutex::new(Some(spent)) }
    }

    /// The run is in this stage.
    pub(super) fn at(&self, stage: JobStage) {
        if self.stage.swap(stage.index(), Ordering::Relaxed) != stage.index()
            && let Some(spent) = self.spent.lock().unwrap_or_else(PoisonError::into_inner).as_mut()
        {
            spent.change(stage);
        }
    }

    /// The job has ended so.
    pub(super) fn settled(&self, status: JobStatus) {
        self.meter.ended(status);
    }

    /// The run is over: its times are counted, and what it reports from now on is not.
    pub(super) fn end(&self) {
        let spent = self.spent.lock().unwrap_or_else(PoisonError::into_inner).take();
        let Some(mut spent) = spent else { return };
        spent.change(spent.stage);
        for (stage, time) in JobStage::all().zip(spent.times) {
            if let Some(time) = time {
                self.meter.stage(self.preset, stage, time);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::centerline::Stage;
    use crate::jobs::{IdSource, JobSpec, ManualClock, StoredInput};

    #[test]
    fn a_run_counts_once_in_each_of_its_stages_and_not_after_its_end() {
        let meter = Arc::new(Meter::default());
        let id = IdSource::new(Arc::new(ManualClock::new(1)), None).next();
        let input = StoredInput { key: "k".into(), size: 1, sha256: "00".into() };
        let mut job = Job::accepted(id, input, JobSpec::default(), 5);
        job.spec.parameters.preset = "paper".to_owned();
        let timeline = Timeline::start(&job, meter.clone());
        for stage in [Stage::Tips, Stage::Tips, Stage::CutPlanes, Stage::Tips] {
            timeline.at(JobStage::Method(stage));
        }
        timeline.end();
        timeline.at(JobStage::Writing);
        timeline.end();
        let found = meter.stages();
        let found: Vec<_> = found.iter().map(|row| (row.preset, row.stage, row.times.count())).collect();
        assert_eq!(found, [("paper", "cut_planes", 1), ("paper", "reading", 1), ("paper", "tips", 1)]);
    }
}
