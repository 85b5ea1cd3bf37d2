//! Polls of jobs, first with idle workers, then with busy ones.

use std::thread;
use std::time::{Duration, Instant};

use super::service::Service;
use super::wire::Client;

pub fn run(clients: u32, time: Duration) {
    let service = Service::start();
    let mut client = Client::new(&service.address);
    let ended = client.ask("POST /v1/jobs", &super::tube_stl(60, 24)).unwrap().location;
    service.wait_for(&mut client, &ended);
    poll("idle workers, /healthz", &service.address, &["/healthz".to_owned()], clients, time);
    poll("idle workers, a job that has ended", &service.address, &[ended], clients, time);
    let mesh = super::tube_stl(800, 150);
    let post = "POST /v1/jobs?smoothing=true";
    let jobs: Vec<String> = (0..40).map(|_| client.ask(post, &mesh).unwrap().location).collect();
    poll("busy workers, /healthz", &service.address, &["/healthz".to_owned()], clients, time);
    poll("busy workers, active jobs", &service.address, &jobs, clients, time);
    let last = client.ask(&format!("GET {}", jobs[jobs.len() - 1]), b"").unwrap().body;
    let last = String::from_utf8(last).unwrap();
    assert!(last.contains("\"accepted\""), "the workers ran out of work: {last}");
}

fn poll(what: &str, address: &str, jobs: &[String], clients: u32, time: Duration) {
    let begin = Instant::now();
    let one = |number: u32| {
        let mut client = Client::new(address);
        let request = format!("GET {}", jobs[number as usize % jobs.len()]);
        let mut times = Vec::new();
        while begin.elapsed() < time {
            let asked = Instant::now();
            assert_eq!(client.ask(&request, b"").unwrap().status, 200);
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
