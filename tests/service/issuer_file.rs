//! A file of an issuer's keys that cannot be read for a while.

use std::time::{Duration, Instant};

use jsonwebtoken::Algorithm;
use serde_json::Value;

use crate::issuer::{KeyFile, Signer, claims, set};
use crate::service::problem;
use crate::tokens::{list, slow_job, until};

/// As when a right to read the file is taken away and given back: what tells one state of it from the next stays the same.
#[tokio::test]
async fn a_file_that_could_not_be_read_once_is_tried_again() {
    let signer = Signer::new("one", Algorithm::ES256);
    let good = set(&[&signer]);
    let file = KeyFile::new(&good);
    let service = file.start(&["--workers", "1"]);
    let token = signer.sign(&claims("anna", "submit read"));
    assert_eq!(list(&service, &token).await.status(), 200);
    // Another file than the one that was read, then this one again with other bytes.
    file.put(&"x".repeat(good.len()));
    let stamp = std::fs::metadata(file.path()).unwrap().modified().unwrap();
    for _ in 0..3 {
        let response = list(&service, &token).await;
        assert!(response.headers().contains_key("retry-after"));
        problem(response, 503, "keys-unavailable").await;
        let body = problem(service.get("/readyz").send().await.unwrap(), 503, "not-ready").await;
        assert!(body["detail"].as_str().unwrap().contains("the file of the issuer's keys"), "{body}");
    }
    let log = service.log_with("not ready").await;
    assert_eq!(
        (log.matches("no token is let in").count(), log.matches("not ready").count()),
        (1, 1),
        "{log}"
    );
    // What is no token of the issuer's is wrong all the same.
    problem(list(&service, "a.b.c").await, 401, "unauthenticated").await;
    std::fs::write(file.path(), &good).unwrap();
    std::fs::File::options().write(true).open(file.path()).unwrap().set_modified(stamp).unwrap();
    until(&service, &token, 200).await;
    service.assert_alive().await;
}

#[tokio::test]
async fn a_stream_goes_on_over_a_moment_without_the_keys() {
    let signer = Signer::new("one", Algorithm::ES256);
    let file = KeyFile::new(&set(&[&signer]));
    let service = file.start(&["--workers", "1"]);
    let token = signer.sign(&claims("anna", "submit read"));
    let job = slow_job(&service, &token).await;
    let mut response = service.get(&format!("{job}/events")).bearer_auth(&token).send().await.unwrap();
    file.put("{");
    // Less than from one look at its token to the next.
    tokio::time::sleep(Duration::from_millis(1900)).await;
    assert!(service.log().contains("no token is let in") || list(&service, &token).await.status() == 503);
    file.put(&set(&[&signer]));
    let over = Instant::now() + Duration::from_secs(3);
    while let Some(left) = over.checked_duration_since(Instant::now()) {
        match tokio::time::timeout(left, response.chunk()).await {
            Ok(chunk) => assert!(chunk.unwrap().is_some(), "it has ended"),
            Err(_) => break,
        }
    }
    let now: Value = service.get(&job).bearer_auth(&token).send().await.unwrap().json().await.unwrap();
    assert!(matches!(now["status"].as_str(), Some("accepted" | "running")), "{now}");
    file.put("{");
    // Two looks, then the end.
    let ended = async { while response.chunk().await.unwrap().is_some() {} };
    tokio::time::timeout(Duration::from_secs(15), ended).await.unwrap();
    file.put(&set(&[&signer]));
    service.delete(&job).bearer_auth(&token).send().await.unwrap();
}
