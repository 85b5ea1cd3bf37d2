//! Issuers that are asked where their keys are, and issuers that do not answer.

use std::path::Path;
use std::process::Command;
use std::sync::{Arc, Mutex};

use axum::Router;
use axum::http::{StatusCode, header};
use axum::response::IntoResponse;
use axum::routing::get;
use jsonwebtoken::Algorithm;
use serde_json::{Value, json};
use tokio::net::TcpListener;

use crate::issuer::{AUDIENCE, Keys, Signer, arguments, but, claims, set};
use crate::service::{Service, problem, without_settings};
use crate::tls::logged;
use crate::tokens::{list, made_key, until};

/// An issuer that says where its keys are.
struct Issuer {
    /// As it is configured, and as tokens name it.
    name: String,
    configuration: Arc<Mutex<(StatusCode, String)>>,
}

impl Issuer {
    async fn start() -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let name = format!("http://{}/realms/ward", listener.local_addr().unwrap());
        let configuration = Arc::new(Mutex::new((StatusCode::OK, String::new())));
        let answer = configuration.clone();
        let path = "/realms/ward/.well-known/openid-configuration";
        let answered = async move || {
            let (status, text) = answer.lock().unwrap().clone();
            (status, [(header::LOCATION, "/elsewhere")], text).into_response()
        };
        let router = Router::new().route(path, get(answered));
        tokio::spawn(async move { axum::serve(listener, router).await });
        Self { name, configuration }
    }

    fn put(&self, status: StatusCode, text: impl ToString) {
        *self.configuration.lock().unwrap() = (status, text.to_string());
    }

    fn words(&self) -> [&str; 4] {
        ["--jwt-issuer", &self.name, "--jwt-audience", AUDIENCE]
    }

    fn token(&self, signer: &Signer) -> String {
        signer.sign(&but(json!({"iss": self.name})))
    }
}

/// A server of keys; its URL.
async fn served(keys: &Keys) -> String {
    keys.serve(TcpListener::bind("127.0.0.1:0").await.unwrap())
}

fn doctor(data: &Path, words: &[&str]) -> String {
    let mut command = Command::new(env!("CARGO_BIN_EXE_rosaline"));
    without_settings(&mut command);
    command.arg("doctor").env("ROSALINE_LISTEN", "127.0.0.1:0").env("ROSALINE_DATA", data).args(words);
    String::from_utf8(command.output().unwrap().stdout).unwrap()
}

async fn ready(service: &Service) -> (u16, Value) {
    let response = service.get("/readyz").send().await.unwrap();
    (response.status().as_u16(), response.json().await.unwrap())
}

#[tokio::test(flavor = "multi_thread")]
async fn an_issuer_says_where_its_keys_are_and_they_may_move() {
    let [old, new] = ["old", "new"].map(|id| Signer::new(id, Algorithm::ES256));
    let issuer = Issuer::start().await;
    let (first, second) = (Keys::new(set(&[&old])), Keys::new(set(&[&new])));
    issuer.put(StatusCode::OK, json!({"issuer": issuer.name, "jwks_uri": served(&first).await, "x": [1]}));
    let service = Service::start(&issuer.words());
    until(&service, &issuer.token(&old), 200).await;
    assert_eq!(
        ready(&service).await,
        (200, json!({"status": "ready", "version": env!("CARGO_PKG_VERSION")}))
    );
    // Of another issuer, though signed by the key.
    problem(list(&service, &old.sign(&claims("anna", "read"))).await, 401, "unauthenticated").await;
    problem(list(&service, &issuer.token(&new)).await, 401, "unauthenticated").await;
    let url = served(&second).await;
    issuer.put(StatusCode::OK, json!({"issuer": issuer.name, "jwks_uri": url}));
    until(&service, &issuer.token(&new), 200).await;
    problem(list(&service, &issuer.token(&old)).await, 401, "unauthenticated").await;
    let data = tempfile::tempdir().unwrap();
    let said = doctor(data.path(), &issuer.words());
    let named =
        format!("well   the issuer {} names {url} for its keys; they were not asked for", issuer.name);
    assert!(said.contains(&named), "{said}");
    // What is damaged now takes no key away.
    issuer.put(StatusCode::OK, "{");
    let begin = std::time::Instant::now();
    while !service.log().contains("is no configuration") {
        assert!(begin.elapsed() < crate::service::PATIENCE, "{}", service.log());
        list(&service, &issuer.token(&old)).await;
        tokio::time::sleep(std::time::Duration::from_millis(200)).await;
    }
    assert_eq!(list(&service, &issuer.token(&new)).await.status(), 200);
}

/// Nobody is let in by what might be another's keys.
#[tokio::test(flavor = "multi_thread")]
async fn a_configuration_that_does_not_fit_gives_no_keys() {
    let signer = Signer::new("one", Algorithm::ES256);
    let (issuer, keys) = (Issuer::start().await, Keys::new(set(&[&signer])));
    let url = served(&keys).await;
    let (name, token) = (issuer.name.clone(), issuer.token(&signer));
    let of = |issuer: &str, url: &str| json!({"issuer": issuer, "jwks_uri": url}).to_string();
    for (status, text, said) in [
        (StatusCode::OK, of(&format!("{name}/"), &url), "is the configuration of another issuer"),
        (StatusCode::OK, of("https://login.example", &url), "another issuer, \"https://login.example\""),
        (
            StatusCode::OK,
            of(&name, "http://login.example/keys"),
            "names \"http://login.example/keys\" for the keys",
        ),
        (StatusCode::OK, of(&name, "file:///etc/passwd"), "which is no https URL"),
        (
            StatusCode::OK,
            json!({"issuer": name}).to_string(),
            "is no configuration: missing field `jwks_uri`",
        ),
        (StatusCode::OK, "x".repeat((1 << 20) + 1), "more than 1048576 bytes"),
        (StatusCode::FOUND, of(&name, &url), "it answered 302"),
        (StatusCode::NOT_FOUND, of(&name, &url), "it answered 404"),
    ] {
        issuer.put(status, text);
        let service = Service::start(&issuer.words());
        problem(list(&service, &token).await, 503, "keys-unavailable").await;
        let log = service.log_with(said).await;
        assert!(log.contains(said), "{said}: {log}");
        let (status, body) = ready(&service).await;
        assert!(
            status == 503 && body["detail"].as_str().unwrap().contains("the issuer's keys did not come"),
            "{body}"
        );
        assert!(!body.to_string().contains(&name), "anyone may ask: {body}");
        let found = doctor(&service.data(), &issuer.words());
        let wrong = found.lines().find(|line| line.starts_with("WRONG  no token of")).unwrap();
        assert!(wrong.contains(said), "{said}: {found}");
    }
    assert_eq!(keys.asked(), 0);
}

#[test]
fn an_issuer_that_cannot_be_asked_needs_its_keys_named() {
    for issuer in ["ward", "http://login.example", "https://login.example/?x=1"] {
        let data = tempfile::tempdir().unwrap();
        let words = ["--jwt-issuer", issuer, "--jwt-audience", AUDIENCE];
        let output = crate::service::command(data.path()).args(words).output().unwrap();
        let line = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.code() == Some(1) && line.contains("say it with --jwks"), "{line}");
        assert!(doctor(data.path(), &words).contains("the service does not start"));
    }
}

#[tokio::test]
async fn an_issuer_that_never_answered_is_told_by_readiness() {
    let signer = Signer::new("one", Algorithm::ES256);
    let token = signer.sign(&claims("anna", "read"));
    // It takes connections and answers none.
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let url = format!("http://{}/keys", listener.local_addr().unwrap());
    let alone = Service::start(&arguments(&url));
    let data = Arc::new(tempfile::tempdir().unwrap());
    let key = made_key(data.path(), "pacs");
    let beside = Service::start_on(data, &arguments(&url));
    let (status, body) = ready(&alone).await;
    assert!(
        status == 503 && body["reasons"][0].as_str().unwrap().contains("the issuer's keys did not come"),
        "{body}"
    );
    assert_eq!(alone.get("/healthz").send().await.unwrap().status(), 200);
    let (status, body) = ready(&beside).await;
    assert!(
        status == 200 && body["warnings"][0].as_str().unwrap().contains("the issuer's keys did not come"),
        "{body}"
    );
    assert_eq!(list(&beside, &key).await.status(), 200);
    logged(&alone, "no token is let in until they come", 1).await;
    Keys::new(set(&[&signer])).serve(listener);
    for service in [&alone, &beside] {
        until(service, &token, 200).await;
        let (status, body) = ready(service).await;
        assert!(status == 200 && body.get("warnings").is_none(), "{body}");
    }
    let log = alone.log_with("not ready").await;
    assert!(log.matches("not ready").count() == 1 && !log.contains("stay those known before"), "{log}");
}

#[tokio::test]
async fn an_issuer_that_withdraws_all_its_keys_is_told_by_readiness() {
    let signer = Signer::new("one", Algorithm::ES256);
    let token = signer.sign(&claims("anna", "read"));
    let keys = Keys::new(set(&[&signer]));
    let service = Service::start(&arguments(&served(&keys).await));
    until(&service, &token, 200).await;
    assert_eq!(ready(&service).await.0, 200);
    // None that signatures can be checked with.
    keys.put(StatusCode::OK, json!({"keys": [{"kty": "oct", "k": "c2VjcmV0"}]}).to_string());
    // The keys in force are asked for again where a token names another.
    let unknown = Signer::new("two", Algorithm::ES256).sign(&claims("anna", "read"));
    let begin = std::time::Instant::now();
    while list(&service, &token).await.status() != 401 {
        assert!(begin.elapsed() < crate::service::PATIENCE, "{}", service.log());
        list(&service, &unknown).await;
        tokio::time::sleep(std::time::Duration::from_millis(100)).await;
    }
    let (status, body) = ready(&service).await;
    assert!(status == 503 && body["detail"].as_str().unwrap().contains("or it has none"), "{body}");
}

/// Where none were known, none are withdrawn.
#[tokio::test]
async fn an_issuer_that_has_no_keys_at_first_is_not_said_to_withdraw_them() {
    let signer = Signer::new("one", Algorithm::ES256);
    let keys = Keys::new(set(&[]));
    let service = Service::start(&arguments(&served(&keys).await));
    let log = service.log_with("the issuer has no keys").await;
    assert!(log.contains("the issuer has no keys") && !log.contains("withdrawn"), "{log}");
    assert_eq!(list(&service, &signer.sign(&claims("anna", "read"))).await.status(), 401);
}
