//! Authentication by JWT: of whom, signed how, and by which keys.

use std::path::Path;
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use axum::http::StatusCode;
use jsonwebtoken::{Algorithm, EncodingKey, Header, encode};
use serde_json::{Value, json};

use crate::issuer::{AUDIENCE, ISSUER, KeyFile, Keys, Signer, arguments, at, but, claims, forged, set};
use crate::meshes;
use crate::service::{PATIENCE, Service, command, problem, without_settings};

pub async fn list(service: &Service, token: &str) -> reqwest::Response {
    service.get("/v1/jobs").bearer_auth(token).send().await.unwrap()
}

async fn submitted(service: &Service, token: &str) -> String {
    let request = service.post("/v1/jobs").header("content-type", "model/stl").body(meshes::small());
    let response = request.bearer_auth(token).send().await.unwrap();
    assert_eq!(response.status(), 201);
    response.headers()["location"].to_str().unwrap().to_owned()
}

async fn status(service: &Service, job: &str, token: &str) -> u16 {
    service.get(job).bearer_auth(token).send().await.unwrap().status().as_u16()
}

pub fn made_key(data: &Path, name: &str) -> String {
    let mut command = Command::new(env!("CARGO_BIN_EXE_rosaline"));
    without_settings(&mut command);
    command.env("ROSALINE_DATA", data);
    let output = command.args(["keys", "add", name, "--scope", "submit,read"]).output().unwrap();
    assert!(output.status.success());
    String::from_utf8(output.stdout).unwrap().trim().to_owned()
}

/// Users of the audit trail's lines.
fn users(service: &Service) -> Vec<String> {
    let text = std::fs::read_to_string(service.data().join("audit.jsonl")).unwrap();
    let lines = text.lines().map(|line| serde_json::from_str::<Value>(line).unwrap());
    lines.map(|line| line["ActiveParticipant"][0]["UserID"].as_str().unwrap().to_owned()).collect()
}

#[tokio::test]
async fn a_token_lets_its_subject_in_and_its_jobs_are_its_own() {
    let signers =
        [Algorithm::ES256, Algorithm::RS256, Algorithm::EdDSA].map(|algorithm| Signer::new("one", algorithm));
    let signer = &signers[0];
    let file = KeyFile::new(&set(&[signer]));
    let service = file.start(&["--listen", "0.0.0.0:0"]);
    let response = service.get("/v1/jobs").send().await.unwrap();
    assert_eq!(response.headers()["www-authenticate"], "Bearer realm=\"rosaline\"");
    problem(response, 401, "unauthenticated").await;

    let anna = signer.sign(&claims("anna", "openid submit read"));
    let job = submitted(&service, &anna).await;
    assert_eq!(status(&service, &job, &anna).await, 200);
    let key = made_key(&service.data(), "anna");
    let others = [signer.sign(&claims("berta", "submit read")), key.clone()];
    for other in &others {
        assert_eq!(status(&service, &job, other).await, 404, "{other}");
    }
    let operator = signer.sign(&but(json!({"sub": "operator", "scope": null, "scp": ["rosaline:admin"]})));
    assert_eq!(status(&service, &job, &operator).await, 200);
    let theirs = submitted(&service, &key).await;
    assert_eq!(status(&service, &theirs, &anna).await, 404);

    for (claims, scope) in [
        (claims("carla", "read"), "submit"),
        (but(json!({"sub": "carla", "scope": null, "scp": "rosaline:submit"})), "read"),
        (but(json!({"sub": "carla", "scope": null})), "read"),
        (claims("carla", "reader admins"), "read"),
    ] {
        let token = signer.sign(&claims);
        let path = service.url.clone() + "/v1/jobs";
        let request = if scope == "read" { service.client.get(path) } else { service.client.post(path) };
        let response = request.bearer_auth(&token).send().await.unwrap();
        let challenge = format!("Bearer realm=\"rosaline\", error=\"insufficient_scope\", scope=\"{scope}\"");
        assert_eq!(response.headers()["www-authenticate"], challenge.as_str(), "{claims}");
        assert_eq!(problem(response, 403, "forbidden").await["scope"], scope);
    }
    let users = users(&service);
    for (user, lines) in [("anna", 1), (&format!("{ISSUER}#anna"), 1), (&format!("{ISSUER}#carla"), 4)] {
        assert_eq!(users.iter().filter(|found| *found == user).count(), lines, "{user}: {users:?}");
    }
    // The other kinds of keys.
    for signer in &signers {
        file.put(&set(&[signer]));
        assert_eq!(
            list(&service, &signer.sign(&claims("anna", "read"))).await.status(),
            200,
            "{:?}",
            signer.algorithm
        );
    }
    assert!(!service.log().contains(&anna) && !service.log().contains("anna"), "{}", service.log());
}

/// Tokens whose claims do not let anybody in, each with what is said of it.
fn with_wrong_claims(signer: &Signer) -> Vec<(&'static str, String)> {
    vec![
        ("expired", signer.sign(&but(json!({"exp": at(-120)})))),
        ("not valid yet", signer.sign(&but(json!({"nbf": at(3600)})))),
        ("another audience", signer.sign(&but(json!({"aud": "other"})))),
        ("another audience", signer.sign(&but(json!({"aud": ["other", "third"]})))),
        ("another issuer", signer.sign(&but(json!({"iss": "https://login.example/realms/other"})))),
        ("lacks a claim", signer.sign(&but(json!({"iss": [ISSUER]})))),
        ("lacks a claim", signer.sign(&but(json!({"iss": null})))),
        ("lacks a claim", signer.sign(&but(json!({"exp": null})))),
        ("lacks a claim", signer.sign(&but(json!({"exp": "tomorrow"})))),
        ("lacks a claim", signer.sign(&but(json!({"aud": null})))),
        ("lacks a claim", signer.sign(&but(json!({"sub": null})))),
        ("lacks a claim", signer.sign(&but(json!({"sub": ""})))),
        ("lacks a claim", signer.sign(&but(json!({"sub": "a\nb"})))),
    ]
}

/// Tokens that are not signed by a key of the set `one`, `rsa`, `shared` and `enc`, or not so that it counts.
fn with_wrong_signatures(signer: &Signer, rsa: &Signer) -> Vec<(&'static str, String)> {
    let stranger = Signer::new("one", Algorithm::ES256);
    let good = claims("anna", "submit read");
    let hmac = |id: &str, secret: &[u8]| {
        let header = Header { kid: Some(id.to_owned()), ..Header::new(Algorithm::HS256) };
        encode(&header, &good, &EncodingKey::from_secret(secret)).unwrap()
    };
    let named = |id: &str| {
        let header = Header { kid: Some(id.to_owned()), ..signer.header() };
        encode(&header, &good, &signer.secret()).unwrap()
    };
    let critical = Header { crit: Some(vec!["b64".to_owned()]), ..signer.header() };
    let genuine = signer.sign(&good);
    let (body, signature) = genuine.rsplit_once('.').unwrap();
    let other = signer.sign(&claims("berta", "admin"));
    vec![
        ("not accepted", forged(&json!({"alg": "none", "kid": "one"}), &good, "")),
        ("not accepted", forged(&json!({"alg": "None"}), &good, signature)),
        ("not accepted", hmac("one", signer.pair.public_key_pem().as_bytes())),
        ("not accepted", hmac("one", signer.pair.public_key_raw())),
        ("not accepted", hmac("rsa", rsa.pair.public_key_pem().as_bytes())),
        ("not accepted", hmac("shared", b"secret-secret-secret-secret")),
        ("not accepted", encode(&critical, &good, &signer.secret()).unwrap()),
        ("not by the issuer's key", stranger.sign(&good)),
        ("not by the issuer's key", genuine.replace(body, other.rsplit_once('.').unwrap().0)),
        ("names no key", named("two")),
        ("names no key", named("rsa")),
        ("names no key", named("enc")),
    ]
}

#[tokio::test]
async fn what_is_no_valid_token_is_refused_with_the_reason() {
    let (signer, rsa) = (Signer::new("one", Algorithm::ES256), Signer::new("rsa", Algorithm::RS256));
    let shared = json!({"kty": "oct", "kid": "shared", "k": "c2VjcmV0LXNlY3JldC1zZWNyZXQtc2VjcmV0"});
    let encryption =
        json!({"kty": "RSA", "use": "enc", "alg": "RSA-OAEP", "kid": "enc", "n": "AQAB", "e": "AQAB"});
    let keys = json!({"keys": [signer.public(), rsa.public(), shared, encryption]});
    let file = KeyFile::new(&keys.to_string());
    let service = file.start(&[]);
    let good = claims("anna", "submit read");
    let genuine = signer.sign(&good);
    assert_eq!(list(&service, &genuine).await.status(), 200);
    let (body, signature) = genuine.rsplit_once('.').unwrap();
    let no_tokens = [
        ("no signed JWT", "rosaline".to_owned()),
        ("no signed JWT", "a.b.c".to_owned()),
        ("no signed JWT", format!("{genuine}.x")),
        ("no signed JWT", format!("{}.{body}.{signature}", "x".repeat(20_000))),
        ("the key is not valid", "rosaline_0123456789ab_secret".to_owned()),
    ];
    let cases =
        with_wrong_claims(&signer).into_iter().chain(with_wrong_signatures(&signer, &rsa)).chain(no_tokens);
    for (reason, token) in cases {
        let response = list(&service, &token).await;
        let challenge = response.headers()["www-authenticate"].to_str().unwrap().to_owned();
        assert!(
            challenge.starts_with("Bearer realm=\"rosaline\", error=\"invalid_token\", error_description=\"")
        );
        assert!(challenge.contains(reason), "{reason}: {challenge} for {token}");
        let body = problem(response, 401, "unauthenticated").await;
        let detail = body["detail"].as_str().unwrap();
        assert!(detail.contains(reason), "{body}");
        // An operator makes no tokens.
        assert_eq!(detail.contains("The operator makes keys"), reason == "the key is not valid", "{body}");
    }
    // Clocks may differ a little, and an audience be one of several.
    for changes in [json!({"exp": at(-5)}), json!({"nbf": at(10)}), json!({"aud": ["other", AUDIENCE]})] {
        assert_eq!(list(&service, &signer.sign(&but(changes))).await.status(), 200);
    }
    // Without an id the only key that fits is meant.
    let nameless = Header { kid: None, ..signer.header() };
    let nameless = encode(&nameless, &good, &signer.secret()).unwrap();
    assert_eq!(list(&service, &nameless).await.status(), 200);
    // Further ones are summed up.
    assert!(users(&service).iter().filter(|user| *user == "anonymous").count() >= 20);
}

#[tokio::test]
async fn keys_of_a_file_are_exchanged_while_the_service_runs() {
    let [old, new] = ["old", "new"].map(|id| Signer::new(id, Algorithm::ES256));
    let file = KeyFile::new(&set(&[&old]));
    let service = file.start(&[]);
    let [by_old, by_new] = [&old, &new].map(|signer| signer.sign(&claims("anna", "read")));
    let both = async || {
        (list(&service, &by_old).await.status().as_u16(), list(&service, &by_new).await.status().as_u16())
    };
    assert_eq!(both().await, (200, 401));
    file.put(&set(&[&old, &new]));
    assert_eq!(both().await, (200, 200));
    file.put(&set(&[&new]));
    assert_eq!(both().await, (401, 200));
    for broken in ["{", "{\"keys\": []}", "[]"] {
        file.put(broken);
        assert_eq!(both().await, (503, 503), "{broken}");
    }
    std::fs::remove_file(file.path()).unwrap();
    assert_eq!(both().await, (503, 503));
    assert_eq!(service.log().matches("no token is let in").count(), 4, "{}", service.log());
    file.put(&set(&[&new]));
    assert_eq!(both().await, (401, 200));
}

/// Asks until this token is answered so.
pub async fn until(service: &Service, token: &str, status: u16) {
    let begin = Instant::now();
    while list(service, token).await.status() != status {
        assert!(begin.elapsed() < PATIENCE, "{}", service.log());
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
}

#[tokio::test]
async fn keys_at_a_url_are_fetched_again_for_an_unknown_one_but_not_at_will() {
    let [old, new] = ["old", "new"].map(|id| Signer::new(id, Algorithm::ES256));
    let [by_old, by_new] = [&old, &new].map(|signer| signer.sign(&claims("anna", "read")));
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    let url = format!("http://{}/keys", listener.local_addr().unwrap());
    // The issuer is away: it takes connections and answers none.
    let data = Arc::new(tempfile::tempdir().unwrap());
    let key = made_key(data.path(), "pacs");
    let service = Service::start_on(data, &arguments(&url));
    assert_eq!(list(&service, &key).await.status(), 200, "keys work without the issuer");

    let keys = Keys::new(set(&[&old]));
    keys.serve(listener);
    until(&service, &by_old, 200).await;
    let before = keys.asked();
    let begin = Instant::now();
    for _ in 0..50 {
        assert_eq!(list(&service, &by_new).await.status(), 401);
    }
    // One for each five seconds that this took, and one of the service's own accord.
    let most = 2 + usize::try_from(begin.elapsed().as_secs() / 5).unwrap();
    assert!(keys.asked() - before <= most, "{} times in {:?}", keys.asked() - before, begin.elapsed());

    keys.put(StatusCode::OK, set(&[&new]));
    until(&service, &by_new, 200).await;
    assert_eq!(list(&service, &by_old).await.status(), 401);
}

#[tokio::test]
async fn clients_that_hang_up_make_the_service_ask_its_issuer_no_oftener() {
    let signer = Signer::new("one", Algorithm::ES256);
    // The first that asks, the service itself at its start, gets another key at once; those after it this one, so late that
    // no client waits for it.
    let asked = Arc::new(AtomicUsize::new(0));
    let (count, other) = (asked.clone(), set(&[&Signer::new("other", Algorithm::ES256)]));
    let wanted = set(&[&signer]);
    let keys = axum::routing::get(async move || {
        if count.fetch_add(1, Ordering::SeqCst) == 0 {
            return other;
        }
        tokio::time::sleep(Duration::from_millis(300)).await;
        wanted
    });
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    let url = format!("http://{}/keys", listener.local_addr().unwrap());
    tokio::spawn(async move { axum::serve(listener, axum::Router::new().route("/keys", keys)).await });
    let service = Service::start(&arguments(&url));
    while asked.load(Ordering::SeqCst) == 0 {
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    // Of a key that the issuer never gives: each of these would ask again if it could.
    let unknown = Signer::new("none", Algorithm::ES256).sign(&claims("anna", "read"));
    let begin = Instant::now();
    let hang_up = async || {
        let request = service.get("/v1/jobs").bearer_auth(&unknown).timeout(Duration::from_millis(50));
        request.send().await.is_err()
    };
    assert!(hang_up().await, "it waits for the issuer");
    // The client has gone; what it began brings the keys all the same, and nobody has to ask for them again.
    let token = signer.sign(&claims("anna", "read"));
    assert_eq!(list(&service, &token).await.status(), 200);
    assert_eq!(asked.load(Ordering::SeqCst), 2);
    while begin.elapsed() < Duration::from_secs(3) {
        hang_up().await;
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    // One for each five seconds that this took.
    let most = 2 + usize::try_from(begin.elapsed().as_secs() / 5).unwrap();
    let asked = asked.load(Ordering::SeqCst);
    assert!(asked <= most, "{asked} times in {:?}", begin.elapsed());
}

#[tokio::test]
async fn an_issuer_that_answers_otherwise_gives_no_keys_and_takes_none_away() {
    let [old, new] = ["old", "new"].map(|id| Signer::new(id, Algorithm::ES256));
    let [by_old, by_new] = [&old, &new].map(|signer| signer.sign(&claims("anna", "read")));
    let keys = Keys::new(set(&[&old]));
    let url = keys.serve(tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap());
    let service = Service::start(&arguments(&url));
    until(&service, &by_old, 200).await;
    // A redirect is not followed, and an error page is no key set.
    keys.put(StatusCode::FOUND, set(&[&new]));
    let before = keys.asked();
    let begin = Instant::now();
    while keys.asked() == before {
        assert!(begin.elapsed() < PATIENCE);
        assert_eq!(list(&service, &by_new).await.status(), 401);
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    assert_eq!(keys.asked(), before + 1, "nothing elsewhere");
    assert!(service.log().contains("it answered 302"), "{}", service.log());
    assert_eq!(list(&service, &by_old).await.status(), 200);
    for damaged in ["{", "{\"keys\": {}}", "{\"keys\": [null]}"] {
        keys.put(StatusCode::OK, damaged.to_owned());
        let before = keys.asked();
        while keys.asked() == before {
            assert!(begin.elapsed() < PATIENCE);
            assert_eq!(list(&service, &by_new).await.status(), 401);
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
        assert_eq!(list(&service, &by_old).await.status(), 200, "{damaged}");
    }
    assert!(service.log_with("entry 1 of its list").await.contains("the key set is damaged"));
    assert!(!service.log().contains("withdrawn"), "{}", service.log());
    // A set without a key is a good one: they are withdrawn.
    keys.put(StatusCode::OK, "{\"keys\": []}".to_owned());
    let begin = Instant::now();
    while list(&service, &by_new).await.status() == 401 && list(&service, &by_old).await.status() == 200 {
        assert!(begin.elapsed() < PATIENCE);
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    problem(list(&service, &by_old).await, 401, "unauthenticated").await;
    assert!(service.log_with("the issuer has withdrawn").await.contains("the issuer has withdrawn its keys"));
    keys.put(StatusCode::OK, set(&[&new]));
    until(&service, &by_new, 200).await;
}

#[test]
fn a_set_up_without_keys_is_refused_at_the_start() {
    let refused = |arguments: &[&str], word: &str| {
        let data = tempfile::tempdir().unwrap();
        let output = command(data.path()).args(arguments).output().unwrap();
        let line = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1), "{line}");
        assert!(line.contains(word), "{line}");
    };
    let file = KeyFile::new("{\"keys\": []}");
    refused(&arguments(file.path().to_str().unwrap()), "no public key");
    refused(&arguments("/nowhere/jwks.json"), "cannot be read");
    refused(&arguments("ftp://login.example/keys"), "no http or https URL");
    refused(&arguments("x")[..2], "--jwt-audience");
    refused(&arguments("x")[4..], "--jwt-issuer");
}

/// A job that runs for a while.
pub async fn slow_job(service: &Service, token: &str) -> String {
    let request = service.post("/v1/jobs?smoothing=true&preset=paper").bearer_auth(token);
    let response = request.body(meshes::stl(&meshes::tube(600, 120))).send().await.unwrap();
    response.headers()["location"].to_str().unwrap().to_owned()
}

#[tokio::test]
async fn a_stream_ends_soon_after_its_token() {
    let signer = Signer::new("one", Algorithm::ES256);
    let file = KeyFile::new(&set(&[&signer]));
    let service = file.start(&["--workers", "1"]);
    let token = signer.sign(&claims("anna", "submit read"));
    let job = slow_job(&service, &token).await;
    // In time for three seconds more, with the half minute that clocks may differ by.
    let short = signer.sign(&but(json!({"sub": "anna", "exp": at(-27)})));
    let begin = Instant::now();
    let response = service.get(&format!("{job}/events")).bearer_auth(&short).send().await.unwrap();
    assert_eq!(response.status(), 200);
    assert!(response.text().await.unwrap().contains("event: status"));
    assert!(begin.elapsed() < Duration::from_secs(15), "{:?}", begin.elapsed());
    assert_eq!(status(&service, &job, &token).await, 200);
    service.delete(&job).bearer_auth(&token).send().await.unwrap();
}
