//! What is known of active jobs without asking the store: their rows, progress, cancellation, and who waits
//! for them.
//!
//! Clients poll active jobs, many at a time, while the workers take every core: the store's threads and locks
//! would make those answers slow. What is here is right because no other process changes the store.

use std::collections::HashMap;
use std::sync::atomic::{AtomicI64, AtomicU32, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};

use tokio::sync::watch;

use super::timeline::Timeline;
use super::{Job, JobId, JobStatus};
use crate::centerline::{CancelToken, Part, Stage};

/// The stages of a job: the method's, between reading the mesh and writing the results.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum JobStage {
    Reading,
    Method(Stage),
    Writing,
}

/// Every stage with the percent of a job at which it ends: the shares of time that the phantom `bigtree`
/// took on two cores, and a percent at least.
const ENDS: [(JobStage, u8); 11] = [
    (JobStage::Reading, 10),
    (JobStage::Method(Stage::Preparation), 22),
    (JobStage::Method(Stage::SmoothingFilter), 23),
    (JobStage::Method(Stage::Tips), 32),
    (JobStage::Method(Stage::Segmentation), 34),
    (JobStage::Method(Stage::CutPlanes), 50),
    (JobStage::Method(Stage::LaplacianSmoothing), 51),
    (JobStage::Method(Stage::Thinning), 52),
    (JobStage::Method(Stage::Recentering), 96),
    (JobStage::Method(Stage::Connection), 98),
    (JobStage::Writing, 99),
];

impl JobStage {
    /// The stage's name in job status and logs.
    pub fn name(self) -> &'static str {
        match self {
            JobStage::Reading => "reading",
            JobStage::Method(stage) => stage.name(),
            JobStage::Writing => "writing",
        }
    }

    /// The stage of a name that [`JobStage::name`] gives.
    pub(super) fn named(name: &str) -> Option<Self> {
        Self::all().find(|stage| stage.name() == name)
    }

    /// How many stages there are.
    pub(super) const COUNT: usize = ENDS.len();

    /// Every stage, in order.
    pub(super) fn all() -> impl Iterator<Item = Self> {
        ENDS.iter().map(|(stage, _)| *stage)
    }

    /// Its place in that order.
    pub(super) fn index(self) -> usize {
        ENDS.iter().position(|(stage, _)| *stage == self).unwrap_or(0)
    }
}

/// Where an active job is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Snapshot {
    /// 0 while the job waits, then 1 + hundredths of a percent × 16 + stage index: grows as the job goes on,
    /// also when the next component of the surface begins at an earlier stage.
    packed: u32,
    /// The job has ended; the store says how.
    pub(super) ended: bool,
}

impl Snapshot {
    fn at(stage: JobStage, fraction: f64, part: Part) -> Self {
        let index = stage.index();
        let start = if index == 0 { 0 } else { ENDS[index - 1].1 };
        let mut percent = f64::from(start) + f64::from(ENDS[index].1 - start) * fraction.clamp(0.0, 1.0);
        let first = f64::from(ENDS[JobStage::Method(Stage::Preparation).index()].1);
        let last = f64::from(ENDS[JobStage::Method(Stage::Connection).index()].1);
        if (first..=last).contains(&percent) {
            percent = first + (last - first) * part.overall((percent - first) / (last - first));
        }
        // In range: the table's percents are below 100; NaN becomes 0.
        Self { packed: 1 + (percent * 100.0) as u32 * 16 + index as u32, ended: false }
    }

    /// Stage and percent; `None` while the job waits.
    pub(super) fn progress(self) -> Option<(JobStage, u8)> {
        let code = self.packed.checked_sub(1)?;
        let (stage, _) = ENDS.get((code % 16) as usize)?;
        Some((*stage, (code / 1600) as u8))
    }
}

/// Whole percents and stages as one number, which grows with both.
pub(super) fn coarse(stage: JobStage, fraction: f64, part: Part) -> u32 {
    Snapshot::at(stage, fraction, part).progress().map_or(0, |(stage, percent)| {
        // Eleven stages fit into four bits.
        1 + u32::from(percent) * 16 + stage.index() as u32
    })
}

/// One active job.
pub(super) struct Entry {
    /// The highest `packed` reported: keeps the frequent reports off the watch's lock.
    packed: AtomicU32,
    pub(super) cancel: CancelToken,
    changes: watch::Sender<Snapshot>,
    /// Of a job that runs here: its row as it was claimed.
    row: OnceLock<Job>,
    /// When the row last changed in the store.
    updated: AtomicI64,
    /// Of a job that runs here.
    timeline: OnceLock<Timeline>,
}

impl Entry {
    fn new() -> Self {
        Self {
            packed: AtomicU32::new(0),
            cancel: CancelToken::new(),
            changes: watch::Sender::new(Snapshot::default()),
            row: OnceLock::new(),
            updated: AtomicI64::new(0),
            timeline: OnceLock::new(),
        }
    }

    /// Reports progress of the whole surface.
    pub(super) fn report(&self, stage: JobStage, fraction: f64) {
        self.report_part(stage, fraction, Part::WHOLE);
    }

    /// Reports progress; reports that would go back are dropped. Any thread may call it, often.
    pub(super) fn report_part(&self, stage: JobStage, fraction: f64, part: Part) {
        if let Some(timeline) = self.timeline.get() {
            timeline.at(stage);
        }
        let next = Snapshot::at(stage, fraction, part);
        if self.packed.fetch_max(next.packed, Ordering::Relaxed) < next.packed {
            self.changes.send_if_modified(|current| {
                let newer = current.packed < next.packed && !current.ended;
                if newer {
                    *current = next;
                }
                newer
            });
        }
    }

    pub(super) fn subscribe(&self) -> watch::Receiver<Snapshot> {
        self.changes.subscribe()
    }

    /// The job runs here with this row, which the store had after the entry was made.
    pub(super) fn runs(&self, row: &Job, timeline: Timeline) {
        self.updated.store(row.updated, Ordering::Relaxed);
        // An entry is of one run, so nothing was there before.
        let _ = (self.row.set(row.clone()), self.timeline.set(timeline));
    }

    /// The job has ended so.
    pub(super) fn settled(&self, status: JobStatus) {
        if let Some(timeline) = self.timeline.get() {
            timeline.settled(status);
        }
    }

    /// The run is over.
    pub(super) fn left(&self) {
        if let Some(timeline) = self.timeline.get() {
            timeline.end();
        }
    }

    /// The store's row was changed.
    pub(super) fn touched(&self, now: i64) {
        self.updated.store(now, Ordering::Relaxed);
    }

    fn row(&self) -> Option<Job> {
        let row = self.row.get()?;
        Some(Job { updated: self.updated.load(Ordering::Relaxed), ..row.clone() })
    }
}

/// Waiting jobs that are remembered; of more than these the store is asked.
const MOST_WAITING: usize = 10_000;

/// The active jobs of this process.
#[derive(Default)]
pub(super) struct Board(Mutex<Places>);

#[derive(Default)]
struct Places {
    /// Jobs that run or are waited for.
    entries: HashMap<JobId, Arc<Entry>>,
    /// Rows of jobs that were accepted and not yet claimed.
    accepted: HashMap<JobId, Job>,
}

impl Places {
    fn entry(&mut self, id: JobId) -> Arc<Entry> {
        self.entries.entry(id).or_insert_with(|| Arc::new(Entry::new())).clone()
    }
}

impl Board {
    fn places(&self) -> MutexGuard<'_, Places> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The job is about to be committed: called before, so that no claim comes between.
    pub(super) fn accept(&self, job: &Job) {
        let mut places = self.places();
        if places.accepted.len() < MOST_WAITING {
            places.accepted.insert(job.id, job.clone());
        }
    }

    /// The job may not have been committed: the store knows.
    pub(super) fn forget_accepted(&self, id: JobId) {
        self.places().accepted.remove(&id);
    }

    /// The job was claimed and runs from now on.
    pub(super) fn start(&self, id: JobId) -> Arc<Entry> {
        let mut places = self.places();
        places.accepted.remove(&id);
        places.entry(id)
    }

    /// The job has ended, or is not active here any more: wakes who waits for it.
    pub(super) fn end(&self, id: JobId) {
        let mut places = self.places();
        places.accepted.remove(&id);
        if let Some(entry) = places.entries.remove(&id) {
            entry.changes.send_modify(|current| current.ended = true);
        }
    }

    /// Stops the job's run, if it runs here.
    pub(super) fn cancel(&self, id: JobId) {
        if let Some(entry) = self.places().entries.get(&id) {
            entry.cancel.cancel();
        }
    }

    /// Stops every run.
    pub(super) fn cancel_all(&self) {
        self.places().entries.values().for_each(|entry| entry.cancel.cancel());
    }

    /// The row of an active job; `None` where only the store knows.
    pub(super) fn row(&self, id: JobId) -> Option<Job> {
        let places = self.places();
        let running = places.entries.get(&id).and_then(|entry| entry.row());
        running.or_else(|| places.accepted.get(&id).cloned())
    }

    pub(super) fn snapshot(&self, id: JobId) -> Option<Snapshot> {
        self.places().entries.get(&id).map(|entry| *entry.changes.borrow())
    }

    /// Follows the job's changes from now on.
    pub(super) fn watch(self: &Arc<Self>, id: JobId) -> Watch {
        let entry = self.places().entry(id);
        Watch { changes: entry.subscribe(), entry: Some(entry), id, board: self.clone() }
    }
}

/// A follower of one job.
pub(super) struct Watch {
    pub(super) changes: watch::Receiver<Snapshot>,
    entry: Option<Arc<Entry>>,
    id: JobId,
    board: Arc<Board>,
}

impl Drop for Watch {
    /// Forgets a job that neither runs nor is waited for by someone else.
    fn drop(&mut self) {
        let mut places = self.board.places();
        drop(self.entry.take());
        if places.entries.get(&self.id).is_some_and(|entry| Arc::strong_count(entry) == 1) {
            places.entries.remove(&self.id);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::jobs::{IdSource, JobSpec, ManualClock, Spans, StoredInput};

    fn id() -> JobId {
        IdSource::new(Arc::new(ManualClock::new(1)), None).next()
    }

    #[test]
    fn progress_never_goes_back() {
        let entry = Entry::new();
        let changes = entry.subscribe();
        assert_eq!(changes.borrow().progress(), None);
        entry.report(JobStage::Method(Stage::Tips), 0.5);
        assert_eq!(changes.borrow().progress(), Some((JobStage::Method(Stage::Tips), 27)));
        entry.report(JobStage::Method(Stage::Preparation), 1.0);
        entry.report(JobStage::Method(Stage::Tips), 0.1);
        entry.report(JobStage::Method(Stage::Tips), f64::NAN);
        assert_eq!(changes.borrow().progress(), Some((JobStage::Method(Stage::Tips), 27)));
        entry.report(JobStage::Writing, 7.0);
        assert_eq!(changes.borrow().progress(), Some((JobStage::Writing, 99)));
    }

    #[test]
    fn every_component_brings_progress_further() {
        let entry = Entry::new();
        let changes = entry.subscribe();
        entry.report(JobStage::Method(Stage::Preparation), 1.0);
        let (mut seen, mut last) = (Vec::new(), 0);
        for (before, share) in [(0.0, 0.5), (0.5, 0.25), (0.75, 0.25)] {
            for stage in [Stage::Tips, Stage::Recentering, Stage::Connection] {
                entry.report_part(JobStage::Method(stage), 1.0, Part { before, share });
                let (now, percent) = changes.borrow().progress().unwrap();
                assert_eq!(now, JobStage::Method(stage), "the stage at work is shown");
                assert!(percent > last || stage == Stage::Connection, "{percent} after {last}");
                last = percent;
            }
            seen.push(last);
        }
        assert_eq!(seen, [60, 79, 98], "22 after preparation, 98 at the end of the last component");
    }

    #[test]
    fn every_stage_has_its_place() {
        let mut last = 0;
        for stage in Stage::ALL {
            let entry = Snapshot::at(JobStage::Method(stage), 0.0, Part::WHOLE);
            assert_eq!(entry.progress().unwrap().0, JobStage::Method(stage));
            assert!(entry.packed > last);
            last = entry.packed;
        }
    }

    #[test]
    fn rows_of_active_jobs_are_known_from_their_acceptance_to_their_end() {
        let (board, id) = (Arc::new(Board::default()), id());
        let input = StoredInput { key: "k".into(), size: 1, sha256: "00".into() };
        let accepted = Job::accepted(id, input, JobSpec::default(), 5);
        assert_eq!(board.row(id), None);
        board.accept(&accepted);
        drop(board.watch(id));
        assert_eq!(board.row(id), Some(accepted.clone()), "also when somebody has waited for it");
        let entry = board.start(id);
        assert_eq!(board.row(id), None, "claimed: the store knows until its worker has read the row");
        let running = Job { status: JobStatus::Running, updated: 6, ..accepted.clone() };
        entry.runs(&running, Timeline::start(&running, Arc::default(), &Spans::default()));
        assert_eq!(board.row(id), Some(running.clone()));
        entry.touched(9);
        assert_eq!(board.row(id), Some(Job { updated: 9, ..running.clone() }));
        board.end(id);
        assert_eq!(board.row(id), None);
        // A dismissal between the worker's look into the store and its word here.
        entry.touched(10);
        let late = board.start(id);
        board.end(id);
        late.runs(&running, Timeline::start(&running, Arc::default(), &Spans::default()));
        assert_eq!(board.row(id), None);
        board.accept(&accepted);
        board.end(id);
        assert_eq!(board.row(id), None, "dismissed while it waited");
    }

    #[test]
    fn a_board_forgets_jobs_nobody_waits_for() {
        let (board, id) = (Arc::new(Board::default()), id());
        let (first, second) = (board.watch(id), board.watch(id));
        drop(first);
        assert!(board.snapshot(id).is_some());
        drop(second);
        assert!(board.snapshot(id).is_none());
        let running = board.start(id);
        drop(board.watch(id));
        assert!(board.snapshot(id).is_some(), "a running job stays");
        let watch = board.watch(id);
        board.end(id);
        assert!(watch.changes.borrow().ended);
        drop(watch);
        running.report(JobStage::Writing, 0.0);
        assert!(board.snapshot(id).is_none());
    }
}
