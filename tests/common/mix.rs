//! Clients that upload, poll, download, cancel, dawdle and break off, all at the same time.

use std::collections::BTreeMap;
use std::thread;
use std::time::{Duration, Instant};

use super::wire::Client;

/// What a client does next, with its share in percent.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Act {
    Upload,
    Status,
    Result,
    Cancel,
    SlowUpload,
    Break,
    BadUpload,
}

const SHARES: [(Act, u64); 7] = [
    (Act::Upload, 15),
    (Act::Status, 50),
    (Act::Result, 15),
    (Act::Cancel, 8),
    (Act::SlowUpload, 4),
    (Act::Break, 4),
    (Act::BadUpload, 4),
];

impl Act {
    /// The answers that openapi.yaml has for it here; 503 stands for all of them.
    fn answers(self) -> &'static [u16] {
        match self {
            Act::Upload | Act::SlowUpload => &[201, 408, 429, 503],
            Act::Status => &[200, 404, 503],
            Act::Result => &[200, 404, 409, 503],
            Act::Cancel => &[200, 204, 404, 503],
            Act::BadUpload => &[400, 415, 422, 503],
            Act::Break => &[],
        }
    }
}

/// How it went.
#[derive(Default)]
pub struct Report {
    /// Times by what was done, unsorted.
    pub times: BTreeMap<Act, Vec<Duration>>,
    /// How often each answer came.
    pub answers: BTreeMap<(Act, u16), u64>,
    /// Answers that openapi.yaml does not have, and connections that failed.
    pub faults: Vec<String>,
}

impl Report {
    fn add(&mut self, other: Report) {
        for (act, times) in other.times {
            self.times.entry(act).or_default().extend(times);
        }
        for (answer, count) in other.answers {
            *self.answers.entry(answer).or_default() += count;
        }
        self.faults.extend(other.faults);
    }

    /// The time that this share of the requests was answered within.
    pub fn within(&self, act: Act, share: f64) -> Duration {
        let mut times = self.times.get(&act).cloned().unwrap_or_default();
        times.sort();
        let place = (times.len().saturating_sub(1) as f64 * share) as usize;
        times.get(place).copied().unwrap_or_default()
    }
}

/// Lets so many clients do as they like for a while, each with pauses of up to twice `pause`.
pub fn run(address: &str, mesh: &[u8], clients: u64, time: Duration, pause: Duration) -> Report {
    let end = Instant::now() + time;
    thread::scope(|scope| {
        let one = |seed| move || Actor::new(address, mesh, seed).act(end, pause);
        let threads: Vec<_> = (0..clients).map(|seed| scope.spawn(one(seed))).collect();
        threads.into_iter().fold(Report::default(), |mut all, thread| {
            all.add(thread.join().unwrap());
            all
        })
    })
}

struct Actor<'a> {
    client: Client,
    mesh: &'a [u8],
    random: u64,
    /// Jobs that this client made and did not purge.
    jobs: Vec<String>,
    report: Report,
}

impl<'a> Actor<'a> {
    fn new(address: &str, mesh: &'a [u8], seed: u64) -> Self {
        Self { client: Client::new(address), mesh, random: seed, jobs: Vec::new(), report: Report::default() }
    }

    /// SplitMix64.
    fn below(&mut self, end: u64) -> u64 {
        self.random = self.random.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.random;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        (z ^ (z >> 31)) % end.max(1)
    }

    fn act(mut self, end: Instant, pause: Duration) -> Report {
        while Instant::now() < end {
            let mut at = self.below(100);
            let next = SHARES.iter().find(|(_, share)| {
                let found = at < *share;
                at = at.saturating_sub(*share);
                found
            });
            let act = next.map_or(Act::Status, |(act, _)| *act);
            self.perform(if self.jobs.is_empty() && act != Act::Break { Act::Upload } else { act });
            thread::sleep(Duration::from_micros(self.below(2 * pause.as_micros() as u64)));
        }
        self.report
    }

    fn perform(&mut self, act: Act) {
        let place = self.below(self.jobs.len() as u64) as usize;
        let job = self.jobs.get(place).cloned().unwrap_or_default();
        let begin = Instant::now();
        let (post, mesh) = ("POST /v1/jobs", self.mesh);
        let asked = match act {
            Act::Upload => self.client.ask(post, mesh),
            Act::Status => self.client.ask(&format!("GET {job}"), b""),
            Act::Result => self.client.ask(&format!("GET {job}/results/centerline.json"), b""),
            Act::Cancel => self.client.ask(&format!("DELETE {job}"), b""),
            Act::SlowUpload => self.client.ask_slowly(post, mesh, mesh.len() / 8, Duration::from_millis(50)),
            Act::BadUpload => self.client.ask(post, &mesh[..mesh.len() / 2]),
            Act::Break => {
                let bytes = self.below(mesh.len() as u64) as usize;
                if let Err(error) = self.client.leave_after(post, mesh, bytes) {
                    self.report.faults.push(format!("{act:?}: {error}"));
                }
                return;
            }
        };
        let took = begin.elapsed();
        match asked {
            Ok(answer) => {
                if !act.answers().contains(&answer.status) {
                    let body = String::from_utf8_lossy(&answer.body).into_owned();
                    self.report.faults.push(format!("{act:?}: {} {body}", answer.status));
                }
                *self.report.answers.entry((act, answer.status)).or_default() += 1;
                self.report.times.entry(act).or_default().push(took);
                match answer.status {
                    201 => self.jobs.push(answer.location),
                    204 => drop(self.jobs.swap_remove(place)),
                    _ => {}
                }
            }
            Err(error) => self.report.faults.push(format!("{act:?}: {error}")),
        }
    }
}
