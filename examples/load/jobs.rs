//! Small jobs from many clients to the end of the last, beside the same work in a loop in this process.

use std::sync::atomic::{AtomicU32, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use rosaline::centerline::{Control, Parameters, extract};
use rosaline::mesh::Units;
use rosaline::mesh::format::{Hint, Limits, read};
use rosaline::output::{OutputFormat, ResultDocument, Source, write};

use super::service::Service;
use super::wire::Client;

pub fn run(jobs: u32, clients: u32) {
    // 2,000 vertices.
    let mesh = super::tube_stl(80, 25);
    let looped = in_a_loop(jobs, &mesh);
    let service = Service::start();
    println!("idle: {:.1} MiB resident", mebibytes(service.settled()));
    for _ in 0..3 {
        let begin = Instant::now();
        to_their_end(&service, jobs, clients, &mesh);
        let rate = f64::from(jobs) / begin.elapsed().as_secs_f64();
        println!(
            "{jobs} jobs from {clients} clients: {rate:.1}/s, {:.2} of the loop's {looped:.1}/s; {:.1} MiB resident, \
             {:.1} MiB of its runs' processes",
            rate / looped,
            mebibytes(service.kibibytes("VmRSS")),
            mebibytes(service.of_runs()),
        );
    }
    // Longer than threads and processes wait for more to do.
    thread::sleep(Duration::from_secs(20));
    println!(
        "at rest: {:.1} MiB resident, {:.1} MiB of its runs' processes",
        mebibytes(service.settled()),
        mebibytes(service.of_runs()),
    );
}

fn mebibytes(kibibytes: u64) -> f64 {
    kibibytes as f64 / 1024.0
}

/// Extractions a second: read, extract and write every result format, nothing on disk.
fn in_a_loop(count: u32, mesh: &[u8]) -> f64 {
    let begin = Instant::now();
    let parameters = Parameters::default();
    for _ in 0..count {
        let (surface, format) = read(mesh, Hint::default(), &Limits::default()).unwrap();
        let extraction = extract(&surface, &parameters, &Control::silent()).unwrap();
        let source =
            Source { name: None, format: format.name(), sha256: &"0".repeat(64), units: Units::Millimetres };
        let document = ResultDocument::new(&extraction, &source, &parameters);
        std::hint::black_box(OutputFormat::ALL.map(|format| write(&document, format).unwrap()));
    }
    f64::from(count) / begin.elapsed().as_secs_f64()
}

fn to_their_end(service: &Service, jobs: u32, clients: u32, mesh: &[u8]) {
    let next = AtomicU32::new(0);
    thread::scope(|scope| {
        for _ in 0..clients {
            scope.spawn(|| {
                let mut client = Client::new(&service.address);
                let mut own = Vec::new();
                while next.fetch_add(1, Ordering::Relaxed) < jobs {
                    let answer = client.ask("POST /v1/jobs", mesh).unwrap();
                    assert_eq!(answer.status, 201);
                    own.push(answer.location);
                }
                own.iter().for_each(|job| service.wait_for(&mut client, job));
            });
        }
    });
}
