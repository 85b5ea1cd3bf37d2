//! Every kind of client at once: the answers, the times of polls, and memory as it goes.

use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use super::mix::{self, Act};
use super::service::Service;

/// Mean pause of a client between two requests.
const PAUSE: Duration = Duration::from_millis(1000);

/// How often memory is told in one run.
const SAMPLES: u32 = 10;

pub fn run(clients: u32, time: Duration) {
    let service = Service::start();
    let mesh = super::meshes::small();
    let done = AtomicBool::new(false);
    println!("before: {:.1} MiB resident", service.kibibytes("VmRSS") as f64 / 1024.0);
    let report = thread::scope(|scope| {
        scope.spawn(|| {
            let begin = Instant::now();
            for sample in 1..=SAMPLES {
                while begin.elapsed() < time * sample / SAMPLES && !done.load(Ordering::Relaxed) {
                    thread::sleep(Duration::from_millis(20));
                }
                let memory = service.kibibytes("VmRSS") as f64 / 1024.0;
                println!("after {:.0} s: {memory:.1} MiB resident", begin.elapsed().as_secs_f64());
            }
        });
        let report = mix::run(&service.address, &mesh, clients.into(), time, PAUSE);
        done.store(true, Ordering::Relaxed);
        report
    });
    for ((act, status), count) in &report.answers {
        println!("{act:?} {status}: {count}");
    }
    for act in [Act::Status, Act::Result, Act::Upload, Act::Cancel] {
        let at = |share| report.within(act, share);
        println!(
            "{act:?}: p50 {:?}, p99 {:?}, p99.9 {:?}, longest {:?}",
            at(0.5),
            at(0.99),
            at(0.999),
            at(1.0)
        );
    }
    println!("answers that are not documented, and failed connections: {}", report.faults.len());
    report.faults.iter().take(20).for_each(|fault| println!("  {fault}"));
}
