//! What is known of active jobs without asking the store: progress, cancellation, and who waits for them.

use std::collections::HashMap;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::sync::watch;

use super::JobId;
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

    fn index(self) -> usize {
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

/// One active job.
pub(super) struct Entry {
    /// The highest `packed` reported: keeps the frequent reports off the watch's lock.
    packed: AtomicU32,
    pub(super) cancel: CancelToken,
    changes: watch::Sender<Snapshot>,
}

impl Entry {
    fn new() -> Self {
        Self {
            packed: AtomicU32::new(0),
            cancel: CancelToken::new(),
            changes: watch::Sender::new(Snapshot::default()),
        }
    }

    /// Reports progress of the whole surface.
    pub(super) fn report(&self, stage: JobStage, fraction: f64) {
        self.report_part(stage, fraction, Part::WHOLE);
    }

    /// Reports progress; reports that would go back are dropped. Any thread may call it, often.
    pub(super) fn report_part(&self, stage: JobStage, fraction: f64, part: Part) {
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
}

/// The active jobs that run or are waited for.
#[derive(Default)]
pub(super) struct Board {
    entries: Mutex<HashMap<JobId, Arc<Entry>>>,
}

impl Board {
    fn entries(&self) -> MutexGuard<'_, HashMap<JobId, Arc<Entry>>> {
        self.entries.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The job runs from now on.
    pub(super) fn start(&self, id: JobId) -> Arc<Entry> {
        self.entries().entry(id).or_insert_with(|| Arc::new(Entry::new())).clone()
    }

    /// The job has ended: wakes who waits for it.
    pub(super) fn end(&self, id: JobId) {
        if let Some(entry) = self.entries().remove(&id) {
            entry.changes.send_modify(|current| current.ended = true);
        }
    }

    /// Stops the job's run, if it runs here.
    pub(super) fn cancel(&self, id: JobId) {
        if let Some(entry) = self.entries().get(&id) {
            entry.cancel.cancel();
        }
    }

    /// Stops every run.
    pub(super) fn cancel_all(&self) {
        self.entries().values().for_each(|entry| entry.cancel.cancel());
    }

    pub(super) fn snapshot(&self, id: JobId) -> Option<Snapshot> {
        self.entries().get(&id).map(|entry| *entry.changes.borrow())
    }

    /// Follows the job's changes from now on.
    pub(super) fn watch(self: &Arc<Self>, id: JobId) -> Watch {
        let entry = self.start(id);
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
        let mut entries = self.board.entries();
        drop(self.entry.take());
        if entries.get(&self.id).is_some_and(|entry| Arc::strong_count(entry) == 1) {
            entries.remove(&self.id);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::jobs::{IdSource, ManualClock};

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
