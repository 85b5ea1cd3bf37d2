//! Faults where it is noted what is to be told of jobs' ends.

use std::sync::Arc;
use std::time::{Duration, Instant};

use futures::StreamExt;
use reqwest::{RequestBuilder, Response};
use rosaline::jobs::faults::{Operation, VARIABLE};
use serde_json::Value;
use tempfile::TempDir;

use super::{Where, armed, operations};
use crate::meshes;
use crate::receiver::{Answer, Receiver};
use crate::service::{PATIENCE, Service, command};
use crate::tls::logged;
use crate::webhooks::{done, folder};

/// A service that is started again, without a fault, whenever it has died.
struct World {
    data: Arc<TempDir>,
    service: Option<Service>,
    /// What the processes before have logged.
    log: String,
}

impl World {
    fn start(&mut self, fault: &str) {
        if let Some(service) = self.service.take() {
            // Its last lines may still be on their way.
            std::thread::sleep(Duration::from_millis(200));
            self.log += &service.log();
        }
        let mut command = command(self.data.path());
        command.args(["--webhook-retry", "1s", "--webhook-timeout", "5s"]).env(VARIABLE, fault);
        match Service::try_start(&mut command, self.data.clone()) {
            Ok(service) => self.service = Some(service),
            Err(log) => self.log += &log,
        }
    }

    /// Sends until there is an answer that is no 5xx.
    async fn ask(&mut self, request: impl Fn(&Service) -> RequestBuilder) -> Response {
        let begin = Instant::now();
        loop {
            assert!(begin.elapsed() < PATIENCE, "{}", self.log);
            if self.service.as_mut().is_none_or(Service::has_ended) {
                self.start("");
            }
            if let Some(service) = &self.service
                && let Ok(response) = request(service).send().await
                && response.status().as_u16() < 500
            {
                return response;
            }
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    }

    async fn json(&mut self, path: &str) -> Value {
        self.ask(|service| service.get(path)).await.json().await.unwrap_or_default()
    }

    async fn waiting(&mut self) -> bool {
        let text = self.ask(|service| service.get("/metrics")).await.text().await.unwrap_or_default();
        !text.lines().any(|line| line == "rosaline_webhooks{state=\"waiting\"} 0")
    }
}

/// One job, whose end is refused once by its target, given up, sent again by the operator and taken.
async fn told_in_spite_of(operation: Operation, side: &str, action: &str) {
    let case = format!("{operation:?} {side} {action}");
    let receiver = Receiver::start(&[Answer::Status(410)]).await;
    let mut world = World { data: folder(), service: None, log: String::new() };
    done(&world.data, &["add", "pacs", "--url", &receiver.url()]);
    world.start(&armed(operation, side, action));
    let mesh = meshes::small();
    let post =
        |service: &Service| service.post("/v1/jobs").header("idempotency-key", "one").body(mesh.clone());
    let begin = Instant::now();
    while world.ask(post).await.status() != 201 {
        assert!(begin.elapsed() < PATIENCE, "{case}");
    }
    let begin = Instant::now();
    loop {
        assert!(begin.elapsed() < PATIENCE, "{case}: {} came; {}", receiver.came().len(), world.log);
        let dead = world.json("/v1/webhooks/dead").await;
        if let Some(id) = dead["webhooks"][0]["id"].as_str() {
            let path = format!("/v1/webhooks/dead/{id}/resend");
            // The answer to an earlier one may have been lost.
            let status = world.ask(|service| service.post(&path)).await.status().as_u16();
            assert!([202, 404].contains(&status), "{case}: {status}");
        } else if receiver.came().len() >= 2 && !world.waiting().await {
            break;
        }
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    let messages = receiver.came();
    assert!(messages.iter().all(|message| message.id() == messages[0].id()), "{case}: told as two ends");
    let log = world.log + &world.service.unwrap().log();
    assert!(log.contains(&format!("fault=\"{}\"", operation.name())), "no process came by {case}: {log}");
}

#[tokio::test]
async fn a_fault_while_a_jobs_end_is_told_loses_it_not() {
    let sides = ["before", "after"].into_iter();
    let cases = operations(Where::Webhooks)
        .flat_map(|operation| sides.clone().map(move |side| (operation, side)))
        .flat_map(|(operation, side)| ["crash", "error"].map(|action| (operation, side, action)));
    let told = cases.map(|(operation, side, action)| told_in_spite_of(operation, side, action));
    // Some wait for a lease to run out: not one after the other.
    futures::stream::iter(told).buffer_unordered(8).collect::<Vec<()>>().await;
}

#[tokio::test]
async fn a_change_of_the_targets_that_fails_is_tried_again() {
    let receiver = Receiver::start(&[]).await;
    let mut world = World { data: folder(), service: None, log: String::new() };
    world.start(&armed(Operation::StoreListen, "before", "error"));
    let service = world.service.as_ref().unwrap();
    done(&world.data, &["add", "pacs", "--url", &receiver.url()]);
    logged(service, "targets stay those before", 1).await;
    logged(service, "targets have changed", 1).await;
    service.accepted("", meshes::small()).await;
    receiver.messages(1).await;
}
