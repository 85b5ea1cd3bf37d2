//! Bounds on what may wait, run and come in.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::Command;
use std::sync::Arc;

use serde_json::Value;

use crate::meshes;
use crate::service::{Service, problem};

/// A new key of `name`, which may submit and read.
fn key_of(data: &Path, name: &str) -> String {
    let mut command = Command::new(env!("CARGO_BIN_EXE_rosaline"));
    command.args(["keys", "add", name, "--scope", "submit,read", "--data"]).arg(data);
    String::from_utf8(command.output().unwrap().stdout).unwrap().trim().to_owned()
}

#[tokio::test]
async fn a_full_queue_takes_no_more_until_there_is_room() {
    let service = Service::start(&["--workers", "1", "--max-queue", "2"]);
    let limits: Value = service.get("/v1/limits").send().await.unwrap().json().await.unwrap();
    assert_eq!(limits["queue"], 2);
    let running = service.accepted("?smoothing=true", meshes::large()).await;
    service.running().await;
    let first = service.accepted("", meshes::small()).await;
    service.accepted("", meshes::small()).await;
    let response = service.submit("", meshes::small()).await;
    assert!(response.headers().contains_key("retry-after"));
    assert_eq!(problem(response, 503, "queue-full").await["limit"], 2);
    service.delete(&first).send().await.unwrap();
    service.accepted("", meshes::small()).await;
    service.delete(&running).send().await.unwrap();
}

#[tokio::test]
async fn a_principal_has_its_share() {
    let data = Arc::new(tempfile::tempdir().unwrap());
    let [one, other] = ["one", "other"].map(|name| key_of(data.path(), name));
    let service = Service::start_on(data.clone(), &["--workers", "1", "--max-jobs-each", "2"]);
    let post = |key: &str| {
        let request =
            service.post("/v1/jobs?smoothing=true").header("authorization", format!("Bearer {key}"));
        request.body(meshes::large()).send()
    };
    for _ in 0..2 {
        assert_eq!(post(&one).await.unwrap().status(), 201);
    }
    let response = post(&one).await.unwrap();
    assert!(response.headers().contains_key("retry-after"));
    problem(response, 429, "too-many-jobs").await;
    assert_eq!(post(&other).await.unwrap().status(), 201);
}

#[tokio::test]
async fn so_many_uploads_come_in_at_the_same_time() {
    let service = Service::start(&["--max-uploads", "1"]);
    let mut slow = TcpStream::connect(service.address()).unwrap();
    let mesh = meshes::small();
    let head = format!("POST /v1/jobs HTTP/1.1\r\nHost: x\r\nContent-Length: {}\r\n\r\n", mesh.len());
    slow.write_all(head.as_bytes()).unwrap();
    slow.write_all(&mesh[..1000]).unwrap();
    while service.files().is_empty() {
        tokio::time::sleep(std::time::Duration::from_millis(5)).await;
    }
    let response = service.submit("", meshes::small()).await;
    assert!(response.headers().contains_key("retry-after"));
    problem(response, 503, "too-many-uploads").await;
    slow.write_all(&mesh[1000..]).unwrap();
    let mut answer = [0; 12];
    slow.read_exact(&mut answer).unwrap();
    assert_eq!(&answer, b"HTTP/1.1 201");
    service.accepted("", meshes::small()).await;
}

/// Begins an upload and leaves it half-way, open.
fn half_an_upload(address: &str, key: Option<&str>) -> TcpStream {
    let mut slow = TcpStream::connect(address).unwrap();
    let key = key.map_or(String::new(), |key| format!("Authorization: Bearer {key}\r\n"));
    let head = format!("POST /v1/jobs HTTP/1.1\r\nHost: x\r\n{key}Content-Length: 1000000\r\n\r\n");
    slow.write_all(head.as_bytes()).unwrap();
    slow.write_all(&[1; 1000]).unwrap();
    slow
}

async fn files(service: &Service, count: usize) {
    while service.files().len() != count {
        tokio::time::sleep(std::time::Duration::from_millis(5)).await;
    }
}

#[tokio::test]
async fn one_sender_does_not_take_all_the_places_for_uploads() {
    let service = Service::start(&["--max-uploads", "4", "--max-uploads-each", "2"]);
    let limits: Value = service.get("/v1/limits").send().await.unwrap().json().await.unwrap();
    assert_eq!((&limits["uploads"], &limits["uploads_each"]), (&4.into(), &2.into()));
    // By address, as nobody needs a key.
    let slow = [(); 2].map(|()| half_an_upload(service.address(), None));
    files(&service, 2).await;
    let response = service.submit("", meshes::small()).await;
    assert!(response.headers().contains_key("retry-after"));
    assert_eq!(problem(response, 429, "too-many-own-uploads").await["limit"], 2);
    let elsewhere = reqwest::Client::builder().local_address(std::net::IpAddr::from([127, 0, 0, 2])).build();
    let post = elsewhere.unwrap().post(format!("{}/v1/jobs", service.url)).body(meshes::small());
    assert_eq!(post.send().await.unwrap().status(), 201);
    drop(slow);
    while service.submit("", meshes::small()).await.status() != 201 {
        tokio::time::sleep(std::time::Duration::from_millis(5)).await;
    }
}

#[tokio::test]
async fn one_principal_does_not_take_all_the_places_for_uploads() {
    let data = Arc::new(tempfile::tempdir().unwrap());
    let [one, other] = ["one", "other"].map(|name| key_of(data.path(), name));
    let service = Service::start_on(data.clone(), &["--max-uploads-each", "2"]);
    let slow = [(); 2].map(|()| half_an_upload(service.address(), Some(&one)));
    files(&service, 2).await;
    let post = |key: &str| service.post("/v1/jobs").bearer_auth(key).body(meshes::small()).send();
    problem(post(&one).await.unwrap(), 429, "too-many-own-uploads").await;
    assert_eq!(post(&other).await.unwrap().status(), 201);
    drop(slow);
}

#[tokio::test]
async fn a_job_that_takes_too_long_fails_and_frees_its_worker() {
    let service = Service::start(&["--workers", "1", "--max-run", "1s"]);
    let job = service.accepted("?smoothing=true&preset=paper", meshes::stl(&meshes::tube(600, 120))).await;
    let status = service.ended(&job).await;
    assert_eq!(status["status"], "failed", "{status}");
    assert_eq!(status["error"]["type"], "urn:rosaline:problem:time-limit", "{status}");
    let next = service.accepted("", meshes::stl(&meshes::tube(8, 6))).await;
    assert_ne!(service.ended(&next).await["error"]["type"], "urn:rosaline:problem:time-limit");
}

/// Also a closed surface, which has two vertices more than half its triangles, and an open one, which has more.
#[tokio::test]
async fn a_mesh_of_as_many_triangles_as_there_may_be_is_taken() {
    for mesh in [meshes::ball(), meshes::small()] {
        let triangles = (mesh.len() - 84) / 50;
        let service = Service::start(&["--max-triangles", &triangles.to_string()]);
        service.accepted("", mesh.clone()).await;
        let service = Service::start(&["--max-triangles", &(triangles - 1).to_string()]);
        let body = problem(service.submit("", mesh).await, 413, "too-large").await;
        assert!(body["detail"].as_str().unwrap().contains("triangles"), "{body}");
    }
}
