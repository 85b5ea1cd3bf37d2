//! Status by entity tag, and waits for its change.

use std::time::{Duration, Instant};

use reqwest::{RequestBuilder, StatusCode};
use serde_json::Value;

use crate::meshes;
use crate::service::Service;

/// Status code, entity tag and body.
async fn ask(request: RequestBuilder) -> (StatusCode, String, Option<Value>) {
    let response = request.send().await.unwrap();
    let (status, tag) = (response.status(), response.headers()["etag"].to_str().unwrap().to_owned());
    (status, tag, response.json().await.ok())
}

#[tokio::test]
async fn a_status_that_the_client_has_is_not_sent_again() {
    let service = Service::start(&[]);
    let job = service.accepted("", meshes::small()).await;
    service.ended(&job).await;
    let (status, tag, body) = ask(service.get(&job)).await;
    assert_eq!((status, body.unwrap()["status"].as_str()), (StatusCode::OK, Some("successful")));
    let (status, again, body) = ask(service.get(&job).header("if-none-match", &tag)).await;
    assert_eq!((status, again, body), (StatusCode::NOT_MODIFIED, tag.clone(), None));
    // Nothing will change any more.
    let begin = Instant::now();
    let request = service.get(&job).header("if-none-match", &tag).header("prefer", "wait=30");
    assert_eq!(ask(request).await.0, StatusCode::NOT_MODIFIED);
    assert!(begin.elapsed() < Duration::from_secs(10));
}

#[tokio::test]
async fn a_client_that_waits_sees_every_change_until_the_end() {
    let service = Service::start(&["--workers", "1"]);
    let job = service.backlog(2, &meshes::large()).await.remove(1);
    let (_, mut tag, body) = ask(service.get(&job)).await;
    let (mut last, mut seen, mut progress) = (body.unwrap(), Vec::new(), 0);
    while matches!(last["status"].as_str(), Some("accepted" | "running")) {
        let request = service.get(&job).header("if-none-match", &tag).header("prefer", "wait=60");
        let response = request.send().await.unwrap();
        assert_eq!(
            (response.status(), &response.headers()["preference-applied"]),
            (StatusCode::OK, &"wait=60".parse().unwrap())
        );
        let next = response.headers()["etag"].to_str().unwrap().to_owned();
        assert_ne!(next, tag, "only a change is answered");
        (tag, last) = (next, response.json().await.unwrap());
        let now = last["progress"].as_u64().unwrap();
        assert!(now >= progress, "{progress} {last}");
        progress = now;
        seen.push(last["status"].as_str().unwrap().to_owned());
    }
    assert_eq!(last["status"], "successful");
    assert!(seen.len() > 3 && seen.contains(&"running".to_owned()), "{seen:?}");
}

#[tokio::test]
async fn a_wait_without_a_change_ends_in_time() {
    let service = Service::start(&["--workers", "1"]);
    let jobs = service.backlog(12, &meshes::large()).await;
    let (_, tag, _) = ask(service.get(&jobs[11])).await;
    let begin = Instant::now();
    let request = service.get(&jobs[11]).header("if-none-match", &tag).header("prefer", "wait=1");
    assert_eq!(ask(request).await.0, StatusCode::NOT_MODIFIED);
    assert!(begin.elapsed() >= Duration::from_secs(1) && begin.elapsed() < Duration::from_secs(5));
    // A dismissal is a change.
    let request = service.get(&jobs[11]).header("if-none-match", &tag).header("prefer", "wait=60");
    let waiting = tokio::spawn(request.send());
    tokio::time::sleep(Duration::from_millis(100)).await;
    service.delete(&jobs[11]).send().await.unwrap();
    let status: Value = waiting.await.unwrap().unwrap().json().await.unwrap();
    assert_eq!(status["status"], "dismissed");
    // An old tag is answered at once.
    let begin = Instant::now();
    let request = service.get(&jobs[10]).header("if-none-match", "\"old\"").header("prefer", "wait=60");
    assert_eq!(ask(request).await.0, StatusCode::OK);
    assert!(begin.elapsed() < Duration::from_secs(5));
    for job in jobs {
        service.delete(&job).send().await.unwrap();
    }
}
