//! Each run in a process of its own: the service's program once more, told to work off one job.
//!
//! So a job that takes more memory than it may, that overflows its stack, that aborts or that the system kills
//! ends alone: the service and the jobs beside it go on. The limit of memory is the kernel's (`RLIMIT_DATA`),
//! which nothing in the method can pass. And a cancelled run is killed: it ends at once, whatever it is doing.
//!
//! The parent writes an [`Order`] and the mesh to the child's stdin and keeps that open; the child answers with
//! [`Word`]s on its stdout. A child whose stdin ends has lost its parent and goes.

mod child;
mod words;

use std::io::{self, BufRead, BufReader, Read, Write};
use std::num::{NonZeroU32, NonZeroU64};
use std::process::{Child, ChildStderr, ChildStdin, ChildStdout, Command, ExitStatus, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

#[cfg(debug_assertions)]
use super::faults;
use super::runner::{Artifact, JobRunner, RunControl, Work};
use super::{JobFailure, JobStage};
use crate::centerline::{CancelToken, Part};
use crate::mesh::format::Limits;
use crate::output::OutputFormat;
use words::{LONGEST_LINE, Order, Word};

pub use child::work_off;

/// The subcommand that calls [`work_off`].
pub const SUBCOMMAND: &str = "work";

/// Memory of one run where nothing else is set, bytes.
pub const JOB_MEMORY: NonZeroU64 = NonZeroU64::new(4 << 30).unwrap();

/// How soon a cancellation is seen.
const WATCH: Duration = Duration::from_millis(10);
/// Between a crash and the next try, times the crashes so far: memory that was short may be there then.
const PAUSE: Duration = Duration::from_secs(1);
/// Before the next try to start a process.
const LATER: Duration = Duration::from_secs(5);
/// What is kept of a child's stderr.
const COMPLAINT: u64 = 16 << 10;

/// Runs [`super::extraction::Extraction`], each time in a process of its own.
#[derive(Debug, Clone)]
pub struct Isolated {
    limits: Limits,
    memory: NonZeroU64,
    max_crashes: NonZeroU32,
}

/// How a child ended that gave no answer.
enum Death {
    NotStarted(io::Error),
    OverMemory,
    Died(ExitStatus),
}

type Answer = Result<Vec<Artifact>, JobFailure>;

impl Isolated {
    /// Refuses meshes beyond `limits`; fails a run that needs more than `memory` bytes, and one whose process died
    /// `max_crashes` times.
    pub fn new(limits: Limits, memory: NonZeroU64, max_crashes: NonZeroU32) -> Self {
        Self { limits, memory, max_crashes }
    }

    fn failure(&self, death: &Death, crashes: u32) -> JobFailure {
        match death {
            Death::OverMemory => JobFailure::out_of_memory(self.memory.get()),
            Death::NotStarted(error) => JobFailure::not_started(error),
            Death::Died(status) => JobFailure::run_crashed(crashes, &status.to_string()),
        }
    }
}

impl JobRunner for Isolated {
    fn run(&self, work: Work, control: &RunControl) -> Answer {
        let order = Order::new(&work, self.memory, &self.limits).line();
        let mut crashes = 0;
        loop {
            let death = match attempt(&order, &work.bytes, control) {
                Ok(answer) => return answer,
                Err(_) if control.cancel().is_cancelled() => return Err(JobFailure::cancelled()),
                Err(death) => death,
            };
            if let Death::NotStarted(error) = &death {
                // The machine is short of processes or memory, which says nothing of the job: it waits, as long as a run may take.
                tracing::error!(%error, "no process for a run; it is tried again");
                pause(LATER, control.cancel());
                continue;
            }
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
}

/// One process, from its start to its end.
fn attempt(order: &[u8], mesh: &[u8], control: &RunControl) -> Result<Answer, Death> {
    let (child, pipes) = start().map_err(Death::NotStarted)?;
    let (child, done) = (Mutex::new(child), AtomicBool::new(false));
    let (mut stdin, stdout, stderr) = pipes;
    std::thread::scope(|scope| {
        let watcher = scope.spawn(|| kill_when_cancelled(&child, control.cancel(), &done));
        // Hands the pipe back, so that it stays open until the child has ended.
        let _giver = scope.spawn(move || {
            // A child that died does not read: how it died is seen below.
            stdin.write_all(order).and_then(|()| stdin.write_all(mesh)).ok();
            stdin
        });
        let complaint = scope.spawn(move || complaint(stderr));
        let answer = listen(stdout, control);
        done.store(true, Ordering::Relaxed);
        watcher.thread().unpark();
        let status = end(&child);
        match (answer, status) {
            (Some(answer), _) => Ok(answer),
            (None, Err(error)) => Err(Death::NotStarted(error)),
            (None, Ok(status)) => Err(match complaint.join() {
                // What the standard library says before it aborts.
                Ok(text) if text.contains("memory allocation of") => Death::OverMemory,
                _ => Death::Died(status),
            }),
        }
    })
}

type Pipes = (ChildStdin, ChildStdout, ChildStderr);

fn start() -> io::Result<(Child, Pipes)> {
    let mut command = Command::new(program()?);
    // The allocator takes a GiB of addresses at its start; only what is used of them should count as the run's.
    command.arg(SUBCOMMAND).env_clear().env("MIMALLOC_ARENA_EAGER_COMMIT", "0");
    #[cfg(debug_assertions)]
    command.envs(std::env::var(faults::VARIABLE).map(|faults| (faults::VARIABLE, faults)));
    command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
    // Ctrl-C on the service's terminal is for the service, which stops its runs in order.
    #[cfg(unix)]
    std::os::unix::process::CommandExt::process_group(&mut command, 0);
    let mut child = command.spawn()?;
    match (child.stdin.take(), child.stdout.take(), child.stderr.take()) {
        (Some(stdin), Some(stdout), Some(stderr)) => Ok((child, (stdin, stdout, stderr))),
        _ => Err(io::Error::other("the run's process has no pipes")),
    }
}

/// This program, also when its file was replaced since.
pub fn program() -> io::Result<std::path::PathBuf> {
    let running = std::path::Path::new("/proc/self/exe");
    if running.exists() { Ok(running.to_owned()) } else { std::env::current_exe() }
}

/// Reaps the child, which has said its last word: it is not waited for.
fn end(child: &Mutex<Child>) -> io::Result<ExitStatus> {
    let mut child = child.lock().unwrap_or_else(PoisonError::into_inner);
    child.kill().ok();
    child.wait()
}

fn kill_when_cancelled(child: &Mutex<Child>, cancel: &CancelToken, done: &AtomicBool) {
    while !done.load(Ordering::Relaxed) {
        if cancel.is_cancelled() {
            // One that cannot be killed has ended.
            child.lock().unwrap_or_else(PoisonError::into_inner).kill().ok();
            return;
        }
        std::thread::park_timeout(WATCH);
    }
}

/// What the child answers; `None` when it ends without an answer.
fn listen(stdout: ChildStdout, control: &RunControl) -> Option<Answer> {
    let mut stdout = BufReader::new(stdout);
    let mut artifacts = Vec::new();
    loop {
        let mut line = Vec::new();
        stdout.by_ref().take(LONGEST_LINE).read_until(b'\n', &mut line).ok()?;
        match serde_json::from_slice(&line).ok()? {
            Word::Report { stage, fraction, before, share } => {
                control.report_part(JobStage::named(&stage)?, fraction, Part { before, share });
            }
            Word::Artifact { format, size } => {
                let format = OutputFormat::from_extension(&format)?;
                let mut bytes = Vec::new();
                stdout.by_ref().take(size).read_to_end(&mut bytes).ok()?;
                artifacts.push(Artifact { format, bytes });
            }
            Word::Failed(failure) => return Some(Err(failure)),
            Word::Panicked { place } => {
                tracing::error!(place, "panic");
                return Some(Err(JobFailure::panicked()));
            }
            Word::Done => return Some(Ok(artifacts)),
        }
    }
}

/// The beginning of what a child says on stderr; the rest is read and dropped.
fn complaint(mut stderr: ChildStderr) -> String {
    let mut text = Vec::new();
    // What cannot be read is not said.
    stderr.by_ref().take(COMPLAINT).read_to_end(&mut text).ok();
    io::copy(&mut stderr, &mut io::sink()).ok();
    String::from_utf8_lossy(&text).into_owned()
}

fn pause(length: Duration, cancel: &CancelToken) {
    let begin = Instant::now();
    while begin.elapsed() < length && !cancel.is_cancelled() {
        std::thread::sleep(WATCH);
    }
}
