//! More connections than there may be.

use std::net::TcpStream;
use std::process::Command;
use std::sync::Arc;
use std::time::{Duration, Instant};

use reqwest::{Client, Method, Response};
use serde_json::Value;

use crate::meshes;
use crate::service::{PATIENCE, Service, problem};
use crate::tls::{Files, Pair, trusting};

/// Connections on which nothing is asked.
fn idle(service: &Service, count: usize) -> Vec<TcpStream> {
    (0..count).map(|_| TcpStream::connect(service.address()).unwrap()).collect()
}

/// A client with a connection for each request.
fn fresh() -> Client {
    Client::builder().tls_certs_only([]).pool_max_idle_per_host(0).build().unwrap()
}

/// One request on a connection of its own.
async fn ask(service: &Service, path: &str) -> reqwest::Result<Response> {
    fresh().get(format!("{}{path}", service.url)).send().await
}

async fn connections(service: &Service) -> Value {
    let limits: Value = service.get("/v1/limits").send().await.unwrap().json().await.unwrap();
    limits["connections"].clone()
}

/// How many are open, as the service tells on a connection that it has already.
async fn open(service: &Service) -> usize {
    let text = service.get("/metrics").send().await.unwrap().text().await.unwrap();
    let line = text.lines().find_map(|line| line.strip_prefix("rosaline_connections{limit=\"within\"} "));
    line.unwrap().parse().unwrap()
}

async fn until_open(service: &Service, count: usize) {
    let begin = Instant::now();
    while open(service).await != count {
        assert!(begin.elapsed() < PATIENCE, "{}", service.log());
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

#[tokio::test]
async fn a_connection_too_many_is_told_so_and_probes_have_their_answer() {
    let service = Service::start(&["--max-connections", "4"]);
    // With the connection that this was asked on.
    assert_eq!((connections(&service).await, open(&service).await), (4.into(), 1));
    let others = idle(&service, 3);
    until_open(&service, 4).await;
    let refused = ask(&service, "/v1/jobs").await.unwrap();
    assert_eq!(
        (&refused.headers()["connection"], &refused.headers()["retry-after"]),
        (&"close".parse().unwrap(), &"5".parse().unwrap())
    );
    assert_eq!(problem(refused, 503, "too-many-connections").await["limit"], 4);
    let post = fresh().post(format!("{}/v1/jobs", service.url));
    problem(post.body(meshes::large()).send().await.unwrap(), 503, "too-many-connections").await;
    for probe in ["/healthz", "/readyz", "/metrics"] {
        assert_eq!(ask(&service, probe).await.unwrap().status(), 200, "{probe}");
    }
    // Who is in already is served.
    let job = service.accepted("", meshes::small()).await;
    service.ended(&job).await;
    drop(others);
    until_open(&service, 1).await;
    assert_eq!(ask(&service, "/v1/jobs").await.unwrap().status(), 200);
}

/// A page of another origin could not read the reason without its CORS headers.
#[tokio::test]
async fn browsers_and_requests_for_heads_are_told_too() {
    const PAGE: &str = "https://viewer.example";
    let service = Service::start(&["--max-connections", "4"]);
    assert_eq!(open(&service).await, 1);
    let others = idle(&service, 3);
    until_open(&service, 4).await;
    let url = format!("{}/v1/jobs", service.url);
    let from_page = |method| fresh().request(method, &url).header("origin", PAGE);
    let told = from_page(Method::GET).send().await.unwrap();
    assert_eq!(told.headers()["access-control-allow-origin"], "*");
    problem(told, 503, "too-many-connections").await;
    let head = from_page(Method::HEAD).send().await.unwrap();
    assert_eq!((head.status().as_u16(), &head.headers()["retry-after"]), (503, &"5".parse().unwrap()));
    let before = from_page(Method::OPTIONS).header("access-control-request-method", "POST");
    let before = before.send().await.unwrap();
    assert!(before.status().is_success(), "the request itself is what gets the reason: {before:?}");
    assert_eq!(before.headers()["access-control-allow-origin"], "*");
    drop(others);
}

#[tokio::test]
async fn past_the_limit_tls_is_spoken_too() {
    let pair = Pair::new();
    let files = Files::new(&pair);
    let mut service = files.start(&["--max-connections", "2"]);
    service.client = trusting(&[&pair]);
    let others = idle(&service, 2);
    let url = format!("{}/v1/jobs", service.url);
    let begin = Instant::now();
    let told = loop {
        let told = service.client.get(&url).send().await.unwrap();
        if told.status() != 200 {
            break told;
        }
        assert!(begin.elapsed() < PATIENCE, "{}", service.log());
    };
    problem(told, 503, "too-many-connections").await;
    assert_eq!(service.get("/healthz").send().await.unwrap().status(), 200);
    drop(others);
}

#[tokio::test]
async fn past_those_the_next_wait_until_one_has_gone() {
    let service = Service::start(&["--max-connections", "4"]);
    assert_eq!(open(&service).await, 1);
    let others = idle(&service, 3);
    until_open(&service, 4).await;
    // As many as may stand, which have a second to ask.
    let begin = Instant::now();
    let standing = idle(&service, 4);
    assert_eq!(ask(&service, "/healthz").await.unwrap().status(), 200);
    assert!(begin.elapsed() > Duration::from_millis(900), "it waited for the one that stood");
    drop((others, standing));
}

/// The next connection is there before the last has ended here.
#[tokio::test]
async fn who_has_one_connection_after_the_other_is_not_too_many() {
    let service = Service::start(&["--max-connections", "1"]);
    let url = format!("{}/v1/jobs?dry_run=true", service.url);
    for _ in 0..20 {
        let answer =
            fresh().post(&url).header("connection", "close").body(meshes::small()).send().await.unwrap();
        assert_eq!(answer.status(), 200, "{}", service.log());
    }
}

#[tokio::test]
async fn connections_leave_files_for_jobs() {
    let data = Arc::new(tempfile::tempdir().unwrap());
    let mut shell = Command::new("sh");
    shell.args(["-c", "ulimit -n 100; exec \"$0\" \"$@\"", env!("CARGO_BIN_EXE_rosaline"), "serve"]);
    let service = Service::try_start(crate::service::set_up(&mut shell, data.path()), data).unwrap();
    let job = service.accepted("", meshes::small()).await;
    assert_eq!(connections(&service).await, 16);
    assert!(service.log_with("max-connections").await.contains("WARN"), "{}", service.log());
    // More than there are files for, and no more than wait to be accepted.
    let others = idle(&service, 100);
    until_open(&service, 16).await;
    assert_eq!(service.ended(&job).await["status"], "successful");
    let job = service.accepted("", meshes::small()).await;
    assert_eq!(service.ended(&job).await["status"], "successful", "{}", service.log());
    drop(others);
}
