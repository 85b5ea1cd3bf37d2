//! Authentication off and on by key, and whose job is whose.

use std::process::{Command, Output};
use std::sync::Arc;
use std::time::{Duration, Instant};

use reqwest::{Method, RequestBuilder, Response};
use serde_json::Value;
use tempfile::TempDir;

use crate::meshes;
use crate::service::{Service, command, problem, without_settings};

pub fn keys(data: &TempDir, arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_rosaline"));
    without_settings(&mut command);
    command.env("ROSALINE_DATA", data.path());
    command.arg("keys").args(arguments).output().unwrap()
}

/// The key that a command prints.
pub fn made(data: &TempDir, arguments: &[&str]) -> String {
    let output = keys(data, arguments);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap().trim().to_owned()
}

pub fn with(request: RequestBuilder, key: &str) -> RequestBuilder {
    request.header("authorization", format!("Bearer {key}"))
}

async fn post(service: &Service, key: &str, query: &str) -> Response {
    let request =
        service.post(&format!("/v1/jobs{query}")).header("idempotency-key", format!("same{}", query.len()));
    with(request, key).body(meshes::small()).send().await.unwrap()
}

async fn job(service: &Service, key: &str, query: &str) -> String {
    let response = post(service, key, query).await;
    assert_eq!(response.status(), 201);
    let job = response.headers()["location"].to_str().unwrap().to_owned();
    loop {
        let wait = with(service.get(&job), key).header("prefer", "wait=60");
        let status: Value = wait.send().await.unwrap().json().await.unwrap();
        if status["status"] == "successful" {
            return job;
        }
        assert!(matches!(status["status"].as_str(), Some("accepted" | "running")), "{status}");
    }
}

#[tokio::test]
async fn others_are_let_in_with_a_key_or_when_the_operator_says_so() {
    let refused = |arguments: &[&str]| {
        let dir = tempfile::tempdir().unwrap();
        let output = command(dir.path()).args(arguments).output().unwrap();
        assert_eq!(output.status.code(), Some(1));
        let text = String::from_utf8(output.stderr).unwrap();
        let line = text.lines().last().unwrap().to_owned();
        assert!(line.contains("keys add") && line.contains("--insecure"), "{line}");
    };
    refused(&["--listen", "0.0.0.0:0"]);
    refused(&["--listen", "[::]:0"]);
    for arguments in [vec![], vec!["--listen", "127.0.0.2:0"], vec!["--listen", "0.0.0.0:0", "--insecure"]] {
        let service = Service::start(&arguments);
        assert_eq!(service.get("/v1/jobs").send().await.unwrap().status(), 200, "{arguments:?}");
        assert!(service.log().contains("no key is needed"), "{}", service.log());
    }
    let data = Arc::new(tempfile::tempdir().unwrap());
    let key = made(&data, &["add", "pacs", "--scope", "read"]);
    let service = Service::start_on(data, &["--listen", "0.0.0.0:0"]);
    problem(service.get("/v1/jobs").send().await.unwrap(), 401, "unauthenticated").await;
    assert_eq!(with(service.get("/v1/jobs"), &key).send().await.unwrap().status(), 200);
}

/// A file of keys that is away does not open what it closed.
#[tokio::test]
async fn a_service_whose_key_file_is_away_does_not_start_open() {
    let data = Arc::new(tempfile::tempdir().unwrap());
    let refused = |arguments: &[&str], words: &[&str]| {
        let started = Service::try_start(command(data.path()).args(arguments), data.clone());
        let text = started.err().unwrap_or_else(|| panic!("it started with {arguments:?}"));
        let line = text.lines().last().unwrap();
        assert!(words.iter().all(|word| line.contains(word)), "{line}");
    };
    let named = data.path().join("other.json");
    let named = named.to_str().unwrap();
    for more in [&[][..], &["--insecure"]] {
        refused(&[&["--keys", named], more].concat(), &["was named", "--keys", "other.json", "keys add"]);
    }
    let config = data.path().join("rosaline.toml");
    std::fs::write(&config, format!("keys = \"{named}\"\n")).unwrap();
    refused(&["--config", config.to_str().unwrap()], &["was named", "other.json"]);
    // Whom no job belongs to, the lost file takes nothing from.
    assert_eq!(Service::start_on(data.clone(), &[]).get("/v1/jobs").send().await.unwrap().status(), 200);
    let key = made(&data, &["add", "pacs", "--scope", "submit,read"]);
    let service = Service::start_on(data.clone(), &[]);
    job(&service, &key, "").await;
    drop(service);
    std::fs::rename(data.path().join("keys.json"), data.path().join("copy.json")).unwrap();
    refused(&[], &["belong to somebody", "keys.json", "keys add", "--insecure"]);
    let service = Service::start_on(data.clone(), &["--insecure"]);
    assert_eq!(service.get("/v1/jobs").send().await.unwrap().status(), 200);
    drop(service);
    std::fs::rename(data.path().join("copy.json"), data.path().join("keys.json")).unwrap();
    let service = Service::start_on(data.clone(), &[]);
    assert_eq!(with(service.get("/v1/jobs"), &key).send().await.unwrap().status(), 200);
}

#[tokio::test]
async fn without_a_valid_key_nothing_is_told_and_nothing_is_taken() {
    let data = Arc::new(tempfile::tempdir().unwrap());
    let key = made(&data, &["add", "pacs", "--scope", "submit,read"]);
    let service = Service::start_on(data.clone(), &[]);
    let job = job(&service, &key, "").await;
    let last = if key.ends_with('0') { "1" } else { "0" };
    let wrong = format!("{}{last}", &key[..key.len() - 1]);
    let paths = ["/v1/jobs", "/v1/limits", &job, "/v1/nothing", &format!("{job}/results/centerline")];
    for path in paths {
        let response = service.get(path).send().await.unwrap();
        assert_eq!(response.headers()["www-authenticate"], "Bearer realm=\"rosaline\"", "{path}");
        problem(response, 401, "unauthenticated").await;
        problem(with(service.get(path), &wrong).send().await.unwrap(), 401, "unauthenticated").await;
        let basic = service.get(path).header("authorization", format!("Basic {key}"));
        problem(basic.send().await.unwrap(), 401, "unauthenticated").await;
        let twice = with(with(service.get(path), &key), &wrong);
        problem(twice.send().await.unwrap(), 401, "unauthenticated").await;
    }
    let files = service.files();
    problem(service.submit("", meshes::small()).await, 401, "unauthenticated").await;
    problem(service.delete(&job).send().await.unwrap(), 401, "unauthenticated").await;
    assert_eq!(service.files(), files);
    for path in ["/healthz", "/readyz", "/openapi.yaml"] {
        assert_eq!(service.get(path).send().await.unwrap().status(), 200, "{path} tells nothing of jobs");
    }
    let kept = std::fs::read_to_string(data.path().join("keys.json")).unwrap();
    for text in [service.log(), kept] {
        assert!(!text.contains(&key) && !text.contains(key.rsplit('_').next().unwrap()), "{text}");
    }
}

#[tokio::test]
async fn a_job_belongs_to_its_principal_and_is_not_there_for_others() {
    let data = Arc::new(tempfile::tempdir().unwrap());
    let ours = made(&data, &["add", "ours", "--scope", "submit,read"]);
    let theirs = made(&data, &["add", "theirs", "--scope", "submit,read"]);
    let admin = made(&data, &["add", "operator", "--scope", "admin"]);
    let mut service = Service::start_on(data, &[]);
    let (mine, other) = (job(&service, &ours, "").await, job(&service, &theirs, "").await);
    assert_ne!(mine, other, "an idempotency key is its principal's");
    let again = post(&service, &ours, "").await;
    assert_eq!(again.headers()["location"], mine.as_str());
    // Also after a restart.
    service.kill();
    let service = service.restart(&[]);
    let paths = ["", "/events", "/results/centerline", "/results/centerline.json", "/results/centerline.glb"];
    for (path, method) in paths.map(|path| (path, Method::GET)).into_iter().chain([
        ("", Method::DELETE),
        ("/retry", Method::POST),
        ("", Method::HEAD),
    ]) {
        let request = service.client.request(method.clone(), format!("{}{mine}{path}", service.url));
        let response = with(request, &theirs).send().await.unwrap();
        assert_eq!(response.status(), 404, "{method} {path}");
        if method != Method::HEAD {
            problem(response, 404, "job-not-found").await;
        }
    }
    let listed = async |key: &str| {
        let list: Value = with(service.get("/v1/jobs"), key).send().await.unwrap().json().await.unwrap();
        list["jobs"].as_array().unwrap().iter().map(|job| job["links"][0]["href"].clone()).collect::<Vec<_>>()
    };
    assert_eq!(listed(&ours).await, [mine.as_str()]);
    assert_eq!(listed(&theirs).await, [other.as_str()]);
    assert_eq!(listed(&admin).await, [other.as_str(), mine.as_str()]);
    assert_eq!(with(service.get(&mine), &admin).send().await.unwrap().status(), 200);
    assert_eq!(with(service.delete(&other), &admin).send().await.unwrap().status(), 204);
    assert_eq!(with(service.delete(&mine), &ours).send().await.unwrap().status(), 204);
}

#[tokio::test]
async fn keys_have_scopes_and_change_while_the_service_runs() {
    let data = Arc::new(tempfile::tempdir().unwrap());
    let service = Service::start_on(data.clone(), &[]);
    let open = service.accepted("", meshes::small()).await;
    service.ended(&open).await;
    // The first key closes the service.
    let reader = made(&data, &["add", "reader", "--scope", "read"]);
    problem(service.get(&open).send().await.unwrap(), 401, "unauthenticated").await;
    problem(with(service.get(&open), &reader).send().await.unwrap(), 404, "job-not-found").await;
    let response = post(&service, &reader, "").await;
    assert_eq!(problem(response, 403, "forbidden").await["scope"], "submit");
    let writer = made(&data, &["add", "writer", "--scope", "submit"]);
    assert_eq!(post(&service, &writer, "").await.status(), 201);
    let response = with(service.get("/v1/jobs"), &writer).send().await.unwrap();
    assert_eq!(problem(response, 403, "forbidden").await["scope"], "read");

    let rotated = made(&data, &["rotate", "writer"]);
    problem(post(&service, &writer, "?omega=0.8").await, 401, "unauthenticated").await;
    assert_eq!(post(&service, &rotated, "?omega=0.8").await.status(), 201);
    assert!(keys(&data, &["revoke", "writer"]).status.success());
    problem(post(&service, &rotated, "?omega=0.75").await, 401, "unauthenticated").await;

    let list = made(&data, &["list"]);
    assert!(list.lines().any(|line| line.starts_with("reader  ") && line.ends_with("  active")), "{list}");
    assert!(list.lines().any(|line| line.starts_with("writer  ") && line.contains("revoked 20")), "{list}");
    for wrong in [vec!["add", "reader", "--scope", "read"], vec!["rotate", "writer"], vec!["add", "x"]] {
        assert_eq!(keys(&data, &wrong).status.code(), Some(1), "{wrong:?}");
    }
}

/// Who waits for news of a job waits no longer than its key is valid.
#[tokio::test]
async fn streams_and_waits_end_soon_after_their_key() {
    let data = Arc::new(tempfile::tempdir().unwrap());
    let key = made(&data, &["add", "pacs", "--scope", "submit,read"]);
    let other = made(&data, &["add", "other", "--scope", "admin"]);
    let service = Service::start_on(data.clone(), &["--workers", "1"]);
    // Two that take longer than this test, and change often.
    let slow = || meshes::stl(&meshes::tube(600, 120));
    let mut jobs = Vec::new();
    for _ in 0..2 {
        let request = with(service.post("/v1/jobs?smoothing=true&preset=paper"), &key).body(slow());
        jobs.push(request.send().await.unwrap().headers()["location"].to_str().unwrap().to_owned());
    }
    let stream = |job: &str, key: &str| with(service.get(&format!("{job}/events")), key).send();
    let (running, waiting) = (stream(&jobs[0], &key).await.unwrap(), stream(&jobs[1], &key).await.unwrap());
    let admins = stream(&jobs[1], &other).await.unwrap();
    let wait = with(service.get(&jobs[1]), &key).header("prefer", "wait=60").send();
    let post = with(service.post("/v1/jobs"), &key).header("prefer", "wait=60").body(meshes::small()).send();
    let revoked = async {
        tokio::time::sleep(Duration::from_secs(1)).await;
        assert!(keys(&data, &["revoke", "pacs"]).status.success());
        Instant::now()
    };
    let (wait, post, revoked) = tokio::join!(wait, post, revoked);
    assert!(running.text().await.unwrap().contains("event: status"));
    assert!(waiting.text().await.unwrap().contains("event: status"));
    problem(wait.unwrap(), 401, "unauthenticated").await;
    assert_eq!(post.unwrap().status(), 201, "it was accepted");
    assert!(revoked.elapsed() < Duration::from_secs(10), "{:?}", revoked.elapsed());
    let still = tokio::time::timeout(Duration::from_secs(5), admins.text()).await;
    assert!(still.is_err(), "another's key is as valid as before");
    for job in jobs {
        with(service.delete(&job), &other).send().await.unwrap();
    }
}

/// Each refusal names a way that works.
#[tokio::test]
async fn a_revoked_name_is_no_dead_end_and_its_jobs_are_handed_on_only_when_that_is_said() {
    let data = Arc::new(tempfile::tempdir().unwrap());
    let old = made(&data, &["add", "pacs", "--scope", "submit,read"]);
    let service = Service::start_on(data.clone(), &[]);
    let mine = job(&service, &old, "").await;
    let said = |arguments: &[&str]| {
        let output = keys(&data, arguments);
        assert_eq!(output.status.code(), Some(1), "{arguments:?}");
        String::from_utf8(output.stderr).unwrap()
    };
    let taken = said(&["add", "pacs", "--scope", "read"]);
    assert!(taken.contains("keys rotate pacs"), "{taken}");
    assert!(keys(&data, &["revoke", "pacs"]).status.success());
    for arguments in [vec!["add", "pacs", "--scope", "read"], vec!["rotate", "pacs"], vec!["revoke", "pacs"]]
    {
        let line = said(&arguments);
        assert!(line.contains("was revoked") && line.contains("jobs still belong to that name"), "{line}");
        assert!(line.contains("keys add pacs --inherit") && !line.contains("rotate"), "{line}");
    }
    let heir = made(&data, &["add", "pacs", "--inherit", "--scope", "read"]);
    assert_eq!(with(service.get(&mine), &heir).send().await.unwrap().status(), 200);
    problem(with(service.get(&mine), &old).send().await.unwrap(), 401, "unauthenticated").await;
    let list = made(&data, &["list"]);
    assert_eq!(list.lines().filter(|line| line.starts_with("pacs  ")).count(), 2, "{list}");
    assert!(made(&data, &["rotate", "pacs"]).starts_with("rosaline_"));
}

/// What was named and is not there is told as that, and nothing is made by looking.
#[test]
fn a_change_of_a_file_that_is_not_there_makes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    for (what, act) in
        [("keys", "rotate"), ("keys", "revoke"), ("webhooks", "rotate"), ("webhooks", "remove")]
    {
        for named in ["nope.json", "nowhere/nope.json"] {
            let mut command = Command::new(env!("CARGO_BIN_EXE_rosaline"));
            without_settings(&mut command);
            command.current_dir(folder.path()).args([what, act, "pacs", &format!("--{what}"), named]);
            let output = command.output().unwrap();
            let line = String::from_utf8(output.stderr).unwrap();
            assert_eq!(output.status.code(), Some(1), "{line}");
            assert!(line.contains(&format!("{named} is not there")) && line.contains(" add NAME"), "{line}");
            assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "{what} {act}");
        }
    }
}

/// What is said beside the secret is no reason to fail once it is made.
#[test]
fn nobody_needs_to_read_what_is_said_beside_a_secret() {
    let folder = tempfile::tempdir().unwrap();
    let unread = |words: &[&str]| {
        let (reader, writer) = std::io::pipe().unwrap();
        drop(reader);
        let mut command = Command::new(env!("CARGO_BIN_EXE_rosaline"));
        without_settings(&mut command);
        let output = command.current_dir(folder.path()).args(words).stderr(writer).output().unwrap();
        assert!(output.status.success(), "{words:?}: {output:?}");
        String::from_utf8(output.stdout).unwrap()
    };
    assert!(unread(&["keys", "add", "pacs", "--scope", "read"]).starts_with("rosaline_"));
    let owned = ["--url", "http://127.0.0.1:1/", "--owner", "nobody"];
    assert!(unread(&[&["webhooks", "add", "x"][..], &owned].concat()).starts_with("whsec_"));
    std::fs::create_dir(folder.path().join("empty")).unwrap();
    for what in ["keys", "webhooks"] {
        assert!(unread(&[what, "list", "--data", "empty"]).is_empty());
    }
}
