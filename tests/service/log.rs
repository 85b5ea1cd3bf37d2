//! A log that cannot be written, or that nobody reads: it loses lines, and the service goes on.

use std::fs::OpenOptions;
use std::io::{PipeReader, Read, Write, pipe};
use std::process::Stdio;
use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::meshes;
use crate::service::{PATIENCE, Service, command};

/// A service whose log goes there.
fn start(log: impl Into<Stdio>, level: &str) -> Service {
    let data = Arc::new(tempfile::tempdir().unwrap());
    let mut command = command(data.path());
    command.args(["--workers", "1"]).env("ROSALINE_LOG", level).stderr(log);
    Service::try_start(&mut command, data).unwrap()
}

async fn lost(service: &Service) -> u64 {
    let text = service.get("/metrics").send().await.unwrap().text().await.unwrap();
    let line = text.lines().find_map(|line| line.strip_prefix("rosaline_log_lines_lost_total "));
    line.unwrap().parse().unwrap()
}

/// Reads the pipe to its end.
fn read(mut pipe: PipeReader) -> std::thread::JoinHandle<String> {
    std::thread::spawn(move || {
        let mut text = String::new();
        pipe.read_to_string(&mut text).unwrap();
        text
    })
}

#[tokio::test]
async fn a_log_that_cannot_be_written_costs_lines_and_not_the_service() {
    let full = OpenOptions::new().write(true).open("/dev/full").unwrap();
    let mut service = start(full, "debug");
    let job = service.accepted("", meshes::small()).await;
    assert_eq!(service.ended(&job).await["status"], "successful");
    assert!(lost(&service).await > 0);
    service.terminate();
    assert!(service.wait().success());
}

#[tokio::test]
async fn a_reader_of_the_log_may_go_away_while_a_job_runs() {
    let (reader, writer) = pipe().unwrap();
    let mut service = start(writer, "debug");
    let job = service.backlog(1, &meshes::large()).await.remove(0);
    service.running().await;
    drop(reader);
    assert_eq!(service.ended(&job).await["status"], "successful");
    assert!(lost(&service).await > 0);
    service.terminate();
    assert!(service.wait().success());
}

/// Asks until the log's pipe and its queue are full, and lines are lost.
async fn fill(service: &Service) -> u64 {
    let begin = Instant::now();
    loop {
        for _ in 0..100 {
            let asked = tokio::time::timeout(Duration::from_secs(20), service.get("/healthz").send());
            // Nobody waits for the log.
            assert_eq!(asked.await.unwrap().unwrap().status(), 200);
        }
        match lost(service).await {
            0 => assert!(begin.elapsed() < PATIENCE, "no line is lost"),
            count => return count,
        }
    }
}

#[tokio::test]
async fn a_log_that_nobody_reads_holds_nothing_up_and_tells_what_was_lost() {
    let (reader, writer) = pipe().unwrap();
    let mut service = start(writer, "trace");
    let count = fill(&service).await;
    let text = read(reader);
    let begin = Instant::now();
    // Until a line finds room again.
    while lost(&service).await > count && begin.elapsed() < Duration::from_secs(2) {
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    service.assert_alive().await;
    service.terminate();
    assert!(service.wait().success());
    let text = text.join().unwrap();
    let told = text.lines().find(|line| line.contains("lines of the log were lost")).unwrap();
    let told: u64 = told.rsplit_once("lost=").unwrap().1.trim().parse().unwrap();
    assert!(told >= count, "{told} of {count}");
    assert!(text.trim_end().ends_with("stopped"), "the last lines come before the end");
}

#[tokio::test]
async fn a_log_that_nobody_reads_does_not_keep_the_service_from_its_end() {
    let (_reader, writer) = pipe().unwrap();
    let mut service = start(writer, "trace");
    fill(&service).await;
    let begin = Instant::now();
    service.terminate();
    assert!(service.wait().success());
    assert!(begin.elapsed() < Duration::from_secs(20), "{:?}", begin.elapsed());
}

/// Nor does one that ends at its start wait for it, or without its reason where somebody reads.
#[test]
fn a_start_that_fails_ends_also_when_nobody_reads_why() {
    let data = tempfile::tempdir().unwrap();
    let fails = |log: Stdio| {
        let mut child = command(data.path()).args(["--listen", "nowhere"]).stderr(log).spawn().unwrap();
        let begin = Instant::now();
        loop {
            if let Some(status) = child.try_wait().unwrap() {
                return status.code();
            }
            if begin.elapsed() > Duration::from_secs(20) {
                child.kill().unwrap();
                panic!("it waits for its reader");
            }
            std::thread::sleep(Duration::from_millis(20));
        }
    };
    let (_stalled, mut writer) = pipe().unwrap();
    // What a pipe holds.
    writer.write_all(&[b'\n'; 64 << 10]).unwrap();
    assert_eq!(fails(writer.into()), Some(1));
    assert_eq!(fails(OpenOptions::new().write(true).open("/dev/full").unwrap().into()), Some(1));
    let (reader, writer) = pipe().unwrap();
    assert_eq!(fails(writer.into()), Some(1));
    assert!(read(reader).join().unwrap().contains("cannot listen on 'nowhere'"));
}
