//! Each run in a process of its own: the service's program once more, told to work off one job.
//!
//! So a job that takes more memory than it may, that overflows its stack, that aborts or that the system kills
//! ends alone: the service and the jobs beside it go on. The limit of memory is the kernel's (`RLIMIT_DATA`),
//! which nothing in the method can pass. And a cancelled run is killed: it ends at once, whatever it is doing.
//!
//! A process that has ended a run well takes the next one: starting one takes longer than a small run. It has dropped
//! the mesh and its result by then. After a crash, a panic, a cancellation, a time-out, or where it keeps much memory, the
//! next run gets a fresh one, and one that has nothing to do for a while is ended.
//!
//! The parent writes an [`Order`] and the mesh to the child's stdin and keeps that open; the child answers with
//! [`words::Word`]s on its stdout. A child whose stdin ends has lost its parent and goes.

mod child;
mod hearing;
mod process;
mod words;

use std::io;
use std::num::{NonZeroU32, NonZeroU64};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use super::JobFailure;
use super::runner::{Artifact, JobRunner, RunControl, Work};
use crate::centerline::CancelToken;
use crate::mesh::format::Limits;
use hearing::Answer;
use process::{Death, Process};
use words::Order;

pub use child::work_off;

/// The subcommand that calls [`work_off`].
pub const SUBCOMMAND: &str = "work";

/// Memory of one run where nothing else is set, bytes.
pub const JOB_MEMORY: NonZeroU64 = NonZeroU64::new(4 << 30).unwrap();

/// How soon a cancellation is seen between two tries.
const WATCH: Duration = Duration::from_millis(10);
/// Between a crash and the next try, times the crashes so far: memory that was short may be there then.
const PAUSE: Duration = Duration::from_secs(1);
/// Before the next try to start a process.
const LATER: Duration = Duration::from_secs(5);
/// How long a process is kept that has nothing to do.
const REST: Duration = Duration::from_secs(10);
/// Memory of its own that a process may keep beyond a run, bytes: several times what a small run leaves. A run
/// that needed more takes so long that a fresh process costs it nothing.
const KEPT: u64 = 64 << 20;

/// Runs [`super::extraction::Extraction`] in processes of their own.
#[derive(Debug)]
pub struct Isolated {
    limits: Limits,
    memory: NonZeroU64,
    max_crashes: NonZeroU32,
    /// Processes without a run, the one that had the last run at the end.
    at_rest: Mutex<Vec<Process>>,
}

impl Isolated {
    /// Refuses meshes beyond `limits`; fails a run that needs more than `memory` bytes, and one whose process died
    /// `max_crashes` times.
    pub fn new(limits: Limits, memory: NonZeroU64, max_crashes: NonZeroU32) -> Self {
        Self { limits, memory, max_crashes, at_rest: Mutex::default() }
    }

    fn failure(&self, death: &Death, crashes: u32) -> JobFailure {
        match death {
            Death::OverMemory => JobFailure::out_of_memory(self.memory.get()),
            Death::Died(status) => JobFailure::run_crashed(crashes, &status.to_string()),
            Death::Astray(error) => JobFailure::run_crashed(crashes, &error.to_string()),
            Death::AtRest => JobFailure::run_crashed(crashes, "an end before its beginning"),
        }
    }

    fn at_rest(&self) -> MutexGuard<'_, Vec<Process>> {
        self.at_rest.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Keeps a process that may take another run.
    fn keep(&self, process: Process, answer: &Answer) {
        if answer.is_sound && process.memory().is_some_and(|memory| memory <= KEPT) {
            self.at_rest().push(process);
        }
    }
}

impl JobRunner for Isolated {
    fn run(&self, work: Work, control: &RunControl) -> Result<Vec<Artifact>, JobFailure> {
        let order = Order::new(&work, self.memory, &self.limits).line();
        let mut crashes = 0;
        let mut rested = self.at_rest().pop();
        loop {
            let mut process = match rested.take().map_or_else(Process::start, Ok) {
                Ok(process) => process,
                Err(_) if control.cancel().is_cancelled() => return Err(JobFailure::cancelled()),
                Err(error) => {
                    // The machine is short of processes or memory, which says nothing of the job: it waits, as long as a run may take.
                    tracing::error!(%error, "no process for a run; it is tried again");
                    pause(LATER, control.cancel());
                    continue;
                }
            };
            let death = match process.work_off(&order, &work.bytes, self.memory.get(), control) {
                Ok(answer) => {
                    self.keep(process, &answer);
                    return answer.result;
                }
                Err(_) if control.cancel().is_cancelled() => return Err(JobFailure::cancelled()),
                Err(death) => death,
            };
            if matches!(death, Death::AtRest) || matches!(death, Death::OverMemory) && process.is_used() {
                // Which says nothing of the job, either: something of the memory may have been the last run's.
                continue;
            }
            drop(process);
            crashes += 1;
            let failure = self.failure(&death, crashes);
            tracing::error!(crashes, reason = failure.detail, "the run's process gave no answer");
            // A run that needs too much memory needs it again.
            if matches!(death, Death::OverMemory) || crashes >= self.max_crashes.get() {
                return Err(failure);
            }
            pause(PAUSE * crashes, control.cancel());
        }
    }

    fn rest(&self) {
        // Dropped when the lock is free again.
        let _ended: Vec<Process> =
            self.at_rest().extract_if(.., |process| process.rested() >= REST).collect();
    }

    fn resting(&self) -> usize {
        self.at_rest().len()
    }
}

/// This program, also when its file was replaced since.
pub fn program() -> io::Result<std::path::PathBuf> {
    let running = std::path::Path::new("/proc/self/exe");
    if running.exists() { Ok(running.to_owned()) } else { std::env::current_exe() }
}

fn pause(length: Duration, cancel: &CancelToken) {
    let begin = Instant::now();
    while begin.elapsed() < length && !cancel.is_cancelled() {
        std::thread::sleep(WATCH);
    }
}
