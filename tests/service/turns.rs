//! Urgent jobs, and failed ones that are tried again.

use serde_json::Value;

use crate::meshes;
use crate::service::{Service, problem};
use crate::submission::assert_fits;

#[tokio::test]
async fn an_urgent_job_runs_before_those_that_wait() {
    let service = Service::start(&["--workers", "1"]);
    let backlog = service.backlog(1, &meshes::large()).await;
    service.running().await;
    let normal = service.accepted("", meshes::small()).await;
    let urgent = service.accepted("?priority=urgent", meshes::small()).await;
    assert_eq!(service.status(&normal).await["status"], "accepted");
    assert_eq!(service.delete(&backlog[0]).send().await.unwrap().status(), 200);
    let (normal, urgent) = (service.ended(&normal).await, service.ended(&urgent).await);
    assert_eq!((&urgent["status"], &urgent["priority"]), (&"successful".into(), &"urgent".into()));
    assert_eq!(normal["priority"], "normal");
    assert!(urgent["started"].as_str() < normal["started"].as_str(), "{urgent} {normal}");
    problem(service.submit("?priority=high", meshes::small()).await, 400, "invalid-parameter").await;
}

#[tokio::test]
async fn a_failed_job_can_be_tried_again_and_no_other() {
    let service = Service::start(&[]);
    let job = service.accepted("", meshes::ball()).await;
    let failed = service.ended(&job).await;
    assert_eq!(failed["status"], "failed");
    let response = service.post(&format!("{job}/retry")).send().await.unwrap();
    assert_eq!(response.status(), 200);
    let again: Value = response.json().await.unwrap();
    assert_fits("JobStatus", &again);
    assert_eq!(again["id"], failed["id"]);
    assert_ne!(again["updated"], failed["updated"]);
    let ended = service.ended(&job).await;
    assert_eq!((&ended["status"], &ended["error"]), (&failed["status"], &failed["error"]));
    assert!(ended["started"].as_str() > failed["started"].as_str(), "it ran twice: {ended}");

    let good = service.accepted("", meshes::small()).await;
    service.ended(&good).await;
    let response = service.post(&format!("{good}/retry")).send().await.unwrap();
    assert_eq!(problem(response, 409, "not-retryable").await["job_status"], "successful");
    service.delete(&good).send().await.unwrap();
    problem(service.post(&format!("{good}/retry")).send().await.unwrap(), 404, "job-not-found").await;
}
