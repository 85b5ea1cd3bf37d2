//! Clients that stand still are cut, and what they sent is gone.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use crate::meshes;
use crate::service::Service;

const LIMITS: [&str; 4] = ["--upload-idle", "1s", "--head-timeout", "1s"];

/// Sends `request`, then nothing; what the service answers until it closes the connection, and when it did.
fn stalled(service: &Service, request: &[u8]) -> (String, Duration) {
    let mut stream = TcpStream::connect(service.address()).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
    let begin = Instant::now();
    stream.write_all(request).unwrap();
    let mut answer = Vec::new();
    // Fails unless the service closes the connection.
    stream.read_to_end(&mut answer).unwrap();
    (String::from_utf8(answer).unwrap(), begin.elapsed())
}

fn assert_timed_out(answer: &str) {
    assert!(answer.starts_with("HTTP/1.1 408 "), "{answer}");
    assert!(
        answer.contains("application/problem+json") && answer.contains("urn:rosaline:problem:upload-timeout")
    );
}

#[tokio::test]
async fn a_body_that_stands_still_is_given_up() {
    let service = Service::start(&LIMITS);
    let mesh = meshes::small();
    let head = "POST /v1/jobs HTTP/1.1\r\nHost: x\r\nContent-Type: ";
    let raw = format!("{head}model/stl\r\nContent-Length: {}\r\n\r\n", mesh.len());
    let form = format!(
        "{head}multipart/form-data; boundary=b\r\nContent-Length: {}\r\n\r\n--b\r\nContent-Disposition: \
         form-data; name=\"mesh\"; filename=\"a.stl\"\r\n\r\n",
        mesh.len()
    );
    for begin in [raw, form] {
        for sent in [0, 100, mesh.len() / 2] {
            let (answer, took) = stalled(&service, &[begin.as_bytes(), &mesh[..sent]].concat());
            assert_timed_out(&answer);
            assert!(took >= Duration::from_secs(1) && took < Duration::from_secs(10), "{took:?}");
            service.assert_no_files().await;
        }
    }
    service.assert_alive().await;
    let job = service.accepted("", mesh).await;
    assert_eq!(service.ended(&job).await["status"], "successful");
}

#[tokio::test]
async fn a_byte_now_and_then_does_not_keep_an_upload_alive() {
    let service = Service::start(&LIMITS);
    let mut stream = TcpStream::connect(service.address()).unwrap();
    stream.set_read_timeout(Some(Duration::from_millis(200))).unwrap();
    let head =
        "POST /v1/jobs HTTP/1.1\r\nHost: x\r\nContent-Type: model/stl\r\nContent-Length: 100000\r\n\r\n";
    stream.write_all(head.as_bytes()).unwrap();
    let (begin, mut answer) = (Instant::now(), [0; 1024]);
    let length = loop {
        assert!(begin.elapsed() < Duration::from_secs(10), "the upload is not given up");
        stream.write_all(b"s").unwrap();
        if let Ok(length) = stream.read(&mut answer) {
            break length;
        }
    };
    assert_timed_out(&String::from_utf8_lossy(&answer[..length]));
    service.assert_no_files().await;
}

#[tokio::test]
async fn a_client_that_stalls_in_the_head_is_cut() {
    let service = Service::start(&LIMITS);
    let answered = "GET /healthz HTTP/1.1\r\nHost: x\r\n\r\n";
    let begun = "GET /healthz HTTP/1.1\r\nHost:";
    for request in ["", "G", begun, answered, &format!("{answered}{begun}")] {
        let (answer, took) = stalled(&service, request.as_bytes());
        assert_eq!(answer.contains("HTTP/1.1 200 "), request.starts_with(answered), "{request:?}: {answer}");
        assert!(
            took >= Duration::from_millis(900) && took < Duration::from_secs(10),
            "{request:?}: {took:?}"
        );
    }
    service.assert_alive().await;
}

#[tokio::test]
async fn a_client_that_waits_for_its_answer_is_not_cut() {
    let service = Service::start(&["--upload-idle", "1s", "--head-timeout", "1s", "--workers", "1"]);
    let jobs = service.backlog(8, &meshes::large()).await;
    let request = service.post("/v1/jobs").header("prefer", "wait=3").header("content-type", "model/stl");
    let begin = Instant::now();
    let response = request.body(meshes::small()).send().await.unwrap();
    assert_eq!(response.status(), 201);
    let status: serde_json::Value = response.json().await.unwrap();
    assert!(begin.elapsed() > Duration::from_secs(2) || status["status"] == "successful", "{status}");
    for job in jobs {
        service.delete(&job).send().await.unwrap();
    }
}

#[tokio::test]
async fn a_client_that_does_not_read_its_answers_is_cut() {
    const ASKED: usize = 400;
    let service = Service::start(&LIMITS);
    let document = service.get("/openapi.yaml").send().await.unwrap().text().await.unwrap();
    let ask = |count: usize| {
        let mut stream = TcpStream::connect(service.address()).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
        stream.write_all("GET /openapi.yaml HTTP/1.1\r\nHost: x\r\n\r\n".repeat(count).as_bytes()).unwrap();
        stream
    };
    let mut idle = ask(ASKED);
    std::thread::sleep(Duration::from_secs(4));
    let mut read = Vec::new();
    // Reset, or ended: more than the sockets hold was not sent.
    let _ = idle.read_to_end(&mut read);
    assert!(read.len() < ASKED * document.len() / 2, "{} bytes came", read.len());
    // One that reads gets all.
    let mut read = Vec::new();
    ask(20).read_to_end(&mut read).unwrap();
    assert!(read.len() > 20 * document.len());
}
