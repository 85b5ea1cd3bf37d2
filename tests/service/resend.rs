//! Requests that are sent again, that were changed on their way, and that are to be found again.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use reqwest::Response;
use reqwest::multipart::{Form, Part};
use serde_json::{Value, json};
use sha2::{Digest, Sha256};

use crate::meshes;
use crate::service::{Service, problem};
use crate::submission::assert_fits;

async fn post(service: &Service, key: &str, query: &str, mesh: Vec<u8>) -> Response {
    let request = service.post(&format!("/v1/jobs{query}")).header("idempotency-key", key);
    request.header("content-type", "model/stl").body(mesh).send().await.unwrap()
}

async fn job(response: Response) -> String {
    assert_eq!(response.status(), 201);
    response.headers()["location"].to_str().unwrap().to_owned()
}

#[tokio::test]
async fn the_same_request_makes_no_second_job() {
    let mut service = Service::start(&[]);
    let first = job(post(&service, "key-1", "?omega=0.8", meshes::small()).await).await;
    assert_eq!(service.ended(&first).await["status"], "successful");
    let again = post(&service, "\"key-1\"", "?omega=0.8", meshes::small()).await;
    assert_eq!(again.headers()["location"], first.as_str());
    let status: Value = again.json().await.unwrap();
    assert_eq!(status["status"], "successful", "its status as it is now: {status}");

    // After kill -9, and as a form.
    service.kill();
    let service = service.restart(&[]);
    let form = Form::new()
        .part("parameters", Part::text(r#"{"omega": 0.8}"#))
        .part("mesh", Part::bytes(meshes::small()));
    let request = service.post("/v1/jobs").header("idempotency-key", "key-1").multipart(form);
    assert_eq!(job(request.send().await.unwrap()).await, first);

    for (query, mesh) in
        [("?omega=0.9", meshes::small()), ("", meshes::small()), ("?omega=0.8", meshes::ball())]
    {
        let body = problem(post(&service, "key-1", query, mesh).await, 422, "idempotency-key-reused").await;
        assert_eq!(body["instance"], first);
    }
    assert_ne!(job(post(&service, "key-2", "?omega=0.8", meshes::small()).await).await, first);
    let list: Value = service.get("/v1/jobs").send().await.unwrap().json().await.unwrap();
    assert_eq!(list["jobs"].as_array().unwrap().len(), 2);

    // The key is free when the job is gone.
    assert_eq!(service.delete(&first).send().await.unwrap().status(), 204);
    assert_ne!(job(post(&service, "key-1", "", meshes::small()).await).await, first);
}

#[tokio::test]
async fn a_refused_request_leaves_its_key_free() {
    let service = Service::start(&[]);
    problem(post(&service, "k", "", b"\x89PNG\r\n\x1a\n".to_vec()).await, 415, "unsupported-format").await;
    problem(post(&service, "k", "?omega=7", meshes::small()).await, 400, "invalid-parameter").await;
    job(post(&service, "k", "", meshes::small()).await).await;
    for key in ["", "a b", "ä"] {
        problem(post(&service, key, "", meshes::small()).await, 400, "invalid-parameter").await;
    }
}

#[tokio::test]
async fn what_could_be_read_in_two_ways_is_refused() {
    let service = Service::start(&[]);
    let two = service.post("/v1/jobs").header("idempotency-key", "a").header("idempotency-key", "b");
    problem(two.body(meshes::small()).send().await.unwrap(), 400, "invalid-parameter").await;
    let mesh = || Part::bytes(meshes::small());
    let twice =
        Form::new().part("parameters", Part::text(r#"{"omega": 0.7, "omega": 0.8}"#)).part("mesh", mesh());
    let response = service.post("/v1/jobs").multipart(twice).send().await.unwrap();
    assert_eq!(problem(response, 400, "invalid-parameter").await["parameter"], "omega");
    for query in ["?name=%FF%FE.stl", "?client_reference=a%C3", "?%80=1"] {
        problem(service.submit(query, meshes::small()).await, 400, "malformed-request").await;
    }
    service.accepted("?name=%C3%A4rtery%20100%25.stl", meshes::small()).await;
}

#[tokio::test]
async fn of_equal_requests_at_the_same_time_one_makes_the_job() {
    let service = Service::start(&[]);
    let posts = (0..16).map(|_| post(&service, "busy", "", meshes::large()));
    let mut jobs = Vec::new();
    for response in futures::future::join_all(posts).await {
        if response.status() == 409 {
            assert_eq!(response.headers()["retry-after"], "1");
            problem(response, 409, "idempotency-in-flight").await;
        } else {
            jobs.push(job(response).await);
        }
    }
    jobs.dedup();
    assert_eq!(jobs.len(), 1, "{jobs:?}");
    let list: Value = service.get("/v1/jobs").send().await.unwrap().json().await.unwrap();
    assert_eq!(list["jobs"].as_array().unwrap().len(), 1);
}

#[tokio::test]
async fn a_body_without_its_digest_is_refused() {
    let service = Service::start(&[]);
    let mesh = meshes::small();
    let digest = format!("sha-256=:{}:", STANDARD.encode(Sha256::digest(&mesh)));
    let post = |digest: String, mesh: Vec<u8>| {
        let request = service.post("/v1/jobs").header("content-digest", digest);
        request.header("content-type", "model/stl").body(mesh).send()
    };
    assert_eq!(post(digest.clone(), mesh.clone()).await.unwrap().status(), 201);
    assert_eq!(post("sha-512=:AAAA:".to_owned(), mesh.clone()).await.unwrap().status(), 201, "passed over");
    let mut changed = mesh.clone();
    changed[200] ^= 1;
    problem(post(digest, changed).await.unwrap(), 400, "digest-mismatch").await;
    problem(post("sha-256=:AAAA:".to_owned(), mesh).await.unwrap(), 400, "malformed-request").await;
    let list: Value = service.get("/v1/jobs").send().await.unwrap().json().await.unwrap();
    assert_eq!(list["jobs"].as_array().unwrap().len(), 2);
}

#[tokio::test]
async fn a_clients_own_words_come_back_and_are_not_logged() {
    let mut service = Service::start(&[]);
    let request = service.post("/v1/jobs?client_reference=doe%20jane%2F7").header("x-request-id", "doe-4711");
    let first = job(request.body(meshes::small()).send().await.unwrap()).await;
    let status = service.ended(&first).await;
    assert_fits("JobStatus", &status);
    service.kill();
    let log = service.log();
    let service = service.restart(&[]);
    for status in [status, service.status(&first).await] {
        assert_eq!(
            (&status["request_id"], &status["client_reference"]),
            (&json!("doe-4711"), &json!("doe jane/7"))
        );
    }
    assert!(!log.contains("doe") && !service.log().contains("doe"), "{log}");
    let long = "x".repeat(129);
    for reference in ["", "a%0Ab", &long] {
        let response = service.submit(&format!("?client_reference={reference}"), meshes::small()).await;
        assert_eq!(problem(response, 400, "invalid-parameter").await["parameter"], "client_reference");
    }
    let request = service.post("/v1/jobs").header("x-request-id", long);
    let status: Value = request.body(meshes::small()).send().await.unwrap().json().await.unwrap();
    assert!(status["request_id"].is_null(), "what is no id is passed over");
}
