//! Small meshes posted while large ones are checked: whether they wait for these.

use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use super::service::Service;
use super::wire::Client;

/// Small meshes that are measured with each number of large ones.
const SMALL: usize = 60;
/// Until the first large mesh has come in.
const START: Duration = Duration::from_millis(1500);

pub fn run(most: u32, rings: u32) {
    let (large, small) = (super::tube_stl(rings, 1000), super::tube_stl(84, 24));
    let path = "POST /v1/jobs?dry_run=true";
    for count in 0..=most {
        let (service, done) = (Service::start(), AtomicBool::new(false));
        let times = thread::scope(|scope| {
            for _ in 0..count {
                scope.spawn(|| {
                    while !done.load(Ordering::Relaxed) {
                        assert_eq!(Client::new(&service.address).ask(path, &large).unwrap().status, 200);
                    }
                });
            }
            if count > 0 {
                thread::sleep(START);
            }
            let mut client = Client::new(&service.address);
            let answers: Vec<_> = (0..SMALL)
                .map(|_| {
                    let begin = Instant::now();
                    (client.ask(path, &small), begin.elapsed())
                })
                .collect();
            // Before one that failed ends this scope, which waits for the others.
            done.store(true, Ordering::Relaxed);
            let answered = answers.into_iter().map(|(answer, time)| {
                assert_eq!(answer.unwrap().status, 200);
                time
            });
            let mut times: Vec<Duration> = answered.collect();
            times.sort();
            times
        });
        let at = |share: usize| times[(SMALL * share / 100).min(SMALL - 1)].as_millis();
        println!(
            "{count} clients post {} MB again and again; a dry run of {} kB takes {} ms (p50), {} ms (p90), {} ms at most",
            large.len() / 1_000_000,
            small.len() / 1000,
            at(50),
            at(90),
            at(100),
        );
    }
}
