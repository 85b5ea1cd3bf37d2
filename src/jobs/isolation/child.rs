//! The process of runs.

use std::io::{self, BufRead, ErrorKind, Read, Write};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Mutex, PoisonError};

use rayon::{ThreadPool, ThreadPoolBuilder};
use rustix::event::{PollFd, PollFlags, poll};
use rustix::io::Errno;
use rustix::process::{Resource, Rlimit, getrlimit, nice, setrlimit};
use tokio::signal::unix::{SignalKind, signal};

use super::words::{LONGEST_LINE, Order, Word, line};
use crate::centerline::{CancelToken, Part};
use crate::jobs::extraction::Extraction;
use crate::jobs::faults::{Operation, Side, pass};
use crate::jobs::live::coarse;
use crate::jobs::runner::Artifact;
use crate::jobs::slots::STACK;
use crate::jobs::{JobFailure, JobStage};

/// Where the last panic was.
static PLACE: Mutex<String> = Mutex::new(String::new());

/// How much the process steps back behind others: the service answers first, and its runs share what is left.
const NICE: i32 = 10;
/// The stack of the thread that does nothing but wait, bytes.
const SMALL_STACK: usize = 64 << 10;

/// Works off the jobs that stdin tells of, one after the other, and answers on stdout. For the process that
/// [`super::Isolated`] starts, and no other: it changes what the whole process does at signals and panics.
///
/// # Errors
/// When the parent is gone, or the limit of memory cannot be set.
pub fn work_off() -> io::Result<()> {
    outlive_stop_signals()?;
    // A core dump would hold the mesh and its name, outside of the data folder.
    setrlimit(Resource::Core, Rlimit { current: Some(0), maximum: Some(0) })?;
    // Where memory runs out, the system should end the run, not the service. Not every system has this.
    std::fs::write("/proc/self/oom_score_adj", "1000").ok();
    // Threads have it from the one that starts them. One that may not be nicer works all the same.
    nice(NICE).ok();
    std::panic::set_hook(Box::new(|info| {
        let place = info.location().map(ToString::to_string).unwrap_or_default();
        *PLACE.lock().unwrap_or_else(PoisonError::into_inner) = place;
    }));
    std::thread::Builder::new().stack_size(SMALL_STACK).spawn(go_with_the_parent)?;
    let mut pool = None;
    while let Some((order, mesh)) = receive()? {
        let fits = |pool: &ThreadPool| pool.current_num_threads() == order.threads;
        let pool = match pool.take().filter(fits) {
            Some(kept) => pool.insert(kept),
            None => pool.insert(start_pool(order.threads)?),
        };
        run(order, mesh, pool)?;
    }
    Ok(())
}

fn start_pool(threads: usize) -> io::Result<ThreadPool> {
    let pool = ThreadPoolBuilder::new().num_threads(threads).stack_size(STACK).build();
    pool.map_err(io::Error::other)
}

/// One job, and its answer. Nothing of it is left when this returns.
fn run(order: Order, mesh: Vec<u8>, pool: &ThreadPool) -> io::Result<()> {
    let limits = order.limits();
    let work = order.work(mesh);
    let teller = Teller::default();
    teller.say(&line(&Word::Begun))?;
    let report = |stage: JobStage, fraction: f64, part: Part| teller.report(stage, fraction, part);
    let run = || {
        pass(Operation::Method, Side::Before).map_err(|error| JobFailure::not_started(&error))?;
        let run = || Extraction::new(limits).perform(work, &CancelToken::new(), &report);
        let artifacts = pool.install(run)?;
        pass(Operation::Method, Side::After).map_err(|error| JobFailure::not_started(&error))?;
        Ok(artifacts)
    };
    match catch_unwind(AssertUnwindSafe(run)) {
        Ok(Ok(artifacts)) => teller.results(&artifacts),
        Ok(Err(failure)) => teller.say(&line(&Word::Failed(failure))),
        Err(_) => {
            let place = PLACE.lock().unwrap_or_else(PoisonError::into_inner).clone();
            teller.say(&line(&Word::Panicked { place }))
        }
    }
}

/// A service manager may stop every process of the service at once; the parent says when a run is to end.
fn outlive_stop_signals() -> io::Result<()> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_io().build()?;
    let _inside = runtime.enter();
    for kind in [SignalKind::terminate(), SignalKind::interrupt(), SignalKind::hangup()] {
        // The handler stays when the stream is dropped.
        drop(signal(kind)?);
    }
    Ok(())
}

/// The next order and its mesh, read under the order's limit of memory; `None`: there is none any more.
fn receive() -> io::Result<Option<(Order, Vec<u8>)>> {
    let mut stdin = io::stdin().lock();
    let mut head = Vec::new();
    stdin.by_ref().take(LONGEST_LINE).read_until(b'\n', &mut head)?;
    if head.is_empty() {
        return Ok(None);
    }
    let order: Order = serde_json::from_slice(&head)?;
    limit_memory(order.memory.get().saturating_add((order.threads * STACK) as u64))?;
    let mut mesh = Vec::with_capacity(usize::try_from(order.size).map_err(io::Error::other)?);
    stdin.take(order.size).read_to_end(&mut mesh)?;
    if mesh.len() as u64 == order.size {
        Ok(Some((order, mesh)))
    } else {
        Err(ErrorKind::UnexpectedEof.into())
    }
}

/// Bounds what this process may allocate: past it, an allocation fails and the process aborts.
fn limit_memory(bytes: u64) -> io::Result<()> {
    let most = getrlimit(Resource::Data).maximum;
    let bytes = Some(most.map_or(bytes, |most| bytes.min(most)));
    Ok(setrlimit(Resource::Data, Rlimit { current: bytes, maximum: bytes })?)
}

/// Ends this process when its parent has: nobody wants the result.
fn go_with_the_parent() {
    let stdin = io::stdin();
    // No event is asked for: what is told in any case is that the other end was closed.
    let mut pipe = [PollFd::new(&stdin, PollFlags::empty())];
    while let Err(Errno::INTR) = poll(&mut pipe, None) {}
    std::process::exit(1);
}

/// Says words on stdout.
#[derive(Default)]
struct Teller {
    told: AtomicU32,
    turn: Mutex<()>,
}

impl Teller {
    fn say(&self, bytes: &[u8]) -> io::Result<()> {
        let _turn = self.turn.lock().unwrap_or_else(PoisonError::into_inner);
        let mut stdout = io::stdout().lock();
        stdout.write_all(bytes)?;
        stdout.flush()
    }

    /// Says whole percents and new stages, whatever the method reports.
    fn report(&self, stage: JobStage, fraction: f64, part: Part) {
        let now = coarse(stage, fraction, part);
        if self.told.fetch_max(now, Ordering::Relaxed) < now {
            let Part { before, share } = part;
            let word = Word::Report { stage: stage.name().to_owned(), fraction, before, share };
            // A parent that does not listen has ended; so does this process.
            self.say(&line(&word)).ok();
        }
    }

    fn results(&self, artifacts: &[Artifact]) -> io::Result<()> {
        for Artifact { format, bytes } in artifacts {
            let word = Word::Artifact { format: format.extension().to_owned(), size: bytes.len() as u64 };
            self.say(&line(&word))?;
            self.say(bytes)?;
        }
        self.say(&line(&Word::Done))
    }
}
