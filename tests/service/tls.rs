//! TLS: requests, slow clients, and certificates that change.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use std::time::{Duration, Instant};

use reqwest::Client;
use reqwest::tls::TlsInfo;
use tempfile::TempDir;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio_rustls::TlsConnector;
use tokio_rustls::rustls::crypto::aws_lc_rs;
use tokio_rustls::rustls::pki_types::{CertificateDer, ServerName};
use tokio_rustls::rustls::{ClientConfig, RootCertStore};

use crate::meshes;
use crate::service::{PATIENCE, Service, command, without_settings};

/// A certificate for 127.0.0.1 that signs itself, and its key.
pub struct Pair {
    certificate: rcgen::Certificate,
    key: rcgen::KeyPair,
}

impl Pair {
    pub fn new() -> Self {
        Self::that_expires(365)
    }

    /// In so many days from now, and an hour.
    pub fn that_expires(days: i64) -> Self {
        let mut parameters = rcgen::CertificateParams::new(vec!["127.0.0.1".to_owned()]).unwrap();
        parameters.not_before = time::OffsetDateTime::now_utc() - time::Duration::days(1000);
        parameters.not_after =
            time::OffsetDateTime::now_utc() + time::Duration::days(days) + time::Duration::HOUR;
        let key = rcgen::KeyPair::generate().unwrap();
        Self { certificate: parameters.self_signed(&key).unwrap(), key }
    }

    fn der(&self) -> CertificateDer<'static> {
        self.certificate.der().clone()
    }
}

/// The files that the service was told of.
pub struct Files {
    pub cert: PathBuf,
    key: PathBuf,
    dir: TempDir,
}

impl Files {
    pub fn new(pair: &Pair) -> Self {
        let dir = tempfile::tempdir().unwrap();
        let files = Self { cert: dir.path().join("cert.pem"), key: dir.path().join("key.pem"), dir };
        files.put(&pair.certificate.pem(), &pair.key.serialize_pem());
        files
    }

    /// Replaces both, each whole.
    fn put(&self, cert: &str, key: &str) {
        for (path, text) in [(&self.cert, cert), (&self.key, key)] {
            let new = self.dir.path().join("new");
            std::fs::write(&new, text).unwrap();
            std::fs::rename(new, path).unwrap();
        }
    }

    pub fn start(&self, arguments: &[&str]) -> Service {
        let mut all = vec!["--tls-cert", text(&self.cert), "--tls-key", text(&self.key)];
        all.extend(arguments);
        Service::start(&all)
    }
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// A client that trusts these and nobody else.
pub fn trusting(pairs: &[&Pair]) -> Client {
    let roots = pairs.iter().map(|pair| reqwest::Certificate::from_der(&pair.der()).unwrap());
    // A connection for each request: what is told of the certificate is of now.
    Client::builder().tls_certs_only(roots).tls_info(true).pool_max_idle_per_host(0).build().unwrap()
}

/// The certificate that a new connection gets.
async fn shown(service: &Service, client: &Client) -> Vec<u8> {
    let response = client.get(format!("{}/healthz", service.url)).send().await.unwrap();
    assert_eq!(response.status(), 200);
    response.extensions().get::<TlsInfo>().unwrap().peer_certificate().unwrap().to_vec()
}

/// What a log line says is waited for, at most for as long as anything is.
pub async fn logged(service: &Service, text: &str, times: usize) {
    let begin = Instant::now();
    while service.log().matches(text).count() < times {
        assert!(begin.elapsed() < PATIENCE, "{text}: {}", service.log());
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
}

#[tokio::test]
async fn a_job_goes_over_tls_and_nothing_goes_beside_it() {
    let pair = Pair::new();
    let files = Files::new(&pair);
    let mut service = files.start(&[]);
    assert!(service.url.starts_with("https://127.0.0.1:"), "{}", service.url);
    let stranger = service.get("/healthz").send().await;
    assert!(stranger.is_err(), "a client that does not know the certificate goes no further");
    service.client = trusting(&[&pair]);
    let job = service.accepted("", meshes::small()).await;
    assert_eq!(service.ended(&job).await["status"], "successful");
    let result = service.get(&format!("{job}/results/centerline.glb")).send().await.unwrap();
    assert!(result.bytes().await.unwrap().starts_with(b"glTF"));
    assert!(!service.log().contains("in the clear"), "{}", service.log());

    let health = |arguments: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_rosaline"));
        without_settings(&mut command);
        command.args(["health", "--listen", service.address()]);
        command.args(arguments).output().unwrap().status.success()
    };
    assert!(health(&["--tls-cert", text(&files.cert)]) && !health(&[]));
    let config = files.cert.with_extension("toml");
    std::fs::write(&config, format!("tls-cert = {0:?}\ntls-key = {0:?}\n", text(&files.cert))).unwrap();
    assert!(health(&["--config", text(&config)]));
}

#[tokio::test]
async fn a_client_that_speaks_plain_http_is_told_to_use_https() {
    let pair = Pair::new();
    let mut service = Files::new(&pair).start(&[]);
    let told = "this port speaks TLS: use https:// in the URL\n";
    let plain = service.url.replace("https://", "http://");
    let answer = service.client.get(format!("{plain}/healthz")).send().await.unwrap();
    assert_eq!(
        (answer.status().as_u16(), &answer.headers()["content-type"]),
        (400, &"text/plain; charset=utf-8".parse().unwrap())
    );
    assert_eq!(answer.text().await.unwrap(), told);
    // Also one that sends a mesh, and reads no answer before it has.
    let mut socket = TcpStream::connect(service.address()).await.unwrap();
    let head =
        "POST /v1/jobs HTTP/1.1\r\nHost: x\r\nContent-Type: model/stl\r\nContent-Length: 500000\r\n\r\n";
    socket.write_all(&[head.as_bytes(), &[b'x'; 500_000]].concat()).await.unwrap();
    let mut answer = String::new();
    socket.read_to_string(&mut answer).await.unwrap();
    assert!(answer.starts_with("HTTP/1.1 400 ") && answer.ends_with(told), "{answer}");
    service.client = trusting(&[&pair]);
    service.assert_alive().await;
    assert_eq!(service.files().len(), 0);
}

#[tokio::test]
async fn a_certificate_that_is_about_to_expire_is_warned_of() {
    let pairs = [365, 12, -2].map(Pair::that_expires);
    let files = Files::new(&pairs[0]);
    let mut service = files.start(&[]);
    // The expired one is no longer accepted by a client: its warnings are those of the log.
    service.client = trusting(&pairs.iter().collect::<Vec<_>>());
    let seen = async || {
        let ready: serde_json::Value = service.get("/readyz").send().await.unwrap().json().await.unwrap();
        let text = service.get("/metrics").send().await.unwrap().text().await.unwrap();
        let line = text
            .lines()
            .find_map(|line| line.strip_prefix("rosaline_tls_certificate_expiry_timestamp_seconds "));
        let now = time::OffsetDateTime::now_utc().unix_timestamp();
        (ready["warnings"].clone(), (line.unwrap().parse::<i64>().unwrap() - now) / 86_400)
    };
    assert_eq!(seen().await, (serde_json::Value::Null, 365));
    assert!(!service.log().contains("expire"), "{}", service.log());
    files.put(&pairs[1].certificate.pem(), &pairs[1].key.serialize_pem());
    logged(&service, "the TLS certificate expires on", 1).await;
    let (warnings, days) = seen().await;
    assert!(warnings[0].as_str().unwrap().contains("in 12 days"), "{warnings}");
    assert_eq!(days, 12);
    files.put(&pairs[2].certificate.pem(), &pairs[2].key.serialize_pem());
    logged(&service, "the TLS certificate has expired on", 1).await;
}

#[tokio::test]
async fn a_changed_certificate_is_taken_over_and_a_broken_one_is_not() {
    let [first, second, third] = [Pair::new(), Pair::new(), Pair::new()];
    let files = Files::new(&first);
    let service = files.start(&[]);
    let client = trusting(&[&first, &second, &third]);
    assert_eq!(shown(&service, &client).await, first.der().to_vec());
    // One that is open goes on.
    let mut open = talk(&service, &[&first]).await;

    files.put(&second.certificate.pem(), &second.key.serialize_pem());
    logged(&service, "the TLS certificate has changed", 1).await;
    assert_eq!(shown(&service, &client).await, second.der().to_vec());
    assert!(trusting(&[&first]).get(format!("{}/healthz", service.url)).send().await.is_err());

    let broken = [
        ("no certificate".to_owned(), second.key.serialize_pem()),
        (third.certificate.pem(), second.key.serialize_pem()),
        (third.certificate.pem(), String::new()),
    ];
    for (place, (cert, key)) in broken.iter().enumerate() {
        files.put(cert, key);
        logged(&service, "the TLS certificate stays the one before", place + 1).await;
        assert_eq!(shown(&service, &client).await, second.der().to_vec());
    }
    std::fs::remove_file(&files.key).unwrap();
    logged(&service, "cannot be read", 1).await;
    assert_eq!(shown(&service, &client).await, second.der().to_vec());

    files.put(&third.certificate.pem(), &third.key.serialize_pem());
    logged(&service, "the TLS certificate has changed", 2).await;
    assert_eq!(shown(&service, &client).await, third.der().to_vec());
    open.write_all(b"GET /healthz HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n").await.unwrap();
    let mut answer = String::new();
    open.read_to_string(&mut answer).await.unwrap();
    assert!(answer.starts_with("HTTP/1.1 200 "), "{answer}");
    for line in service.log().lines().filter(|line| line.contains("TLS certificate")) {
        assert!(!line.contains("PRIVATE"), "{line}");
    }
}

/// A reader would wait at it for ever: for the next certificate, and when the service is to end.
#[tokio::test]
async fn a_pipe_in_place_of_the_certificate_is_refused_as_any_broken_one() {
    let [first, second] = [Pair::new(), Pair::new()];
    let files = Files::new(&first);
    let mut service = files.start(&[]);
    let client = trusting(&[&first, &second]);
    std::fs::remove_file(&files.cert).unwrap();
    assert!(Command::new("mkfifo").arg(&files.cert).status().unwrap().success());
    logged(&service, "it is no regular file", 1).await;
    assert_eq!(shown(&service, &client).await, first.der().to_vec());
    files.put(&second.certificate.pem(), &second.key.serialize_pem());
    logged(&service, "the TLS certificate has changed", 1).await;
    assert_eq!(shown(&service, &client).await, second.der().to_vec());
    service.terminate();
    assert!(service.wait().success());
}

/// A connection whose handshake is done.
async fn talk(service: &Service, pairs: &[&Pair]) -> tokio_rustls::client::TlsStream<TcpStream> {
    let mut roots = RootCertStore::empty();
    for pair in pairs {
        roots.add(pair.der()).unwrap();
    }
    let config = ClientConfig::builder_with_provider(Arc::new(aws_lc_rs::default_provider()))
        .with_safe_default_protocol_versions()
        .unwrap()
        .with_root_certificates(roots)
        .with_no_client_auth();
    let socket = TcpStream::connect(service.address()).await.unwrap();
    let name = ServerName::try_from("127.0.0.1").unwrap();
    TlsConnector::from(Arc::new(config)).connect(name, socket).await.unwrap()
}

/// What comes until the service closes the connection, and how long that takes.
async fn until_cut(mut stream: impl AsyncReadExt + Unpin, begin: Instant) -> String {
    let mut answer = Vec::new();
    // A connection that is cut may lack TLS's goodbye: what came before counts.
    let _ = tokio::time::timeout(PATIENCE, stream.read_to_end(&mut answer)).await.unwrap();
    let took = begin.elapsed();
    assert!(took >= Duration::from_millis(900) && took < Duration::from_secs(20), "{took:?}");
    String::from_utf8_lossy(&answer).into_owned()
}

#[tokio::test]
async fn clients_that_stand_still_are_cut_in_the_handshake_and_after_it() {
    let pair = Pair::new();
    let files = Files::new(&pair);
    let mut service = files.start(&["--upload-idle", "1s", "--head-timeout", "1s"]);
    service.client = trusting(&[&pair]);
    // Nothing, and the begin of a ClientHello.
    for sent in [&[][..], &[0x16], &[0x16, 0x03, 0x01, 0x02, 0x00, 0x01]] {
        let begin = Instant::now();
        let mut socket = TcpStream::connect(service.address()).await.unwrap();
        socket.write_all(sent).await.unwrap();
        until_cut(socket, begin).await;
    }
    for head in ["", "GET /healthz HTTP/1.1\r\nHost:"] {
        let begin = Instant::now();
        let mut stream = talk(&service, &[&pair]).await;
        stream.write_all(head.as_bytes()).await.unwrap();
        stream.flush().await.unwrap();
        assert!(!until_cut(stream, begin).await.contains("200"));
    }
    let begin = Instant::now();
    let mut stream = talk(&service, &[&pair]).await;
    let head =
        "POST /v1/jobs HTTP/1.1\r\nHost: x\r\nContent-Type: model/stl\r\nContent-Length: 100000\r\n\r\nsolid";
    stream.write_all(head.as_bytes()).await.unwrap();
    stream.flush().await.unwrap();
    let answer = until_cut(stream, begin).await;
    assert!(answer.starts_with("HTTP/1.1 408 ") && answer.contains("upload-timeout"), "{answer}");
    service.assert_no_files().await;
    service.assert_alive().await;
}

#[test]
fn a_certificate_that_cannot_be_used_is_refused_at_the_start() {
    let (pair, other) = (Pair::new(), Pair::new());
    let files = Files::new(&pair);
    let missing = files.dir.path().join("missing.pem");
    let refused = |arguments: &[&str], words: &[&str]| {
        let data = tempfile::tempdir().unwrap();
        let output = command(data.path()).args(arguments).output().unwrap();
        let line = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1), "{line}");
        assert!(words.iter().all(|word| line.contains(word)), "{line}");
    };
    let both = ["--tls-cert", text(&files.cert), "--tls-key", text(&files.key)];
    refused(&both[..2], &["--tls-key"]);
    refused(
        &["--tls-cert", text(&missing), "--tls-key", text(&files.key)],
        &["missing.pem", "cannot be read"],
    );
    refused(&["--tls-cert", text(&files.key), "--tls-key", text(&files.key)], &["no certificate"]);
    refused(&["--tls-cert", text(&files.cert), "--tls-key", text(&files.cert)], &["no private key"]);
    files.put(&pair.certificate.pem(), &other.key.serialize_pem());
    refused(&both, &["cannot be used together", "cert.pem", "key.pem"]);
}

#[tokio::test]
async fn an_address_that_others_reach_is_warned_of_without_tls() {
    let open = ["--listen", "0.0.0.0:0", "--insecure"];
    let service = Service::start(&open);
    logged(&service, "in the clear", 1).await;
    let files = Files::new(&Pair::new());
    let service = files.start(&open);
    logged(&service, "ready", 1).await;
    assert!(!service.log().contains("in the clear"), "{}", service.log());
}

#[tokio::test]
async fn a_health_check_without_the_certificate_says_what_is_missing() {
    let files = Files::new(&Pair::new());
    let service = files.start(&[]);
    let health = |more: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_rosaline"));
        without_settings(&mut command);
        command.args(["health", "--listen", service.address()]).args(more).output().unwrap()
    };
    assert!(health(&["--tls-cert", text(&files.cert)]).status.success());
    for more in [&[][..], &["--alive"]] {
        let output = health(more);
        let line = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1), "{line}");
        assert!(line.contains("speaks TLS") && line.contains("--tls-cert"), "{line}");
    }
}
