//! A client that wants its jobs whatever happens to the service.

use std::collections::BTreeSet;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use reqwest::{RequestBuilder, Response};
use rosaline::jobs::faults::{Operation, VARIABLE};
use serde_json::Value;
use sha2::{Digest, Sha256};
use tempfile::TempDir;

use crate::meshes;
use crate::service::{PATIENCE, Service, command};

/// The process is gone.
pub struct Died;

/// A job that a client wants, whatever happens to the service.
pub struct Wish {
    key: String,
    kind: Kind,
    location: Option<String>,
    retried: bool,
}

#[derive(Clone, Copy, PartialEq)]
pub enum Kind {
    Good,
    /// A ball has no centerline; it is tried again once.
    Bad,
    /// It smooths its mesh first, which takes long, and is cancelled as soon as it is there.
    Unwanted,
}

impl Wish {
    fn mesh(&self) -> Vec<u8> {
        match self.kind {
            Kind::Good => meshes::stl(&meshes::tube(20, 12)),
            Kind::Bad => meshes::ball(),
            Kind::Unwanted => meshes::stl(&meshes::tube(150, 40)),
        }
    }
}

/// A client and the folder of the services that it meets.
pub struct Client {
    data: Arc<TempDir>,
    flags: &'static [&'static str],
    service: Option<Service>,
    wishes: Vec<Wish>,
    /// All that was wished for was there and right; it is being removed.
    inspected: bool,
}

impl Client {
    pub fn new(flags: &'static [&'static str]) -> Self {
        let data = Arc::new(tempfile::tempdir().unwrap());
        Self { data, flags, service: None, wishes: Vec::new(), inspected: false }
    }

    /// Another process on the folder, with this fault to come; whether it comes up.
    pub fn start(&mut self, fault: &str) -> bool {
        self.service = None;
        let mut command = command(self.data.path());
        command.args(["--workers", "2", "--threads", "2", "--audit-rotate", "1KiB"]).args(self.flags);
        self.service = Service::try_start(command.env(VARIABLE, fault), self.data.clone()).ok();
        self.service.is_some()
    }

    pub fn service(&self) -> &Service {
        self.service.as_ref().unwrap()
    }

    /// Sends until there is an answer that is no 5xx.
    async fn ask(&mut self, request: impl Fn(&Service) -> RequestBuilder) -> Result<Response, Died> {
        let begin = Instant::now();
        loop {
            let answer = request(self.service()).send().await;
            match answer {
                Ok(response) if response.status().as_u16() < 500 => return Ok(response),
                Ok(_) => {}
                Err(_) if self.service.as_mut().unwrap().has_ended() => return Err(Died),
                Err(_) => {}
            }
            assert!(begin.elapsed() < PATIENCE, "no answer: {}", self.service().log());
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    }

    async fn status(&mut self, job: &str) -> Result<Option<Value>, Died> {
        let response = self.ask(|service| service.get(job).header("prefer", "wait=5")).await?;
        match response.status().as_u16() {
            200 => Ok(response.json().await.ok()),
            404 | 410 => Ok(None),
            other => panic!("{other} for a status"),
        }
    }

    async fn ended(&mut self, job: &str) -> Result<Option<Value>, Died> {
        let begin = Instant::now();
        loop {
            let status = self.status(job).await?;
            let active = |status: &Value| matches!(status["status"].as_str(), Some("accepted" | "running"));
            if !status.as_ref().is_some_and(active) {
                return Ok(status);
            }
            assert!(begin.elapsed() < PATIENCE, "{status:?}: {}", self.service().log());
        }
    }

    pub fn wish(&mut self, round: usize) {
        for (kind, word) in [(Kind::Unwanted, "unwanted"), (Kind::Good, "good"), (Kind::Bad, "bad")] {
            let key = format!("{word}-{round}");
            self.wishes.push(Wish { key, kind, location: None, retried: false });
        }
        self.inspected = false;
    }

    /// Goes on until every wish is fulfilled, then looks at what is there.
    pub async fn pursue(&mut self) -> Result<(), Died> {
        for place in 0..self.wishes.len() {
            self.submit(place).await?;
        }
        for place in 0..if self.inspected { 0 } else { self.wishes.len() } {
            self.see_to_its_end(place).await?;
        }
        if !self.inspected && !self.expires() {
            self.inspect().await?;
        }
        self.inspected = true;
        for place in 0..self.wishes.len() {
            self.see_it_gone(place).await?;
        }
        self.wishes.clear();
        let list: Value =
            self.ask(|service| service.get("/v1/jobs")).await?.json().await.map_err(|_| Died)?;
        assert_eq!(list["jobs"], serde_json::json!([]), "{}", self.service().log());
        assert_eq!(self.service().files(), Vec::<PathBuf>::new());
        Ok(())
    }

    /// Whether jobs go by themselves.
    fn expires(&self) -> bool {
        self.flags.contains(&"--keep-jobs")
    }

    async fn see_it_gone(&mut self, place: usize) -> Result<(), Died> {
        let job = self.wishes[place].location.clone().unwrap();
        let begin = Instant::now();
        while self.expires() && self.status(&job).await?.is_some() {
            assert!(begin.elapsed() < PATIENCE, "{}", self.service().log());
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
        // Whoever deleted before and got no answer finds it gone.
        let response = self.ask(|service| service.delete(&job)).await?;
        assert!([204, 404, 410].contains(&response.status().as_u16()), "{}", response.status());
        Ok(())
    }

    async fn submit(&mut self, place: usize) -> Result<(), Died> {
        if self.wishes[place].location.is_some() {
            return Ok(());
        }
        let (key, mesh, kind) =
            (self.wishes[place].key.clone(), self.wishes[place].mesh(), self.wishes[place].kind);
        let path = if kind == Kind::Unwanted { "/v1/jobs?smoothing=true" } else { "/v1/jobs" };
        let post = |service: &Service| {
            let request = service.post(path).header("idempotency-key", &key);
            request.header("content-type", "model/stl").body(mesh.clone())
        };
        loop {
            let response = self.ask(post).await?;
            if response.status() == 201 {
                let location = response.headers()["location"].to_str().unwrap().to_owned();
                self.wishes[place].location = Some(location.clone());
                if kind == Kind::Unwanted {
                    self.ask(|service| service.delete(&location)).await?;
                }
                return Ok(());
            }
            assert_eq!(response.status(), 409, "{:?}", response.text().await);
        }
    }

    async fn see_to_its_end(&mut self, place: usize) -> Result<(), Died> {
        let job = self.wishes[place].location.clone().unwrap();
        if self.wishes[place].kind == Kind::Unwanted {
            // Only where the process died before it was asked.
            let response = self.ask(|service| service.get(&job)).await?;
            let status: Value = response.json().await.map_err(|_| Died)?;
            if matches!(status["status"].as_str(), Some("accepted" | "running")) {
                self.ask(|service| service.delete(&job)).await?;
            }
        }
        let Some(status) = self.ended(&job).await? else {
            assert!(self.wishes[place].kind == Kind::Unwanted || self.expires(), "a job is lost");
            return Ok(());
        };
        let fault = |status: &Value| status["error"]["status"].as_u64() >= Some(500);
        if status["status"] == "failed" && (fault(&status) || !self.wishes[place].retried) {
            if !fault(&status) {
                assert!(self.wishes[place].kind == Kind::Bad, "{status}");
                self.wishes[place].retried = true;
            }
            // The answer to an earlier one may have been lost: it is not failed any more then.
            let response = self.ask(|service| service.post(&format!("{job}/retry"))).await?;
            assert!([200, 409].contains(&response.status().as_u16()));
            return Box::pin(self.see_to_its_end(place)).await;
        }
        let fits = match self.wishes[place].kind {
            Kind::Good => status["status"] == "successful",
            Kind::Bad => status["status"] == "failed",
            Kind::Unwanted => status["status"] == "dismissed" || status["status"] == "successful",
        };
        assert!(fits, "{status}: {}", self.service().log());
        Ok(())
    }

    /// Each job once, its results whole, and no file that belongs to none.
    async fn inspect(&mut self) -> Result<(), Died> {
        let list: Value =
            self.ask(|service| service.get("/v1/jobs")).await?.json().await.map_err(|_| Died)?;
        let jobs = list["jobs"].as_array().unwrap().clone();
        let known: BTreeSet<_> = self.wishes.iter().map(|wish| wish.location.clone().unwrap()).collect();
        let mut expected = 0;
        for job in &jobs {
            let path = job["links"][0]["href"].as_str().unwrap().to_owned();
            assert!(known.contains(&path), "{path} was never wished for");
            expected += 1;
            if job["status"] != "successful" {
                continue;
            }
            for extension in ["json", "glb", "gltf", "vtp"] {
                let result = format!("{path}/results/centerline.{extension}");
                let response = self.ask(|service| service.get(&result)).await?;
                assert_eq!(response.status(), 200);
                let tag = response.headers()["etag"].to_str().unwrap().to_owned();
                let bytes = response.bytes().await.map_err(|_| Died)?;
                let digest = Sha256::digest(&bytes);
                let digest: String = digest.iter().map(|byte| format!("{byte:02x}")).collect();
                assert!(tag.contains(&digest), "{tag} {digest}");
                // As it is, and JSON and glTF as .gz and .zst.
                expected += if ["glb", "vtp"].contains(&extension) { 1 } else { 3 };
            }
        }
        assert_eq!(self.service().settled_files(expected).await, expected, "{}", self.service().log());
        Ok(())
    }

    /// Whether a fault of this operation has come, by the log.
    pub async fn came_by(&self, operation: Operation) -> bool {
        let word = format!("fault=\"{}\"", operation.name());
        let begin = Instant::now();
        // What a worker tries again later may come after the jobs' ends.
        while !self.service().log().contains(&word) {
            if begin.elapsed().as_secs() > 20 {
                return false;
            }
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
        true
    }

    /// Whether the process dies without being asked for anything: the housekeeping's points.
    pub async fn waits_for_its_end(&mut self) -> bool {
        let begin = Instant::now();
        while !self.service.as_mut().unwrap().has_ended() {
            if begin.elapsed().as_secs() > 20 {
                return false;
            }
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
        true
    }
}
