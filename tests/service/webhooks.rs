//! Webhooks, received over real sockets by a server that fails when it is told to.

use std::process::{Command, Output};
use std::sync::Arc;
use std::time::{Duration, Instant};

use serde_json::Value;
use tempfile::TempDir;

use crate::meshes;
use crate::receiver::{Answer, Receiver};
use crate::service::{PATIENCE, Service, command, problem, without_settings};
use crate::tls::{Files, Pair};

pub fn webhooks(data: &TempDir, arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_rosaline"));
    without_settings(&mut command);
    command.env("ROSALINE_DATA", data.path());
    command.arg("webhooks").args(arguments).output().unwrap()
}

/// What the command prints, which must succeed.
pub fn done(data: &TempDir, arguments: &[&str]) -> String {
    let output = webhooks(data, arguments);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap().trim().to_owned()
}

pub fn folder() -> Arc<TempDir> {
    Arc::new(tempfile::tempdir().unwrap())
}

/// Quick to try again. No limit that a busy machine could miss: only a test of that limit sets it low.
pub const QUICK: [&str; 4] = ["--webhook-retry", "1s", "--webhook-attempts", "3"];

/// The value of a metric once it is this one.
pub async fn metric(service: &Service, line: &str) {
    let begin = Instant::now();
    loop {
        let text = service.get("/metrics").send().await.unwrap().text().await.unwrap();
        if text.lines().any(|found| found == line) {
            return;
        }
        assert!(begin.elapsed() < PATIENCE, "{line}: {text}");
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
}

pub async fn nothing_waits(service: &Service) {
    metric(service, "rosaline_webhooks{state=\"waiting\"} 0").await;
}

pub async fn dead(service: &Service) -> Vec<Value> {
    let list: Value = service.get("/v1/webhooks/dead").send().await.unwrap().json().await.unwrap();
    list["webhooks"].as_array().unwrap().clone()
}

#[tokio::test]
async fn the_end_of_a_job_is_told_once_signed_and_without_patient_data() {
    let (all, failures) = (Receiver::start(&[]).await, Receiver::start(&[]).await);
    let data = folder();
    let secret = done(&data, &["add", "all", "--url", &all.url()]);
    let other = done(&data, &["add", "failures", "--url", &failures.url(), "--events", "failed"]);
    let service = Service::start_on(data.clone(), &[]);
    let good = service.accepted("?name=doe_jane.stl&client_reference=case-7", meshes::small()).await;
    let status = service.ended(&good).await;
    let bad = service.accepted("?name=doe_jane.stl", meshes::ball()).await;
    assert_eq!(service.ended(&bad).await["status"], "failed");
    let running = service.backlog(2, &meshes::large()).await;
    service.delete(&running[1]).send().await.unwrap();
    service.delete(&running[0]).send().await.unwrap();

    let messages = all.messages(4).await;
    let of = |job: &str| {
        let id = job.rsplit('/').next().unwrap();
        let mut found = messages.iter().filter(|message| message.json()["data"]["id"] == id);
        let message = found.next().unwrap();
        assert!(found.next().is_none(), "{job} is told twice");
        message
    };
    let message = of(&good);
    message.assert_signed(&secret);
    assert_eq!(
        (message.path.as_str(), message.header("content-type")),
        ("/hook?token=a", "application/json")
    );
    let body = message.json();
    assert_eq!((&body["type"], &body["data"]["status"]), (&"job.successful".into(), &"successful".into()));
    assert_eq!(
        (&body["data"]["client_reference"], &body["data"]["href"]),
        (&"case-7".into(), &good.as_str().into())
    );
    let time = |value: &Value| {
        let text = value.as_str().unwrap();
        time::OffsetDateTime::parse(text, &time::format_description::well_known::Rfc3339).unwrap()
    };
    for member in ["created", "started", "finished"] {
        assert_eq!(time(&body["data"][member]), time(&status[member]), "{member}");
    }
    assert_eq!(body["timestamp"], body["data"]["finished"]);
    let failed = of(&bad).json();
    assert_eq!((&failed["type"], &failed["data"]["error"]), (&"job.failed".into(), &"not-tubular".into()));
    for job in &running {
        assert_eq!(of(job).json()["type"], "job.dismissed");
    }
    let only = failures.messages(1).await;
    assert_eq!(only.len(), 1);
    only[0].assert_signed(&other);
    assert_eq!(only[0].json(), failed);
    for message in messages.iter().chain(&only) {
        assert!(!message.body.contains("doe") && !message.body.contains("detail"), "{}", message.body);
    }
    nothing_waits(&service).await;
    let list = done(&data, &["list"]);
    for text in [service.log(), list] {
        assert!(text.contains("all") && !text.contains(&secret[6..]) && !text.contains("doe"), "{text}");
        assert!(!text.contains("token=a") || !text.contains("INFO"), "the log names no URL: {text}");
    }
    assert_eq!((all.came().len(), failures.came().len()), (4, 1));
}

#[tokio::test]
async fn what_is_not_taken_is_sent_again_with_the_same_id() {
    // An error, and a redirect that is not followed.
    let receiver = Receiver::start(&[Answer::Status(500), Answer::Status(307)]).await;
    let data = folder();
    let secret = done(&data, &["add", "pacs", "--url", &receiver.url()]);
    let service = Service::start_on(data, &QUICK);
    let job = service.accepted("", meshes::small()).await;
    service.ended(&job).await;
    let messages = receiver.messages(3).await;
    for message in &messages {
        assert_eq!((message.id(), &message.body), (messages[0].id(), &messages[0].body));
        assert_eq!(message.path, "/hook?token=a");
        message.assert_signed(&secret);
    }
    nothing_waits(&service).await;
    assert_eq!(receiver.came().len(), 3);
    for failure in ["it answered 500", "it answered 307"] {
        assert!(service.log().contains(failure), "{failure}: {}", service.log());
    }
}

#[tokio::test]
async fn a_target_that_does_not_answer_in_time_is_sent_it_again() {
    let slow = Receiver::start(&[Answer::Slow(600_000)]).await;
    let data = folder();
    done(&data, &["add", "slow", "--url", &slow.url()]);
    // A busy machine may miss the second for later tries as well: more come then, and each counts as one that was late.
    let late = ["--webhook-retry", "1s", "--webhook-attempts", "100", "--webhook-timeout", "1s"];
    let service = Service::start_on(data, &late);
    let job = service.accepted("", meshes::small()).await;
    service.ended(&job).await;
    nothing_waits(&service).await;
    let messages = slow.came();
    assert!(messages.len() >= 2 && messages.iter().all(|message| message.id() == messages[0].id()));
    assert!(service.log().matches("timed out").count() >= 1, "{}", service.log());
}

// Its receiver answers while the test waits for the service's end.
#[tokio::test(flavor = "multi_thread")]
async fn a_kill_in_between_loses_nothing_and_what_was_taken_is_not_sent_again() {
    let receiver = Receiver::start(&[Answer::Status(503), Answer::Slow(60_000)]).await;
    let data = folder();
    done(&data, &["add", "pacs", "--url", &receiver.url()]);
    let retry = ["--webhook-retry", "1s"];
    let mut service = Service::start_on(data, &retry);
    let job = service.accepted("", meshes::small()).await;
    service.ended(&job).await;
    receiver.messages(1).await;
    service.kill();
    let mut service = service.restart(&retry);
    // Killed while the receiver has it and has not answered: whether it was taken is not known.
    receiver.messages(2).await;
    service.kill();
    let service = service.restart(&retry);
    let messages = receiver.messages(3).await;
    assert!(messages.iter().all(|message| message.id() == messages[0].id()));
    nothing_waits(&service).await;

    // An orderly stop lets a try end and notes it.
    receiver.plan.lock().unwrap().push_back(Answer::Slow(1_500));
    let job = service.accepted("", meshes::small()).await;
    service.ended(&job).await;
    receiver.messages(4).await;
    service.terminate();
    let mut service = service;
    assert!(service.wait().success());
    let service = service.restart(&retry);
    nothing_waits(&service).await;
    assert_eq!(receiver.came().len(), 4);
}

#[tokio::test]
async fn what_is_given_up_is_seen_and_can_be_sent_again() {
    let gone = Receiver::start(&[Answer::Status(410)]).await;
    let broken = Receiver::start(&[Answer::Status(500), Answer::Status(404)]).await;
    let data = folder();
    done(&data, &["add", "gone", "--url", &gone.url()]);
    done(&data, &["add", "broken", "--url", &broken.url()]);
    let attempts = ["--webhook-retry", "1s", "--webhook-attempts", "2"];
    let service = Service::start_on(data, &attempts);
    let job = service.accepted("", meshes::small()).await;
    service.ended(&job).await;
    metric(&service, "rosaline_webhooks{state=\"dead\"} 2").await;
    assert_eq!((gone.came().len(), broken.came().len()), (1, 2));

    let listed = dead(&service).await;
    let of = |target: &str| listed.iter().find(|webhook| webhook["target"] == target).unwrap();
    for (target, receiver, failure, attempts) in
        [("gone", &gone, "it answered 410", 1), ("broken", &broken, "it answered 404", 2)]
    {
        let webhook = of(target);
        assert_eq!(webhook["id"], receiver.came()[0].id());
        assert_eq!((&webhook["failure"], &webhook["attempts"]), (&failure.into(), &attempts.into()));
        assert_eq!(
            (&webhook["type"], webhook["job"].as_str()),
            (&"job.successful".into(), job.rsplit('/').next())
        );
    }
    let page = service.get("/v1/webhooks/dead?limit=1").send().await.unwrap();
    let next = page.headers()["link"].to_str().unwrap().split(['<', '>']).nth(1).unwrap().to_owned();
    let rest: Value = service.get(&next).send().await.unwrap().json().await.unwrap();
    assert_eq!(rest["webhooks"], serde_json::json!([listed[1]]));
    for query in ["limit=0", "cursor=x", "status=dead", "limit=1&limit=1"] {
        let response = service.get(&format!("/v1/webhooks/dead?{query}")).send().await.unwrap();
        assert_eq!(response.status(), 400, "{query}");
    }

    // Also after a restart, and only once.
    let service = service.restart(&attempts);
    let path = format!("/v1/webhooks/dead/{}/resend", of("gone")["id"].as_str().unwrap());
    assert_eq!(service.post(&path).send().await.unwrap().status(), 202);
    problem(service.post(&path).send().await.unwrap(), 404, "webhook-not-found").await;
    let messages = gone.messages(2).await;
    assert_eq!(messages[0].id(), messages[1].id());
    nothing_waits(&service).await;
    let left = dead(&service).await;
    assert_eq!((left.len(), &left[0]["target"]), (1, &"broken".into()));
    problem(service.post("/v1/webhooks/dead/x/resend").send().await.unwrap(), 404, "webhook-not-found").await;
    assert_eq!(broken.came().len(), 2);
}

#[tokio::test]
async fn only_an_admin_sees_what_was_given_up() {
    let data = folder();
    let key = |name: &str, scope: &str| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_rosaline"));
        without_settings(&mut command);
        command.env("ROSALINE_DATA", data.path());
        let output = command.args(["keys", "add", name, "--scope", scope]).output().unwrap();
        String::from_utf8(output.stdout).unwrap().trim().to_owned()
    };
    let (user, admin) = (key("user", "submit,read"), key("operator", "admin"));
    let receiver = Receiver::start(&[]).await;
    done(&data, &["add", "theirs", "--url", &receiver.url(), "--owner", "other"]);
    done(&data, &["add", "ours", "--url", &receiver.url(), "--owner", "user"]);
    let service = Service::start_on(data.clone(), &[]);
    let (list, resend) = ("/v1/webhooks/dead", "/v1/webhooks/dead/msg_0/resend");
    let response = service.get(list).bearer_auth(&user).send().await.unwrap();
    assert_eq!(problem(response, 403, "forbidden").await["scope"], "admin");
    let response = service.post(resend).bearer_auth(&user).send().await.unwrap();
    problem(response, 403, "forbidden").await;
    problem(service.get(list).send().await.unwrap(), 401, "unauthenticated").await;
    assert_eq!(service.get(list).bearer_auth(&admin).send().await.unwrap().status(), 200);
    // A target may be for one principal's jobs alone.
    for key in [&admin, &user] {
        let request = service.post("/v1/jobs").header("content-type", "model/stl").bearer_auth(key);
        let response = request.header("prefer", "wait=60").body(meshes::small()).send().await.unwrap();
        assert_eq!(response.status(), 201);
    }
    receiver.messages(1).await;
    let response = service.get("/metrics").bearer_auth(&admin).send().await.unwrap();
    assert!(response.text().await.unwrap().contains("rosaline_webhooks{state=\"dead\"} 0"));
    assert_eq!(receiver.came().len(), 1);
}

#[tokio::test]
async fn a_target_over_tls_must_show_a_certificate_that_is_trusted() {
    let files = Files::new(&Pair::new());
    // It takes no POST there, and so says that it was reached.
    let target = files.start(&[]);
    let url = format!("{}/healthz", target.url);
    let empty = tempfile::tempdir().unwrap();
    let none = empty.path().join("none.pem");
    for (trusted, plain, expected) in [
        (&files.cert, None, "it answered 405"),
        (&Files::new(&Pair::new()).cert, None, "invalid peer certificate"),
        // A system without CA certificates sends to plain targets alone.
        (&none, Some("http://127.0.0.1:1/"), "Connection refused"),
    ] {
        let data = folder();
        done(&data, &["add", "pacs", "--url", plain.unwrap_or(&url)]);
        let trust = [("SSL_CERT_FILE", trusted.as_path()), ("SSL_CERT_DIR", empty.path())];
        let service = Service::start_in(data, &["--webhook-attempts", "1"], &trust);
        let job = service.accepted("", meshes::small()).await;
        service.ended(&job).await;
        metric(&service, "rosaline_webhooks{state=\"dead\"} 1").await;
        let found = dead(&service).await[0]["failure"].as_str().unwrap().to_owned();
        assert!(found.contains(expected), "{expected}: {found}");
        assert!(!found.contains("127.0.0.1") && !service.log().contains("/healthz"), "{found}");
    }
    let data = folder();
    done(&data, &["add", "pacs", "--url", &url]);
    let mut command = command(data.path());
    let output = command.env("SSL_CERT_FILE", &none).env("SSL_CERT_DIR", empty.path()).output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&output.stderr).contains("ca-certificates"));
}
