//! Cancelling and purging.

use serde_json::Value;

use crate::meshes;
use crate::service::{Service, problem};
use crate::submission::assert_fits;

#[tokio::test]
async fn a_running_job_is_cancelled_and_its_worker_is_free_again() {
    let service = Service::start(&["--workers", "1"]);
    let waiting = service.backlog(4, &meshes::large()).await.remove(3);
    let running = service.running().await;
    for job in [&running, &waiting] {
        let response = service.delete(job).send().await.unwrap();
        assert_eq!(response.status(), 200);
        let status: Value = response.json().await.unwrap();
        assert_fits("JobStatus", &status);
        assert_eq!(status["status"], "dismissed");
        assert!(status["finished"].is_string());
        let response = service.get(&format!("{job}/results/centerline")).send().await.unwrap();
        problem(response, 404, "job-dismissed").await;
    }
    let next = service.accepted("", meshes::small()).await;
    assert_eq!(service.ended(&next).await["status"], "successful");
    for job in [running, waiting] {
        assert_eq!(service.status(&job).await["status"], "dismissed");
    }
}

#[tokio::test]
async fn a_job_that_has_ended_is_purged_with_its_files() {
    let service = Service::start(&[]);
    let job = service.accepted("", meshes::small()).await;
    service.ended(&job).await;
    assert!(!service.files().is_empty());
    assert_eq!(service.delete(&job).send().await.unwrap().status(), 204);
    service.assert_no_files().await;
    problem(service.get(&job).send().await.unwrap(), 404, "job-not-found").await;
    problem(service.delete(&job).send().await.unwrap(), 404, "job-not-found").await;
    let result = service.get(&format!("{job}/results/centerline.json")).send().await.unwrap();
    problem(result, 404, "job-not-found").await;
}

#[tokio::test]
async fn a_deletion_may_depend_on_the_status_that_the_client_knows() {
    let service = Service::start(&[]);
    let job = service.accepted("", meshes::small()).await;
    service.ended(&job).await;
    let etag = service.get(&job).send().await.unwrap().headers()["etag"].clone();
    let stale = service.delete(&job).header("if-match", "\"old\"").send().await.unwrap();
    assert_eq!(problem(stale, 412, "precondition-failed").await["instance"], job);
    assert_eq!(service.status(&job).await["status"], "successful");
    assert_eq!(service.delete(&job).header("if-match", etag).send().await.unwrap().status(), 204);
    let gone = service.delete(&job).header("if-match", "*").send().await.unwrap();
    problem(gone, 404, "job-not-found").await;
}

#[tokio::test]
async fn a_result_is_not_there_before_its_job_has_ended() {
    let service = Service::start(&["--workers", "1"]);
    let job = service.backlog(3, &meshes::large()).await.remove(2);
    for extension in ["", ".json", ".glb"] {
        let response = service.get(&format!("{job}/results/centerline{extension}")).send().await.unwrap();
        assert_eq!(response.headers()["retry-after"], "1");
        let body = problem(response, 404, "result-not-ready").await;
        assert_eq!(body["instance"], job);
        assert!(matches!(body["job_status"].as_str(), Some("accepted" | "running")));
    }
    service.delete(&job).send().await.unwrap();
}
