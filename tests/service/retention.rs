//! Jobs and meshes that are kept for a time.

use std::time::Duration;

use crate::meshes;
use crate::service::{Service, problem};

#[tokio::test]
async fn a_job_is_gone_after_its_time_and_its_id_says_so() {
    let mut service = Service::start(&["--keep-jobs", "2s"]);
    let job = service.accepted("", meshes::small()).await;
    assert_eq!(service.ended(&job).await["status"], "successful");
    assert!(!service.files().is_empty());
    let gone = async |service: &Service| {
        for _ in 0..600 {
            if service.get(&job).send().await.unwrap().status() == 410 {
                return;
            }
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
        panic!("it stays: {}", service.log());
    };
    gone(&service).await;
    service.assert_no_files().await;
    for path in ["", "/events", "/results/centerline", "/results/centerline.json"] {
        let body =
            problem(service.get(&format!("{job}{path}")).send().await.unwrap(), 410, "job-expired").await;
        assert_eq!(body["instance"], job, "{path}");
    }
    problem(service.delete(&job).send().await.unwrap(), 410, "job-expired").await;
    problem(service.post(&format!("{job}/retry")).send().await.unwrap(), 410, "job-expired").await;
    service.kill();
    let service = service.restart(&[]);
    gone(&service).await;
    // One that was deleted by its client leaves nothing.
    let other = service.accepted("", meshes::small()).await;
    service.ended(&other).await;
    service.delete(&other).send().await.unwrap();
    problem(service.get(&other).send().await.unwrap(), 404, "job-not-found").await;
}

#[tokio::test]
async fn a_mesh_goes_before_its_results() {
    let service = Service::start(&["--keep-input", "0"]);
    let (good, bad) =
        (service.accepted("", meshes::small()).await, service.accepted("", meshes::ball()).await);
    assert_eq!(service.ended(&good).await["status"], "successful");
    assert_eq!(service.ended(&bad).await["status"], "failed");
    let inputs = || service.files().into_iter().filter(|path| path.ends_with("input")).count();
    for _ in 0..600 {
        if inputs() == 0 {
            break;
        }
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    assert_eq!(inputs(), 0);
    let result = service.get(&format!("{good}/results/centerline")).send().await.unwrap();
    assert_eq!(result.status(), 200);
    assert_eq!(service.status(&good).await["status"], "successful");
    // The row follows the file.
    tokio::time::sleep(Duration::from_millis(200)).await;
    problem(service.post(&format!("{bad}/retry")).send().await.unwrap(), 409, "input-removed").await;
    assert_eq!(service.delete(&good).send().await.unwrap().status(), 204);
}
