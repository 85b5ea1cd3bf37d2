//! Traces over a socket, to a small collector that decodes them.

use std::collections::BTreeSet;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use opentelemetry_proto::tonic::collector::trace::v1::ExportTraceServiceRequest;
use opentelemetry_proto::tonic::common::v1::any_value::Value;
use opentelemetry_proto::tonic::trace::v1::Span;
use prost::Message;

use super::meshes;
use super::service::Service;

const TRACE: &str = "4bf92f3577b34da6a3ce929d0e0e4736";
const PARENT: &str = "00f067aa0ba902b7";

/// Takes spans by OTLP over HTTP.
struct Collector {
    url: String,
    spans: Arc<Mutex<Vec<Span>>>,
}

impl Collector {
    fn start() -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let url = format!("http://{}", listener.local_addr().unwrap());
        let spans = Arc::new(Mutex::new(Vec::new()));
        let kept = spans.clone();
        std::thread::spawn(move || {
            for stream in listener.incoming() {
                let kept = kept.clone();
                std::thread::spawn(move || while receive(stream.as_ref().unwrap(), &kept).is_some() {});
            }
        });
        Self { url, spans }
    }

    fn spans(&self) -> Vec<Span> {
        self.spans.lock().unwrap().clone()
    }
}

/// One request of a connection.
fn receive(stream: &TcpStream, spans: &Mutex<Vec<Span>>) -> Option<()> {
    let mut reader = BufReader::new(stream);
    let (mut first, mut length) = (String::new(), 0);
    reader.read_line(&mut first).ok().filter(|read| *read > 0)?;
    assert!(first.starts_with("POST /v1/traces "), "{first}");
    loop {
        let mut line = String::new();
        reader.read_line(&mut line).ok()?;
        let line = line.trim_end().to_ascii_lowercase();
        match line.split_once(": ") {
            Some(("content-length", value)) => length = value.parse().unwrap(),
            Some(("content-type", value)) => assert_eq!(value, "application/x-protobuf"),
            Some(_) => {}
            None => break,
        }
    }
    let mut body = vec![0; length];
    reader.read_exact(&mut body).ok()?;
    let request = ExportTraceServiceRequest::decode(&body[..]).unwrap();
    let scopes = request.resource_spans.into_iter().flat_map(|resource| resource.scope_spans);
    spans.lock().unwrap().extend(scopes.flat_map(|scope| scope.spans));
    let mut stream = stream;
    stream
        .write_all(b"HTTP/1.1 200 OK\r\ncontent-type: application/x-protobuf\r\ncontent-length: 0\r\n\r\n")
        .ok()
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn of<'a>(spans: &'a [Span], name: &str) -> &'a Span {
    let mut found = spans.iter().filter(|span| span.name == name);
    let span = found.next().unwrap_or_else(|| panic!("no span {name} in {:?}", names(spans)));
    assert!(found.next().is_none(), "two spans {name}");
    span
}

fn names(spans: &[Span]) -> Vec<&str> {
    spans.iter().map(|span| span.name.as_str()).collect()
}

/// Every text that a span carries.
fn texts(span: &Span) -> Vec<String> {
    let values =
        span.attributes.iter().filter_map(|attribute| match attribute.value.as_ref()?.value.as_ref()? {
            Value::StringValue(text) => Some(text.clone()),
            _ => None,
        });
    values.chain([span.name.clone(), span.trace_state.clone()]).collect()
}

async fn submit(service: &Service, traceparent: &str) -> String {
    let request = service.post("/v1/jobs?name=doe_jane.stl&client_reference=doe-1970");
    let request =
        request.header("content-type", "application/octet-stream").header("traceparent", traceparent);
    let response = request.body(meshes::small()).send().await.unwrap();
    response.headers()["location"].to_str().unwrap().to_owned()
}

#[tokio::test]
async fn one_trace_leads_from_the_upload_to_the_result_also_across_a_restart() {
    let collector = Collector::start();
    let arguments = ["--workers", "1", "--threads", "1", "--grace", "0", "--otlp", &collector.url];
    let mut service = Service::start(&arguments);
    // The job waits behind another one when the service stops.
    let ahead = service.backlog(1, &meshes::large()).await;
    let job = submit(&service, &format!("00-{TRACE}-{PARENT}-01")).await;
    assert_eq!(service.status(&job).await["status"], "accepted");
    service.terminate();
    service.wait();
    let mut service = service.restart(&arguments);
    service.delete(&ahead[0]).send().await.unwrap();
    assert_eq!(service.ended(&job).await["status"], "successful");
    service.terminate();
    service.wait();

    let all = collector.spans();
    assert!(all.iter().flat_map(texts).all(|text| !text.contains("doe")), "patient data in spans");
    let trace: Vec<Span> = all.iter().filter(|span| hex(&span.trace_id) == TRACE).cloned().collect();
    let request = of(&trace, "POST /v1/jobs");
    assert_eq!(hex(&request.parent_span_id), PARENT);
    for part in ["receive", "check", "commit", "wait", "run"] {
        assert_eq!(of(&trace, part).parent_span_id, request.span_id, "{part}");
    }
    let run = of(&trace, "run");
    let stages: BTreeSet<&str> = trace
        .iter()
        .filter(|span| span.parent_span_id == run.span_id)
        .map(|span| span.name.as_str())
        .collect();
    for stage in ["reading", "preparation", "tips", "recentering", "connection", "writing"] {
        assert!(stages.contains(stage), "{stage} is not in {stages:?}");
    }
    assert_eq!(trace.len(), 6 + stages.len(), "{:?}", names(&trace));
    let id = job.rsplit('/').next().unwrap();
    assert!(texts(run).contains(&"successful".to_owned()) && texts(run).contains(&id.to_owned()));
    let wait = of(&trace, "wait");
    assert!(wait.start_time_unix_nano >= request.start_time_unix_nano, "it waits from its acceptance");
    assert!(wait.end_time_unix_nano <= run.end_time_unix_nano);
}

#[tokio::test]
async fn a_collector_that_is_down_or_stands_still_disturbs_nobody() {
    let silent = TcpListener::bind("127.0.0.1:0").unwrap();
    for collector in ["http://127.0.0.1:9".to_owned(), format!("http://{}", silent.local_addr().unwrap())] {
        let mut service = Service::start(&["--otlp", &collector]);
        let job = submit(&service, "nonsense").await;
        assert_eq!(service.ended(&job).await["status"], "successful");
        service.assert_alive().await;
        service.terminate();
        assert!(
            tokio::time::timeout(Duration::from_secs(60), async { service.wait().success() }).await.unwrap()
        );
    }
}

#[tokio::test]
async fn an_address_that_is_no_url_is_refused_at_the_start() {
    let data = tempfile::tempdir().unwrap();
    let output = super::service::command(data.path()).args(["--otlp", "::collector"]).output().unwrap();
    let error = String::from_utf8(output.stderr).unwrap();
    assert!(!output.status.success() && error.contains("'::collector' for '--otlp <URL>'"), "{error}");
}
