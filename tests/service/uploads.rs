//! Uploads: their limit, and those that break off.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use bytes::Bytes;
use futures::{StreamExt, stream};
use reqwest::Body;
use reqwest::multipart::{Form, Part};

use crate::meshes;
use crate::service::{Service, problem};

const HEAD: &str = "POST /v1/jobs HTTP/1.1\r\nHost: x\r\nContent-Type: model/stl\r\n";

/// Sends text and reads the answer's status line.
fn status_line(service: &Service, request: &str) -> String {
    let mut stream = TcpStream::connect(service.address()).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
    stream.write_all(request.as_bytes()).unwrap();
    let mut answer = [0; 64];
    let length = stream.read(&mut answer).unwrap();
    String::from_utf8_lossy(&answer[..length]).lines().next().unwrap().to_owned()
}

#[tokio::test]
async fn a_gigabyte_declared_is_refused_before_it_is_sent() {
    let service = Service::start(&[]);
    let begin = Instant::now();
    for expect in ["", "Expect: 100-continue\r\n"] {
        let request = format!("{HEAD}{expect}Content-Length: {}\r\n\r\n", (1_u64 << 30) + 1);
        assert_eq!(status_line(&service, &request), "HTTP/1.1 413 Payload Too Large");
    }
    assert!(begin.elapsed() < Duration::from_secs(10));
    service.assert_alive().await;
}

#[tokio::test]
async fn a_picture_is_refused_from_its_first_bytes() {
    let service = Service::start(&[]);
    let png: Vec<u8> =
        b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR".iter().copied().chain(std::iter::repeat_n(7, 40 << 20)).collect();
    // Most of the body never comes, and the answer does.
    let mut stream = TcpStream::connect(service.address()).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
    stream.write_all(format!("{HEAD}Content-Length: {}\r\n\r\n", 1 << 30).as_bytes()).unwrap();
    stream.write_all(&png[..4096]).unwrap();
    let mut answer = [0; 32];
    stream.read_exact(&mut answer).unwrap();
    assert!(answer.starts_with(b"HTTP/1.1 415 "), "{}", String::from_utf8_lossy(&answer));
    service.assert_no_files().await;
    // A client that sends on sees the answer too, and not a reset connection.
    for _ in 0..5 {
        let response = service.submit("", png.clone()).await;
        problem(response, 415, "unsupported-format").await;
        let form = Form::new().part("mesh", Part::bytes(png.clone()));
        let response = service.post("/v1/jobs").multipart(form).send().await.unwrap();
        problem(response, 415, "unsupported-format").await;
    }
    service.assert_no_files().await;
    // What comes byte by byte is known as well.
    let slow =
        stream::iter(png[..2000].to_vec()).map(|byte| Ok::<_, std::io::Error>(Bytes::from(vec![byte])));
    problem(service.submit("", Body::wrap_stream(slow)).await, 415, "unsupported-format").await;
    service.assert_alive().await;
}

/// Every upload is read whole to be checked, a few at a time: many take no more memory than a few.
#[cfg(target_os = "linux")]
#[tokio::test]
async fn uploads_that_come_together_are_checked_one_after_the_other() {
    let mut mesh = meshes::stl(&meshes::tube(400, 500));
    // Found at the end, so that no job follows, whose memory would count too.
    let last = mesh.len() - 10;
    mesh[last..last + 4].copy_from_slice(&f32::NAN.to_le_bytes());
    let mesh = Bytes::from(mesh);
    let mut peaks = Vec::new();
    for clients in [1, 12] {
        let service = Service::start(&["--validations", "1"]);
        let posts = (0..clients).map(|_| service.submit("", mesh.clone()));
        for response in futures::future::join_all(posts).await {
            problem(response, 422, "non-finite-coordinate").await;
        }
        peaks.push(service.peak_memory());
    }
    println!("{} MiB a mesh; peak with 1 and with 12 clients: {peaks:?} MiB", mesh.len() >> 20);
    let (one, twelve) = (peaks[0], peaks[1]);
    // All at once would be eleven files and meshes more; what else grows is a client's buffers, some MiB each.
    assert!(twelve < 3 * one, "{peaks:?}");
}

/// A body that does not say how long it is.
fn chunked(mebibytes: usize) -> Body {
    let chunk = Bytes::from(vec![0_u8; 1 << 20]);
    Body::wrap_stream(stream::iter((0..mebibytes).map(move |_| Ok::<_, std::io::Error>(chunk.clone()))))
}

#[tokio::test]
async fn an_upload_past_the_limit_is_refused_and_the_client_sees_it() {
    let service = Service::start(&["--max-upload", "1MiB"]);
    for _ in 0..3 {
        for body in [chunked(20), Body::from(vec![0; 20 << 20]), Body::from(vec![0; (1 << 20) + 1])] {
            let problem = problem(service.submit("", body).await, 413, "upload-too-large").await;
            assert_eq!(problem["limit"], 1 << 20);
        }
        let form = Form::new().part("mesh", Part::bytes(vec![0; 20 << 20]));
        let response = service.post("/v1/jobs").multipart(form).send().await.unwrap();
        problem(response, 413, "upload-too-large").await;
        let form = Form::new().part("mesh", Part::stream(chunked(20)));
        let response = service.post("/v1/jobs").multipart(form).send().await.unwrap();
        problem(response, 413, "upload-too-large").await;
    }
    service.assert_no_files().await;
    let job = service.accepted("", meshes::small()).await;
    assert_eq!(service.ended(&job).await["status"], "successful");
}

#[tokio::test]
async fn an_upload_that_breaks_off_leaves_no_job_and_no_file() {
    let service = Service::start(&[]);
    let mesh = meshes::small();
    for framing in [format!("Content-Length: {}", mesh.len()), "Transfer-Encoding: chunked".to_owned()] {
        let mut stream = TcpStream::connect(service.address()).unwrap();
        stream.write_all(format!("{HEAD}{framing}\r\n\r\n").as_bytes()).unwrap();
        if framing.starts_with('T') {
            stream.write_all(format!("{:x}\r\n", mesh.len()).as_bytes()).unwrap();
        }
        stream.write_all(&mesh[..mesh.len() / 2]).unwrap();
        std::thread::sleep(Duration::from_millis(200));
        drop(stream);
    }
    tokio::time::sleep(Duration::from_millis(300)).await;
    service.assert_no_files().await;
    let list: serde_json::Value = service.get("/v1/jobs").send().await.unwrap().json().await.unwrap();
    assert_eq!(list["jobs"], serde_json::json!([]));
    service.assert_alive().await;
}

#[tokio::test]
async fn nonsense_on_the_socket_does_no_harm() {
    let service = Service::start(&[]);
    for request in [
        "\x16\x03\x01\x02\0\x01\0",
        "GET\r\n\r\n",
        "POST /v1/jobs HTTP/1.1\r\nHost: x\r\nContent-Length: -1\r\n\r\n",
        "POST /v1/jobs HTTP/1.1\r\nHost: x\r\nTransfer-Encoding: chunked\r\n\r\nzz\r\n",
    ] {
        let mut stream = TcpStream::connect(service.address()).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
        stream.write_all(request.as_bytes()).unwrap();
        let mut answer = [0; 12];
        // Either an error or the end of the connection.
        if stream.read(&mut answer).is_ok_and(|length| length == answer.len()) {
            assert_eq!(&answer, b"HTTP/1.1 400", "{request}");
        }
    }
    service.assert_alive().await;
}

/// What is no part's data stays in the memory of the forms' reader until a boundary or a head is whole.
#[tokio::test(flavor = "multi_thread")]
async fn a_form_of_endless_heads_is_refused_before_memory_is_taken_for_it() {
    let service = Service::start(&[]);
    let before = service.peak_memory();
    let part = "--b\r\nContent-Disposition: form-data; name=\"mesh\"";
    for begin in ["no boundary", &format!("{part}\r\nX: "), &part[..part.len() - 1]] {
        let chunks = std::iter::once(Bytes::copy_from_slice(begin.as_bytes()))
            .chain(std::iter::repeat_n(Bytes::from(vec![b'x'; 1 << 20]), 40));
        let body = Body::wrap_stream(stream::iter(chunks.map(Ok::<_, std::io::Error>)));
        let request = service.post("/v1/jobs").header("content-type", "multipart/form-data; boundary=b");
        let problem = problem(request.body(body).send().await.unwrap(), 400, "malformed-request").await;
        assert!(problem["detail"].as_str().unwrap().contains("beside the data of its parts"), "{problem}");
    }
    let grown = service.peak_memory() - before;
    assert!(grown < 20, "{grown} MiB");
    service.assert_no_files().await;
    // However its bytes come in, a form that has its mesh behind its parameters is taken.
    let mesh = meshes::stl(&meshes::tube(400, 40));
    for size in [997, 70_000, 1 << 20] {
        let chunks: Vec<_> = mesh.chunks(size).map(|chunk| Ok::<_, std::io::Error>(chunk.to_vec())).collect();
        let form = Form::new()
            .text("parameters", "{}")
            .part("mesh", Part::stream(Body::wrap_stream(stream::iter(chunks))));
        let response = service.post("/v1/jobs").multipart(form).send().await.unwrap();
        assert_eq!(response.status(), 201, "{}", response.text().await.unwrap());
    }
}
