//! Load on the real service in release mode; `scripts/load` builds both and runs this.
//!
//!     load status [CLIENTS] [SECONDS]    polls of jobs, first with idle workers, then with busy ones
//!     load uploads [CLIENTS] [RINGS]     meshes of 1000 × RINGS vertices posted at the same time; peak memory
#![allow(clippy::unwrap_used, reason = "a tool for developers")]

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread;
use std::time::{Duration, Instant};

#[path = "../tests/common/meshes.rs"]
#[allow(dead_code, reason = "shared with the tests, which use all of it")]
mod meshes;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let number =
        |place: usize, default: u32| arguments.get(place).map_or(default, |text| text.parse().unwrap());
    match arguments.first().map(String::as_str) {
        Some("status") => status(number(1, 64), Duration::from_secs(number(2, 10).into())),
        Some("uploads") => uploads(number(1, 8), number(2, 1000)),
        _ => println!("load status [CLIENTS] [SECONDS] | load uploads [CLIENTS] [RINGS]"),
    }
}

/// Binary STL of an open tube along a quarter of a circle.
fn tube_stl(rings: u32, sides: u32) -> Vec<u8> {
    meshes::stl(&meshes::tube(rings, sides))
}

/// A running service with a data folder of its own.
struct Service {
    child: Child,
    address: String,
    _data: tempfile::TempDir,
}

impl Service {
    fn start() -> Self {
        let data = tempfile::tempdir().unwrap();
        // Beside the folder of examples.
        let program = std::env::current_exe().unwrap().parent().unwrap().with_file_name("rosaline");
        let mut command = Command::new(program);
        command.args(["serve", "--listen", "127.0.0.1:0", "--data"]).arg(data.path());
        command.args(std::env::var("SERVE").unwrap_or_default().split_whitespace());
        let mut child = command.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let address = line.trim().strip_prefix("listening on http://").unwrap().to_owned();
        Self { child, address, _data: data }
    }

    /// A line of /proc/PID/status in MiB.
    fn memory(&self, name: &str) -> u64 {
        let text = std::fs::read_to_string(format!("/proc/{}/status", self.child.id())).unwrap();
        let line = text.lines().find(|line| line.starts_with(name)).unwrap();
        line.split_whitespace().nth(1).unwrap().parse::<u64>().unwrap() / 1024
    }
}

impl Drop for Service {
    fn drop(&mut self) {
        self.child.kill().ok();
        self.child.wait().ok();
    }
}

/// One connection, kept open.
struct Client(BufReader<TcpStream>);

impl Client {
    fn new(address: &str) -> Self {
        let stream = TcpStream::connect(address).unwrap();
        stream.set_nodelay(true).unwrap();
        Self(BufReader::new(stream))
    }

    /// Status, `Location` and body.
    fn ask(&mut self, head: &str, body: &[u8]) -> (u16, String, String) {
        let stream = self.0.get_mut();
        stream
            .write_all(format!("{head}\r\nHost: x\r\nContent-Length: {}\r\n\r\n", body.len()).as_bytes())
            .unwrap();
        stream.write_all(body).unwrap();
        let (mut status, mut length, mut location) = (0, 0, String::new());
        for place in 0.. {
            let mut line = String::new();
            self.0.read_line(&mut line).unwrap();
            if place == 0 {
                status = line.split(' ').nth(1).unwrap().parse().unwrap();
            }
            let Some((name, value)) = line.trim_end().split_once(": ") else {
                if place > 0 {
                    break;
                }
                continue;
            };
            match name {
                "content-length" => length = value.parse().unwrap(),
                "location" => location = value.to_owned(),
                _ => {}
            }
        }
        let mut body = vec![0; length];
        self.0.read_exact(&mut body).unwrap();
        (status, location, String::from_utf8(body).unwrap())
    }
}

fn status(clients: u32, time: Duration) {
    let service = Service::start();
    let mut client = Client::new(&service.address);
    let ended = client.ask("POST /v1/jobs HTTP/1.1\r\nPrefer: wait=60", &tube_stl(60, 24)).1;
    poll("idle workers, /healthz", &service.address, &["/healthz".to_owned()], clients, time);
    poll("idle workers, a job that has ended", &service.address, &[ended], clients, time);
    let mesh = tube_stl(800, 150);
    let post = "POST /v1/jobs?smoothing=true HTTP/1.1";
    let jobs: Vec<String> = (0..40).map(|_| client.ask(post, &mesh).1).collect();
    poll("busy workers, /healthz", &service.address, &["/healthz".to_owned()], clients, time);
    poll("busy workers, active jobs", &service.address, &jobs, clients, time);
    let last = client.ask(&format!("GET {} HTTP/1.1", jobs[jobs.len() - 1]), b"").2;
    assert!(last.contains("\"accepted\""), "the workers ran out of work: {last}");
}

fn poll(what: &str, address: &str, jobs: &[String], clients: u32, time: Duration) {
    let begin = Instant::now();
    let one = |number: u32| {
        let mut client = Client::new(address);
        let request = format!("GET {} HTTP/1.1", jobs[number as usize % jobs.len()]);
        let mut times = Vec::new();
        while begin.elapsed() < time {
            let asked = Instant::now();
            assert_eq!(client.ask(&request, b"").0, 200);
            times.push(asked.elapsed());
        }
        times
    };
    let mut times: Vec<Duration> = thread::scope(|scope| {
        let threads: Vec<_> = (0..clients).map(|number| scope.spawn(move || one(number))).collect();
        threads.into_iter().flat_map(|thread| thread.join().unwrap()).collect()
    });
    times.sort();
    let at = |share: f64| times[((times.len() - 1) as f64 * share) as usize];
    println!(
        "{what}: {clients} clients, {:.0}/s, p50 {:?}, p99 {:?}, p99.9 {:?}, max {:?}",
        times.len() as f64 / time.as_secs_f64(),
        at(0.5),
        at(0.99),
        at(0.999),
        at(1.0),
    );
}

fn uploads(clients: u32, rings: u32) {
    let good = tube_stl(rings, 1000);
    // Found only after the whole mesh was read; no job comes of it.
    let mut bad = good.clone();
    let last = bad.len() - 10;
    bad[last..last + 4].copy_from_slice(&f32::NAN.to_le_bytes());
    for (what, mesh, expected) in [("refused after validation", bad, 422), ("accepted, jobs run", good, 201)]
    {
        let service = Service::start();
        let before = service.memory("VmRSS");
        let (peak, done) = (AtomicU64::new(0), AtomicBool::new(false));
        let begin = Instant::now();
        thread::scope(|scope| {
            let posts: Vec<_> = (0..clients)
                .map(|_| scope.spawn(|| Client::new(&service.address).ask("POST /v1/jobs HTTP/1.1", &mesh).0))
                .collect();
            scope.spawn(|| {
                while !done.load(Ordering::Relaxed) {
                    peak.fetch_max(service.memory("VmRSS"), Ordering::Relaxed);
                    thread::sleep(Duration::from_millis(20));
                }
            });
            for post in posts {
                assert_eq!(post.join().unwrap(), expected);
            }
            done.store(true, Ordering::Relaxed);
        });
        println!(
            "{what}: {clients} clients, {} MB each, answered within {:.1} s; resident: {before} MiB before, {} MiB peak \
             while posting, {} MiB peak (VmHWM)",
            mesh.len() / 1_000_000,
            begin.elapsed().as_secs_f64(),
            peak.into_inner(),
            service.memory("VmHWM"),
        );
    }
}
