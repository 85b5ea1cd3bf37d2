//! Runners that do what a job's input says, and services around them.

use std::collections::HashMap;
use std::num::NonZeroUsize;
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use bytes::Bytes;
use futures::stream;
use rayon::prelude::*;
use rosaline::centerline::{CancelToken, Stage};
use rosaline::jobs::runner::{Artifact, JobRunner, RunControl, Work};
use rosaline::jobs::{Job, JobFailure, JobId, JobService, JobSpec, JobStage, JobStatus, Settings};
use rosaline::output::OutputFormat;

/// Runs scripts: the input's text is a word and, for some, milliseconds.
///
/// `ok` ends at once, `sleep N` after N ms unless cancelled, `spin` computes on the whole pool until it is
/// cancelled, `deaf N` ignores its cancellation for N ms, `hold` waits for [`Script::let_go`]; `fail`,
/// `panic` and `abort` do so.
#[derive(Default)]
pub struct Script {
    runs: Mutex<HashMap<String, usize>>,
    begun: Mutex<Vec<String>>,
    running: AtomicUsize,
    most: AtomicUsize,
    ended: Mutex<Option<Instant>>,
    free: AtomicBool,
}

impl Script {
    pub fn new() -> Arc<Self> {
        Arc::new(Self::default())
    }

    /// How often an input was run.
    pub fn runs(&self, script: &str) -> usize {
        self.runs.lock().unwrap().get(script).copied().unwrap_or(0)
    }

    /// Every input that was run, with how often.
    pub fn all_runs(&self) -> HashMap<String, usize> {
        self.runs.lock().unwrap().clone()
    }

    /// Inputs in the order in which their runs began.
    pub fn begun(&self) -> Vec<String> {
        self.begun.lock().unwrap().clone()
    }

    pub fn running(&self) -> usize {
        self.running.load(Ordering::SeqCst)
    }

    /// The most that ran at once.
    pub fn most(&self) -> usize {
        self.most.load(Ordering::SeqCst)
    }

    /// When a run last ended.
    pub fn ended(&self) -> Option<Instant> {
        *self.ended.lock().unwrap()
    }

    pub fn let_go(&self) {
        self.free.store(true, Ordering::SeqCst);
    }

    fn obey(&self, script: &str, control: &RunControl) -> Result<(), JobFailure> {
        let mut words = script.split(' ');
        let word = words.next().unwrap();
        let pause = Duration::from_millis(words.next().and_then(|text| text.parse().ok()).unwrap_or(0));
        match word {
            "ok" => Ok(()),
            "sleep" => wait(pause, || control.cancel().is_cancelled()),
            "deaf" => wait(pause, || false),
            "hold" => {
                wait(Duration::from_secs(60), || {
                    self.free.load(Ordering::SeqCst) || control.cancel().is_cancelled()
                })
                .ok();
                Ok(())
            }
            "spin" => spin(control.cancel()),
            "fail" => Err(JobFailure::new("no-triangles", 422, "No centerline", "the mesh has no triangles")),
            "panic" => panic!("patient DOE"),
            "abort" => std::process::abort(),
            _ => Err(JobFailure::new("script", 400, "Unknown script", script)),
        }
    }
}

/// Err when `stop` came true within `pause`.
fn wait(pause: Duration, stop: impl Fn() -> bool) -> Result<(), JobFailure> {
    let began = Instant::now();
    while began.elapsed() < pause {
        if stop() {
            return Err(JobFailure::new("cancelled", 499, "Cancelled", ""));
        }
        std::thread::sleep(Duration::from_millis(2));
    }
    Ok(())
}

fn spin(cancel: &CancelToken) -> Result<(), JobFailure> {
    (0..rayon::current_num_threads() * 4).into_par_iter().for_each(|seed| {
        let mut number = seed as f64;
        while !cancel.is_cancelled() {
            for _ in 0..1000 {
                number = std::hint::black_box((number * 1.000_1).sin() + 2.0);
            }
        }
    });
    Err(JobFailure::new("cancelled", 499, "Cancelled", ""))
}

impl JobRunner for Script {
    fn run(&self, work: Work, control: &RunControl) -> Result<Vec<Artifact>, JobFailure> {
        let script = String::from_utf8(work.bytes.to_vec()).unwrap();
        *self.runs.lock().unwrap().entry(script.clone()).or_default() += 1;
        self.begun.lock().unwrap().push(script.clone());
        let running = self.running.fetch_add(1, Ordering::SeqCst) + 1;
        self.most.fetch_max(running, Ordering::SeqCst);
        control.report(JobStage::Method(Stage::Tips), 0.5);
        let outcome = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| self.obey(&script, control)));
        self.running.fetch_sub(1, Ordering::SeqCst);
        *self.ended.lock().unwrap() = Some(Instant::now());
        outcome.unwrap_or_else(|panic| std::panic::resume_unwind(panic))?;
        Ok(OutputFormat::ALL.into_iter().map(|format| artifact(&script, format)).collect())
    }
}

fn artifact(script: &str, format: OutputFormat) -> Artifact {
    Artifact { format, bytes: result_of(script, format) }
}

/// What a good run of `script` gives.
pub fn result_of(script: &str, format: OutputFormat) -> Vec<u8> {
    format!("{script} as {}", format.extension()).into_bytes()
}

/// Settings for tests: this many workers, a thread each, and nothing that polling could hide.
pub fn settings(data: &Path, workers: usize) -> Settings {
    let workers = NonZeroUsize::new(workers).unwrap();
    Settings {
        workers,
        threads_per_worker: NonZeroUsize::MIN,
        poll: Duration::from_secs(3600),
        flush: Duration::from_millis(50),
        // The disks of some tests are small.
        least_free: 1 << 20,
        ..Settings::new(data)
    }
}

/// Stores and submits a script.
pub async fn submit(service: &JobService, script: &str) -> Job {
    let body = stream::iter([Ok(Bytes::from(script.to_owned()))]);
    let upload = service.upload(body, 1 << 20).await.unwrap();
    service.submit(upload, JobSpec::default()).await.unwrap()
}

/// Waits for the job's end, half a minute at most.
pub async fn ended(service: &JobService, id: JobId) -> Job {
    let job = service.wait(id, Duration::from_secs(30)).await.unwrap();
    assert!(!job.status.is_active(), "{job:?}");
    job
}

/// Waits until the job runs.
pub async fn running(service: &JobService, id: JobId) -> Job {
    until(async || {
        let job = service.status(id).await.unwrap();
        (job.status == JobStatus::Running && job.progress > 0).then_some(job)
    })
    .await
}

/// Asks until there is an answer, half a minute at most.
pub async fn until<T>(mut ask: impl AsyncFnMut() -> Option<T>) -> T {
    let began = Instant::now();
    loop {
        if let Some(answer) = ask().await {
            return answer;
        }
        assert!(began.elapsed() < Duration::from_secs(30), "it never happened");
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
}

/// Every file below `folder`, by its path from there.
pub fn files(folder: &Path) -> Vec<String> {
    let mut names = Vec::new();
    for entry in std::fs::read_dir(folder).into_iter().flatten() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_str().unwrap().to_owned();
        if path.is_dir() {
            names.extend(files(&path).into_iter().map(|inner| format!("{name}/{inner}")));
        } else {
            names.push(name);
        }
    }
    names.sort();
    names
}
