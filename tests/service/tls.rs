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
use crate::service::{PATIENCE, Service, command};

/// A certificate for 127.0.0.1 that signs itself, and its key.
pub struct Pair {
    certificate: rcgen::Certificate,
    key: rcgen::KeyPair,
}

impl Pair {
    pub fn new() -> Self {
        let made = rcgen::generate_simple_self_signed(vec!["127.0.0.1".to_owned()]).unwrap();
        Self { certificate: made.cert, key: made.signing_key }
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
fn trusting(pairs: &[&Pair]) -> Client {
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
async fn logged(service: &Service, text: &str, times: usize) {
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
    let plain = format!("http://{}/healthz", service.address());
    assert!(service.client.get(plain).send().await.is_err());

    service.client = trusting(&[&pair]);
    let job = service.accepted("", meshes::small()).await;
    assert_eq!(service.ended(&job).await["status"], "successful");
    let result = service.get(&format!("{job}/results/centerline.glb")).send().await.unwrap();
    assert!(result.bytes().await.unwrap().starts_with(b"glTF"));
    assert!(!service.log().contains("in the clear"), "{}", service.log());

    let health = |arguments: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_rosaline"));
        command.env_remove("ROSALINE_TLS_CERT").args(["health", "--listen", service.address()]);
        command.args(arguments).output().unwrap().status.success()
    };
    assert!(health(&["--tls-cert", text(&files.cert)]) && !health(&[]));
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
