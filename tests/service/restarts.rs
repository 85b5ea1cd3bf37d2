//! SIGKILL and SIGTERM while jobs run: none is lost, each ends once.

use std::time::{Duration, Instant};

use serde_json::Value;

use crate::meshes;
use crate::service::Service;

async fn assert_all_end_well(service: &Service, jobs: &[String]) {
    for job in jobs {
        let status = service.ended(job).await;
        assert_eq!(status["status"], "successful", "{status} {}", service.log());
        let response = service.get(&format!("{job}/results/centerline.json")).send().await.unwrap();
        let result: Value = response.json().await.unwrap();
        assert_eq!(result["schema"], "rosaline.centerline/1");
    }
    let list: Value = service.get("/v1/jobs?limit=500").send().await.unwrap().json().await.unwrap();
    assert_eq!(list["jobs"].as_array().unwrap().len(), jobs.len(), "each job once");
}

#[tokio::test]
async fn no_accepted_job_is_lost_by_sigkill() {
    let mut service = Service::start(&["--workers", "2"]);
    let mut jobs = Vec::new();
    for round in 0..2 {
        jobs.extend(service.backlog(4, &meshes::large()).await);
        jobs.extend(service.backlog(2, &meshes::small()).await);
        service.running().await;
        // An upload on its way dies with the service: it was not accepted.
        let half = service.post("/v1/jobs").header("content-type", "model/stl").body(endless());
        let half = tokio::spawn(half.send());
        tokio::time::sleep(Duration::from_millis(50 * (round + 1))).await;
        service.kill();
        assert!(half.await.unwrap().is_err());
        service = service.restart(&["--workers", "2"]);
    }
    assert_all_end_well(&service, &jobs).await;
    let inputs = service.files().iter().filter(|path| path.ends_with("input")).count();
    assert_eq!(inputs, jobs.len(), "the half uploads are gone");
}

/// A body that begins and does not end.
fn endless() -> reqwest::Body {
    use futures::StreamExt;
    let begin = futures::stream::iter([Ok::<_, std::io::Error>(bytes::Bytes::from(vec![0; 100_000]))]);
    reqwest::Body::wrap_stream(begin.chain(futures::stream::pending()))
}

#[tokio::test]
async fn sigterm_lets_running_jobs_finish() {
    let mut service = Service::start(&["--workers", "1", "--grace", "120s"]);
    let jobs = service.backlog(4, &meshes::large()).await;
    let running = service.running().await;
    service.terminate();
    assert!(service.wait().success(), "{}", service.log());
    assert!(!service.log().contains("put back"), "{}", service.log());
    assert!(service.client.get(format!("{}/healthz", service.url)).send().await.is_err());
    let service = service.restart(&["--workers", "1"]);
    let status = service.status(&running).await;
    assert_eq!(status["status"], "successful", "it finished before the service ended: {status}");
    assert_all_end_well(&service, &jobs).await;
}

#[tokio::test]
async fn sigterm_puts_back_what_does_not_finish_in_time() {
    let mut service = Service::start(&["--workers", "1", "--grace", "0"]);
    let jobs = service.backlog(4, &meshes::large()).await;
    service.running().await;
    let begin = Instant::now();
    service.terminate();
    assert!(service.wait().success(), "{}", service.log());
    assert!(begin.elapsed() < Duration::from_secs(10), "{:?}", begin.elapsed());
    assert!(service.log().contains("put back"), "{}", service.log());
    let service = service.restart(&["--workers", "1"]);
    assert_all_end_well(&service, &jobs).await;
}

#[tokio::test]
async fn who_waits_is_answered_when_the_service_stops() {
    let mut service = Service::start(&["--workers", "1", "--grace", "60"]);
    let mut jobs = service.backlog(4, &meshes::large()).await;
    let request = service.post("/v1/jobs").header("prefer", "wait=60").header("content-type", "model/stl");
    let waiting = tokio::spawn(request.body(meshes::small()).send());
    let newest = async || {
        let list: Value = service.get("/v1/jobs").send().await.unwrap().json().await.unwrap();
        list["jobs"][0]["links"][0]["href"].as_str().unwrap().to_owned()
    };
    while newest().await == jobs[3] {
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    service.terminate();
    let response = waiting.await.unwrap().unwrap();
    assert_eq!(response.status(), 201);
    jobs.push(response.headers()["location"].to_str().unwrap().to_owned());
    let status: Value = response.json().await.unwrap();
    assert_eq!(status["status"], "accepted", "it did not wait for those before it: {status}");
    assert!(service.wait().success());
    let service = service.restart(&[]);
    assert_all_end_well(&service, &jobs).await;
}

#[tokio::test]
async fn a_second_signal_ends_at_once_and_loses_nothing() {
    let mut service = Service::start(&["--workers", "1", "--grace", "120s"]);
    let jobs = service.backlog(4, &meshes::large()).await;
    service.running().await;
    service.terminate();
    while !service.log().contains("stopping") {
        tokio::time::sleep(Duration::from_millis(2)).await;
    }
    service.terminate();
    service.wait();
    let service = service.restart(&[]);
    assert_all_end_well(&service, &jobs).await;
}

/// A closing terminal and some service managers send it, to all processes and beside another signal.
#[cfg(unix)]
#[tokio::test]
async fn a_hangup_is_an_orderly_stop_too() {
    let data = std::sync::Arc::new(tempfile::tempdir().unwrap());
    // Also where these tests run under nohup.
    let mut command = std::process::Command::new("env");
    command.args(["--default-signal=HUP", env!("CARGO_BIN_EXE_rosaline"), "serve"]);
    command.args(["--workers", "1", "--grace", "120s"]);
    let mut service = Service::try_start(crate::service::set_up(&mut command, data.path()), data).unwrap();
    let job = service.backlog(1, &meshes::large()).await.remove(0);
    service.running().await;
    for _ in 0..2 {
        service.signal("-HUP");
        service.log_with("stopping").await;
    }
    assert!(service.wait().success(), "{}", service.log());
    let service = service.restart(&[]);
    assert_eq!(service.status(&job).await["status"], "successful");
}

#[cfg(unix)]
#[tokio::test]
async fn a_service_under_nohup_outlives_its_terminal() {
    let data = std::sync::Arc::new(tempfile::tempdir().unwrap());
    let mut shell = std::process::Command::new("sh");
    crate::service::without_settings(&mut shell);
    shell.args(["-c", "trap '' HUP; exec \"$0\" serve --listen 127.0.0.1:0", env!("CARGO_BIN_EXE_rosaline")]);
    shell.env("ROSALINE_DATA", data.path());
    shell.stdout(std::process::Stdio::piped()).stderr(std::process::Stdio::piped());
    let mut service = Service::try_start(&mut shell, data).unwrap();
    service.signal("-HUP");
    let job = service.accepted("", meshes::small()).await;
    assert_eq!(service.ended(&job).await["status"], "successful");
    service.terminate();
    assert!(service.wait().success(), "{}", service.log());
    assert_eq!(service.log().matches("stopping").count(), 1);
}
