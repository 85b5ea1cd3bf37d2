//! Status stays fast while every worker computes.

use std::time::{Duration, Instant};

use crate::meshes;
use crate::service::Service;

const ASKS: usize = 300;

#[tokio::test]
async fn status_is_answered_while_all_workers_are_busy() {
    let service = Service::start(&["--workers", "2"]);
    let jobs = service.backlog(12, &meshes::large()).await;
    let mut times = Vec::with_capacity(ASKS);
    for ask in 0..ASKS {
        let begin = Instant::now();
        service.status(&jobs[ask % jobs.len()]).await;
        times.push(begin.elapsed());
    }
    // The oldest job runs first, so all workers had work until now.
    assert_eq!(service.status(&jobs[jobs.len() - 1]).await["status"], "accepted");
    times.sort();
    let (median, p99) = (times[ASKS / 2], times[ASKS * 99 / 100]);
    println!("status while busy: median {median:?}, p99 {p99:?}, max {:?}", times[ASKS - 1]);
    // Milliseconds on a machine of its own; the bound leaves room for a test suite beside it.
    assert!(median < Duration::from_millis(50), "{median:?}");
    assert!(p99 < Duration::from_millis(500), "{p99:?}");
    for job in jobs {
        service.delete(&job).send().await.unwrap();
    }
}
