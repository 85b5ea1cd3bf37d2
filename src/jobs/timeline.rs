//! Which stage one run is in, and how long it was in each.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant, SystemTime};

use super::meter::Meter;
use super::{Job, JobStage, JobStatus, Span, SpanKind, Spans};
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
    span: Span,
}

/// Spans of stages in one run: each component of a surface brings its own.
const MOST_SPANS: usize = 200;

struct Spent {
    stage: JobStage,
    since: Instant,
    /// The same by the clock that other machines share.
    begin: SystemTime,
    spans: usize,
    /// By the stages' indices; none for stages that the run was not in.
    times: [Option<Duration>; JobStage::COUNT],
}

impl Spent {
    fn change(&mut self, to: JobStage, span: &Span) {
        let (now, time) = (Instant::now(), SystemTime::now());
        *self.times[self.stage.index()].get_or_insert_default() += now - self.since;
        self.spans += 1;
        if self.spans <= MOST_SPANS {
            span.past(self.stage.name(), self.begin, time);
        }
        (self.stage, self.since, self.begin) = (to, now, time);
    }
}

impl Timeline {
    /// A run that begins to read now.
    pub(super) fn start(job: &Job, meter: Arc<Meter>, spans: &Spans) -> Self {
        let preset = job.spec.parameters.preset.parse::<Preset>().map_or("other", Preset::name);
        let (stage, begin) = (JobStage::Reading, SystemTime::now());
        let spent = Spent { stage, since: Instant::now(), begin, spans: 0, times: [None; JobStage::COUNT] };
        let (stage, spent) = (AtomicUsize::new(stage.index()), Mutex::new(Some(spent)));
        Self { preset, meter, stage, spent, span: run_span(job, preset, begin, spans) }
    }

    /// The run is in this stage.
    pub(super) fn at(&self, stage: JobStage) {
        if self.stage.swap(stage.index(), Ordering::Relaxed) != stage.index()
            && let Some(spent) = self.spent.lock().unwrap_or_else(PoisonError::into_inner).as_mut()
        {
            spent.change(stage, &self.span);
        }
    }

    /// The job has ended so.
    pub(super) fn settled(&self, status: JobStatus) {
        self.meter.ended(status);
        self.span.set("rosaline.job.outcome", status.name());
        if status == JobStatus::Failed {
            self.span.fail();
        }
    }

    /// The run is over: its times are counted, and what it reports from now on is not.
    pub(super) fn end(&self) {
        let spent = self.spent.lock().unwrap_or_else(PoisonError::into_inner).take();
        let Some(mut spent) = spent else { return };
        spent.change(spent.stage, &self.span);
        for (stage, time) in JobStage::all().zip(spent.times) {
            if let Some(time) = time {
                self.meter.stage(self.preset, stage, time);
            }
        }
    }
}

/// The span of a run, below the request that submitted its job, beside that of its wait.
fn run_span(job: &Job, preset: &'static str, now: SystemTime, spans: &Spans) -> Span {
    let request = job.spec.origin.traceparent.as_deref();
    let accepted = SystemTime::UNIX_EPOCH + Duration::from_millis(job.created.max(0).unsigned_abs());
    // Later runs waited for a worker twice, with a run between.
    if job.attempts <= 1 {
        spans.past("wait", request, accepted.min(now), now);
    }
    let span = spans.begin("run", SpanKind::Consumer, request);
    span.set("rosaline.job.id", job.id.to_string());
    span.set("rosaline.job.attempt", i64::from(job.attempts));
    span.set("rosaline.preset", preset);
    span
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
        let timeline = Timeline::start(&job, meter.clone(), &Spans::default());
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
