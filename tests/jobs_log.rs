//! What the queue's log says, at its most talkative: job ids, never a mesh's name or content.
#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

#[allow(dead_code)] // Each test file uses its own part.
mod jobs_fakes;

use std::io;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use bytes::Bytes;
use futures::stream;
use jobs_fakes::{Script, ended, settings};
use rosaline::jobs::{FileName, JobService, JobSpec, log_panics_without_text};
use tracing_subscriber::fmt::MakeWriter;

#[derive(Clone, Default)]
struct Log(Arc<Mutex<Vec<u8>>>);

impl io::Write for Log {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.lock().unwrap().extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl<'a> MakeWriter<'a> for Log {
    type Writer = Log;

    fn make_writer(&'a self) -> Log {
        self.clone()
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn the_log_names_jobs_and_neither_files_nor_their_content() {
    let (log, dir) = (Log::default(), tempfile::tempdir().unwrap());
    tracing_subscriber::fmt()
        .with_max_level(tracing::Level::TRACE)
        .with_ansi(false)
        .with_writer(log.clone())
        .init();
    log_panics_without_text();
    let service = JobService::open(settings(dir.path(), 1), Script::new()).await.unwrap();
    let mut ids = Vec::new();
    for script in ["sleep 60 DOE", "panic DOE", "fail DOE"] {
        let upload = service.upload(stream::iter([Ok(Bytes::from(script))]), 100).await.unwrap();
        let spec = JobSpec { name: Some(FileName::new("DOE^JANE.stl")), ..JobSpec::default() };
        let job = service.submit(upload, spec).await.unwrap();
        assert!(!format!("{job:?}").contains("DOE"));
        ended(&service, job.id).await;
        ids.push(job.id);
    }
    service.remove(ids[0]).await.unwrap();
    service.shutdown(Duration::from_secs(5)).await;
    let log = String::from_utf8(log.0.lock().unwrap().clone()).unwrap();
    for id in ids {
        assert!(log.contains(&id.to_string()));
    }
    for said in ["successful", "panicked", "no-triangles", "purged", "jobs_fakes/mod.rs", "INSERT INTO jobs"]
    {
        assert!(log.contains(said), "the log was on, and says {said}");
    }
    for line in log.lines() {
        assert!(!line.contains("DOE"), "{line}");
    }
}
