//! Runs in processes of their own: memory that is bounded, crashes that stay alone, cancellations that are obeyed.

use std::fs;
use std::process::Command;
use std::time::{Duration, Instant};

use serde_json::Value;

use crate::common::shared;
use crate::meshes;
use crate::service::{PATIENCE, Service};

/// The processes that a process started.
fn children(parent: u32) -> Vec<u32> {
    let mut found = Vec::new();
    for entry in fs::read_dir("/proc").unwrap() {
        let Ok(pid) = entry.unwrap().file_name().to_string_lossy().parse::<u32>() else { continue };
        let Ok(stat) = fs::read_to_string(format!("/proc/{pid}/stat")) else { continue };
        // "pid (name) state parent ...": the name may have spaces.
        let mut rest = stat.rsplit(") ").next().unwrap().split(' ');
        if rest.next() != Some("Z") && rest.next() == Some(&parent.to_string()) {
            found.push(pid);
        }
    }
    found
}

async fn until<T>(mut ask: impl FnMut() -> Option<T>) -> T {
    let begin = Instant::now();
    loop {
        if let Some(answer) = ask() {
            return answer;
        }
        assert!(begin.elapsed() < PATIENCE, "it never happened");
        tokio::time::sleep(Duration::from_millis(2)).await;
    }
}

/// Sends a signal to the one run of a service.
async fn signal_run(service: &Service, signal: &str, but: Option<u32>) -> u32 {
    let pid = service.pid();
    let run = until(|| children(pid).into_iter().find(|&run| Some(run) != but)).await;
    assert!(Command::new("kill").args([signal, &run.to_string()]).status().unwrap().success());
    run
}

#[tokio::test]
async fn a_job_over_its_memory_is_failed_and_the_service_goes_on() {
    let service = Service::start(&["--workers", "1", "--max-memory", "64MiB"]);
    let limits: Value = service.get("/v1/limits").send().await.unwrap().json().await.unwrap();
    assert_eq!(limits["job_memory_bytes"], 64 << 20);
    let job = service.accepted("", meshes::stl(&meshes::tube(1500, 150))).await;
    let status = service.ended(&job).await;
    assert_eq!(status["status"], "failed", "{status} {}", service.log());
    assert_eq!(status["error"]["type"], "urn:rosaline:problem:memory-limit");
    assert_eq!(status["error"]["status"], 422);
    assert!(status["error"]["detail"].as_str().unwrap().contains("--max-memory"), "{status}");
    let small = service.accepted("", meshes::small()).await;
    assert_eq!(service.ended(&small).await["status"], "successful", "{}", service.log());
    // The same in the process that had the small one.
    let again = service.accepted("", meshes::stl(&meshes::tube(1500, 150))).await;
    assert_eq!(service.ended(&again).await["error"]["type"], "urn:rosaline:problem:memory-limit");
    let service = service.restart(&["--workers", "1"]);
    assert_eq!(service.post(&format!("{job}/retry")).send().await.unwrap().status(), 200);
    assert_eq!(service.ended(&job).await["status"], "successful", "with the usual memory");
}

#[tokio::test]
async fn a_run_that_dies_is_tried_again_and_given_up_after_the_third_time() {
    let service = Service::start(&["--workers", "1"]);
    let job = service.backlog(1, &meshes::large()).await.remove(0);
    service.until(&job, |status| status["progress"].as_u64() > Some(10)).await;
    let run = signal_run(&service, "-TERM", None).await;
    assert_eq!(signal_run(&service, "-HUP", None).await, run, "a manager's SIGTERM is for the service");
    assert_eq!(signal_run(&service, "-KILL", None).await, run, "as is a SIGHUP");
    assert_eq!(service.ended(&job).await["status"], "successful", "{}", service.log());
    let job = service.backlog(1, &meshes::large()).await.remove(0);
    // Not before the process at rest has begun with it.
    service.until(&job, |status| status["progress"].as_u64() > Some(10)).await;
    let mut last = None;
    for _ in 0..3 {
        last = Some(signal_run(&service, "-KILL", last).await);
    }
    let status = service.ended(&job).await;
    assert_eq!(status["status"], "failed", "{status}");
    assert_eq!(status["error"]["type"], "urn:rosaline:problem:crashed");
    let detail = status["error"]["detail"].as_str().unwrap();
    assert!(detail.contains("3 times") && detail.contains("signal"), "{detail}");
    service.assert_alive().await;
}

/// The bytes of a job's result, as they are.
async fn result(service: &Service, job: &str) -> Vec<u8> {
    let response = service.get(&format!("{job}/results/centerline.json")).send().await.unwrap();
    assert_eq!(response.status(), 200);
    response.bytes().await.unwrap().to_vec()
}

#[tokio::test]
async fn a_process_takes_one_run_after_the_other_and_ends_when_there_is_none() {
    let service = Service::start(&["--workers", "1"]);
    assert!(children(service.pid()).is_empty(), "none before there is a job");
    let tube = meshes::stl(&meshes::tube(40, 16));
    let mut results = Vec::new();
    for mesh in [meshes::small(), tube, meshes::ball(), meshes::small()] {
        let job = service.accepted("", mesh).await;
        if service.ended(&job).await["status"] == "successful" {
            results.push(result(&service, &job).await);
        }
    }
    let runs = children(service.pid());
    assert_eq!((runs.len(), results.len()), (1, 3), "one process had all of them, the failed one too");
    assert!(results[0] == results[2], "a used process gives what a fresh one does");
    assert_ne!(results[0], results[1]);
    // What a large run needed is not kept for long small ones.
    let large = service.accepted("", meshes::stl(&meshes::tube(1500, 150))).await;
    assert_eq!(service.ended(&large).await["status"], "successful");
    // The job is done a moment before its process is, which never rests.
    let begin = Instant::now();
    while !children(service.pid()).is_empty() {
        assert!(begin.elapsed() < PATIENCE, "{}", service.log());
        let metrics = service.get("/metrics").send().await.unwrap().text().await.unwrap();
        assert!(metrics.contains("\nrosaline_run_processes_resting 0\n"), "{metrics}");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    let small = service.accepted("", meshes::small()).await;
    assert_eq!(service.ended(&small).await["status"], "successful");
    let begin = Instant::now();
    let next = children(service.pid());
    assert!(next.len() == 1 && next != runs, "{next:?} after {runs:?}");
    until(|| children(service.pid()).is_empty().then_some(())).await;
    assert!(begin.elapsed() > Duration::from_secs(5), "it rested a while");
    let after = service.accepted("", meshes::small()).await;
    service.ended(&after).await;
    assert!(result(&service, &after).await == results[0]);
}

#[tokio::test]
async fn a_process_that_dies_at_rest_is_no_crash_of_the_next_job() {
    let service = Service::start(&["--workers", "1", "--max-crashes", "1"]);
    let mut killed = Vec::new();
    for _ in 0..3 {
        let job = service.accepted("", meshes::small()).await;
        assert_eq!(service.ended(&job).await["status"], "successful", "{}", service.log());
        // It waits for the next job when it dies, which is offered to it then.
        let metrics = service.get("/metrics").send().await.unwrap().text().await.unwrap();
        assert!(metrics.contains("\nrosaline_run_processes_resting 1\n"), "{metrics}");
        killed.push(signal_run(&service, "-KILL", None).await);
        let metrics = service.get("/metrics").send().await.unwrap().text().await.unwrap();
        assert!(
            metrics.contains("\nrosaline_run_processes_resting 1\n"),
            "nobody has seen that it died: {metrics}"
        );
    }
    killed.dedup();
    assert_eq!(killed.len(), 3, "each job had a process of its own");
}

#[tokio::test]
async fn no_run_outlives_its_service() {
    let mut service = Service::start(&["--workers", "2"]);
    service.backlog(2, &meshes::large()).await;
    let pid = service.pid();
    let runs = until(|| Some(children(pid)).filter(|runs| runs.len() == 2)).await;
    service.kill();
    for run in runs {
        until(|| (!fs::exists(format!("/proc/{run}")).unwrap()).then_some(())).await;
    }
}

/// A vessel of some size: the large tree where it is at hand and the build is fast.
fn vessel() -> Vec<u8> {
    let tree = shared().map(|folder| folder.join("phantoms/bigtree.stl")).filter(|path| path.exists());
    match tree {
        Some(path) if !cfg!(debug_assertions) => fs::read(path).unwrap(),
        _ => meshes::large(),
    }
}

/// Milliseconds since the epoch.
fn millis(status: &Value, field: &str) -> i64 {
    let text = status[field].as_str().unwrap();
    let time = time::OffsetDateTime::parse(text, &time::format_description::well_known::Rfc3339).unwrap();
    (time.unix_timestamp_nanos() / 1_000_000) as i64
}

/// The promise is 200 ms. Tests run beside each other on busy machines, so it is asked of the median, and of the release
/// build; of each there is a bound that only a run which is not stopped passes.
#[tokio::test]
async fn a_cancelled_job_frees_its_worker_at_any_moment() {
    const LIMIT: i64 = 2000;
    const MEDIAN: i64 = if cfg!(debug_assertions) { LIMIT } else { 200 };
    let moments = if cfg!(debug_assertions) { 4 } else { 20 };
    let service = Service::start(&["--workers", "1"]);
    let vessel = vessel();
    for preset in ["default", "paper"] {
        let query = format!("?preset={preset}");
        let whole = service.accepted(&query, vessel.clone()).await;
        let whole = service.ended(&whole).await;
        let whole = millis(&whole, "finished") - millis(&whole, "started");
        let mut waits = Vec::new();
        for moment in 0..moments {
            let job = service.accepted(&query, vessel.clone()).await;
            let next = service.accepted("", meshes::small()).await;
            service.until(&job, |status| status["status"] != "accepted").await;
            tokio::time::sleep(Duration::from_millis((whole * moment / moments) as u64)).await;
            service.delete(&job).send().await.unwrap();
            let next = service.ended(&next).await;
            let response = service.get(&job).send().await.unwrap();
            // One that had ended already was purged.
            if response.status() == 200 {
                let job: Value = response.json().await.unwrap();
                waits.push(millis(&next, "started") - millis(&job, "finished"));
            }
        }
        println!("{preset}: {whole} ms; free after {waits:?} ms");
        waits.sort_unstable();
        assert!(!waits.is_empty() && waits[waits.len() / 2] < MEDIAN, "{waits:?}");
        assert!(waits[waits.len() - 1] < LIMIT, "{waits:?}");
    }
}
