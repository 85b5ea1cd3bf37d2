//! Server-sent events.

use serde_json::Value;

use crate::meshes;
use crate::service::Service;
use crate::submission::assert_fits;

/// The events of a whole stream: id and data.
fn parse(text: &str) -> Vec<(String, Value)> {
    let blocks = text.split("\n\n").filter(|block| block.contains("data:"));
    let field = |block: &str, name: &str| {
        block.lines().find_map(|line| line.strip_prefix(name)).unwrap().trim().to_owned()
    };
    blocks
        .map(|block| {
            assert_eq!(field(block, "event:"), "status");
            (field(block, "id:"), serde_json::from_str(&field(block, "data:")).unwrap())
        })
        .collect()
}

#[tokio::test]
async fn a_job_is_followed_to_its_end() {
    let service = Service::start(&["--workers", "1"]);
    let jobs = service.backlog(2, &meshes::large()).await;
    let response = service.get(&format!("{}/events", jobs[1])).send().await.unwrap();
    assert_eq!(response.status(), 200);
    assert_eq!(response.headers()["content-type"], "text/event-stream");
    assert_eq!(response.headers()["cache-control"], "no-store");
    let events = parse(&response.text().await.unwrap());
    let word = |place: usize| events[place].1["status"].as_str().unwrap();
    assert_eq!(word(0), "accepted", "the status at once");
    assert_eq!(word(events.len() - 1), "successful", "and the end of the stream with the job's");
    assert!(events.len() > 4, "{}", events.len());
    let mut last = 0;
    for (place, (id, status)) in events.iter().enumerate() {
        assert_fits("JobStatus", status);
        assert!(events[..place].iter().all(|(other, _)| other != id), "told twice");
        let progress = status["progress"].as_u64().unwrap();
        assert!(progress >= last, "{progress} after {last}");
        last = progress;
    }
    assert_eq!(events.last().unwrap().1, service.status(&jobs[1]).await);
}

#[tokio::test]
async fn a_client_that_comes_back_is_told_what_it_has_missed() {
    let mut service = Service::start(&[]);
    let job = service.accepted("", meshes::small()).await;
    service.ended(&job).await;
    let path = format!("{job}/events");
    let events = parse(&service.get(&path).send().await.unwrap().text().await.unwrap());
    assert_eq!(events.len(), 1);
    service.kill();
    let service = service.restart(&[]);
    let back = |id: &str| service.get(&path).header("last-event-id", id).send();
    assert_eq!(back(&events[0].0).await.unwrap().status(), 204, "nothing is left to tell");
    let response = back("another").await.unwrap();
    assert_eq!(parse(&response.text().await.unwrap()), events);
}

#[tokio::test]
async fn a_stop_ends_the_streams() {
    let mut service = Service::start(&["--workers", "1", "--grace", "1s"]);
    let jobs = service.backlog(3, &meshes::large()).await;
    let response = service.get(&format!("{}/events", jobs[2])).send().await.unwrap();
    service.terminate();
    let events = parse(&response.text().await.unwrap());
    assert_eq!(events[0].1["status"], "accepted");
    assert!(service.wait().success());
}
