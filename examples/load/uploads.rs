//! Large meshes posted at the same time: how much memory they take.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use super::service::Service;
use super::wire::Client;

pub fn run(clients: u32, rings: u32) {
    let good = super::tube_stl(rings, 1000);
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
                .map(|_| {
                    scope.spawn(|| Client::new(&service.address).ask("POST /v1/jobs", &mesh).unwrap().status)
                })
                .collect();
            scope.spawn(|| {
                while !done.load(Ordering::Relaxed) {
                    peak.fetch_max(service.memory("VmRSS"), Ordering::Relaxed);
                    thread::sleep(Duration::from_millis(20));
                }
            });
            let statuses: Vec<_> = posts.into_iter().map(|post| post.join()).collect();
            // Before one that failed ends this scope, which waits for the sampling thread.
            done.store(true, Ordering::Relaxed);
            for status in statuses {
                assert_eq!(status.unwrap(), expected);
            }
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
