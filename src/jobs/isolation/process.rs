//! The parent's end of one process: what it is told and what it answers, on the calling thread alone.

use std::io::{self, ErrorKind, IoSlice, Read, Write};
use std::process::{Child, ChildStderr, ChildStdin, ChildStdout, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::{Errno, ioctl_fionbio};

use super::hearing::{Answer, Hearing};
use super::{SUBCOMMAND, program};
#[cfg(debug_assertions)]
use crate::jobs::faults;
use crate::jobs::runner::RunControl;

/// How soon a cancellation is seen.
const WATCH: Timespec = Timespec { tv_sec: 0, tv_nsec: 10_000_000 };
/// What is kept of a child's stderr.
const COMPLAINT: usize = 16 << 10;
/// Bytes that are read at once: what a pipe holds.
const STEP: usize = 64 << 10;

/// A process for runs, one after the other. It is killed and reaped when this is dropped.
#[derive(Debug)]
pub(super) struct Process {
    child: Child,
    stdin: ChildStdin,
    stdout: ChildStdout,
    stderr: ChildStderr,
    complaint: Vec<u8>,
    /// What it complains of may go on.
    complains: bool,
    /// Runs that it has answered.
    runs: u32,
    /// When it ended its last run.
    rests: Instant,
}

/// How a process ended that gave no answer.
pub(super) enum Death {
    OverMemory,
    Died(ExitStatus),
    /// It said what is no word, or more than it may, or it cannot be heard or waited for.
    Astray(io::Error),
    /// It was at rest, and gone before it had begun with the run.
    AtRest,
}

impl Process {
    /// # Errors
    /// When no process can be started; the system's reason.
    pub(super) fn start() -> io::Result<Self> {
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
        let pipes = (child.stdin.take(), child.stdout.take(), child.stderr.take());
        let (Some(stdin), Some(stdout), Some(stderr)) = pipes else {
            child.kill().ok();
            child.wait()?;
            return Err(io::Error::other("the run's process has no pipes"));
        };
        let process = Self {
            child,
            stdin,
            stdout,
            stderr,
            complaint: Vec::new(),
            complains: true,
            runs: 0,
            rests: Instant::now(),
        };
        ioctl_fionbio(&process.stdin, true)?;
        ioctl_fionbio(&process.stdout, true)?;
        ioctl_fionbio(&process.stderr, true)?;
        Ok(process)
    }

    /// Whether it had a run before.
    pub(super) fn is_used(&self) -> bool {
        self.runs > 0
    }

    pub(super) fn rested(&self) -> Duration {
        self.rests.elapsed()
    }

    /// Bytes of memory that are its own alone; `None` where the system does not tell.
    pub(super) fn memory(&self) -> Option<u64> {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.child.id())).ok()?;
        let line = status.lines().find_map(|line| line.strip_prefix("RssAnon:"))?;
        line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()?.checked_mul(1 << 10)
    }

    /// One run: gives the order and the mesh, hears the answer. A cancelled one ends without an answer; what else
    /// ends without one is a [`Death`], after which this process is of no use any more.
    pub(super) fn work_off(
        &mut self,
        order: &[u8],
        mesh: &[u8],
        limit: u64,
        control: &RunControl,
    ) -> Result<Answer, Death> {
        self.complaint.clear();
        let mut hearing = Hearing::new(limit);
        let mut told = [IoSlice::new(order), IoSlice::new(mesh)];
        let answer = self.converse(&mut told, &mut hearing, control);
        self.rests = Instant::now();
        match answer {
            Ok(Some(answer)) => {
                self.runs += 1;
                Ok(answer)
            }
            Ok(None) if self.is_used() && !hearing.has_begun() => Err(Death::AtRest),
            Ok(None) => Err(self.died()),
            Err(error) => Err(Death::Astray(error)),
        }
    }

    /// `None` when the process ends, or the run is cancelled.
    fn converse(
        &mut self,
        mut told: &mut [IoSlice<'_>],
        hearing: &mut Hearing,
        control: &RunControl,
    ) -> io::Result<Option<Answer>> {
        let mut bytes = vec![0; STEP];
        while !control.cancel().is_cancelled() {
            let ready = self.wait(!told.is_empty())?;
            if ready.to_tell {
                match self.stdin.write_vectored(told) {
                    Ok(length) => IoSlice::advance_slices(&mut told, length),
                    Err(error) if is_passing(&error) => {}
                    // It does not listen any more; how it ended is seen below.
                    Err(_) => told = &mut [],
                }
            }
            if ready.to_complain {
                self.hear_complaints(&mut bytes);
            }
            if ready.to_hear {
                match self.stdout.read(&mut bytes) {
                    Ok(0) => return Ok(None),
                    Ok(length) => {
                        if let Some(answer) = hearing.hear(&bytes[..length], control)? {
                            return Ok(Some(answer));
                        }
                    }
                    Err(error) if is_passing(&error) => {}
                    Err(error) => return Err(error),
                }
            }
        }
        Ok(None)
    }

    /// Waits until a pipe is ready, not longer than [`WATCH`].
    fn wait(&self, tells: bool) -> io::Result<Ready> {
        let mut pipes = vec![PollFd::new(&self.stdout, PollFlags::IN)];
        if self.complains {
            pipes.push(PollFd::new(&self.stderr, PollFlags::IN));
        }
        if tells {
            pipes.push(PollFd::new(&self.stdin, PollFlags::OUT));
        }
        match poll(&mut pipes, Some(&WATCH)) {
            Ok(_) | Err(Errno::INTR) => {}
            Err(error) => return Err(error.into()),
        }
        // Also at the other end's closing and at errors, which the next read or write tells.
        let is_ready = |pipe: Option<&PollFd<'_>>| pipe.is_some_and(|pipe| !pipe.revents().is_empty());
        Ok(Ready {
            to_hear: is_ready(pipes.first()),
            to_complain: self.complains && is_ready(pipes.get(1)),
            to_tell: tells && is_ready(pipes.last()),
        })
    }

    /// Keeps the beginning of what is said on stderr.
    fn hear_complaints(&mut self, bytes: &mut [u8]) {
        match self.stderr.read(bytes) {
            Ok(length) if length > 0 => {
                let kept = length.min(COMPLAINT.saturating_sub(self.complaint.len()));
                self.complaint.extend_from_slice(&bytes[..kept]);
            }
            Err(error) if is_passing(&error) => {}
            _ => self.complains = false,
        }
    }

    /// How it died; it is killed where it has not.
    fn died(&mut self) -> Death {
        self.child.kill().ok();
        let status = match self.child.wait() {
            Ok(status) => status,
            Err(error) => return Death::Astray(error),
        };
        // What it said last is in the pipe; nobody else holds its other end.
        let mut bytes = vec![0; COMPLAINT];
        while self.complains && self.wait(false).is_ok_and(|ready| ready.to_complain) {
            self.hear_complaints(&mut bytes);
        }
        // What the standard library says before it aborts.
        if String::from_utf8_lossy(&self.complaint).contains("memory allocation of") {
            Death::OverMemory
        } else {
            Death::Died(status)
        }
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        // One that cannot be killed has ended.
        self.child.kill().ok();
        self.child.wait().ok();
    }
}

/// The pipes that something can be done with.
struct Ready {
    to_tell: bool,
    to_hear: bool,
    to_complain: bool,
}

/// Whether the same is to be tried again.
fn is_passing(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted)
}
