//! The real service: the binary on a free port with a data folder of its own, and a client.

use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::{Arc, Mutex, mpsc};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use reqwest::{Client, RequestBuilder, Response, StatusCode};
use serde_json::Value;
use tempfile::TempDir;

/// Far longer than anything here takes on an idle machine.
pub const PATIENCE: Duration = Duration::from_secs(120);

/// A running `rosaline serve`; dropping it kills it.
pub struct Service {
    child: Child,
    /// `http://127.0.0.1:PORT`, or with `https`
    pub url: String,
    pub client: Client,
    log: Arc<Mutex<String>>,
    data: Arc<TempDir>,
}

/// `rosaline serve` on a free port, without settings from this process's environment.
pub fn command(data: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_rosaline"));
    set_up(command.arg("serve"), data);
    command
}

/// A command that becomes `rosaline serve`, for a free port.
pub fn set_up<'a>(command: &'a mut Command, data: &Path) -> &'a mut Command {
    without_settings(command);
    // As variables, so that a test's flags override them.
    command.env("ROSALINE_LISTEN", "127.0.0.1:0").env("ROSALINE_DATA", data);
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped())
}

/// Takes away what this process's environment would set.
pub fn without_settings(command: &mut Command) {
    let is_one = |name: &[u8]| name.starts_with(b"ROSALINE_") || name.starts_with(b"OTEL_");
    for (name, _) in std::env::vars_os().filter(|(name, _)| is_one(name.as_encoded_bytes())) {
        command.env_remove(name);
    }
}

impl Service {
    /// With a fresh data folder.
    pub fn start(arguments: &[&str]) -> Self {
        Self::start_on(Arc::new(tempfile::tempdir().unwrap()), arguments)
    }

    /// With a data folder that another one may have used.
    pub fn start_on(data: Arc<TempDir>, arguments: &[&str]) -> Self {
        Self::start_in(data, arguments, &[])
    }

    /// With a data folder and environment variables.
    pub fn start_in(data: Arc<TempDir>, arguments: &[&str], variables: &[(&str, &Path)]) -> Self {
        let mut command = command(data.path());
        let started = Self::try_start(command.args(arguments).envs(variables.iter().copied()), data);
        started.unwrap_or_else(|log| panic!("the service did not start: {log}"))
    }

    /// What it logged where it does not come up.
    pub fn try_start(command: &mut Command, data: Arc<TempDir>) -> Result<Self, String> {
        let mut child = command.spawn().unwrap();
        let log = Arc::new(Mutex::new(String::new()));
        // None where the test has the other end.
        let collected = child.stderr.take().map(|stderr| collect(stderr, log.clone()));
        let Some(line) = first_line(child.stdout.take().unwrap()) else {
            child.kill().ok();
            child.wait().ok();
            if let Some(collected) = collected {
                collected.join().unwrap();
            }
            return Err(log.lock().unwrap().clone());
        };
        let url = line.trim().strip_prefix("listening on ").unwrap().to_owned();
        // The system's certificates are none of a test's business.
        let client = Client::builder().tls_certs_only([]).build().unwrap();
        Ok(Self { child, url, client, log, data })
    }

    #[cfg_attr(
        not(debug_assertions),
        allow(dead_code, reason = "only the tests of faults ask, which need a debug build")
    )]
    pub fn has_ended(&mut self) -> bool {
        self.child.try_wait().unwrap().is_some()
    }

    /// Starts again on the same folder after this one has ended.
    pub fn restart(self, arguments: &[&str]) -> Self {
        let data = self.data.clone();
        drop(self);
        Self::start_on(data, arguments)
    }

    pub fn pid(&self) -> u32 {
        self.child.id()
    }

    pub fn data(&self) -> PathBuf {
        self.data.path().to_owned()
    }

    /// The most memory that it has had, MiB.
    pub fn peak_memory(&self) -> u64 {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.child.id())).unwrap();
        let line = status.lines().find(|line| line.starts_with("VmHWM")).unwrap();
        line.split_whitespace().nth(1).unwrap().parse::<u64>().unwrap() / 1024
    }

    pub fn address(&self) -> &str {
        self.url.split_once("://").unwrap().1
    }

    /// What it logged so far.
    pub fn log(&self) -> String {
        self.log.lock().unwrap().clone()
    }

    /// The log, once it has `text`, or after five seconds: its lines come through a pipe.
    pub async fn log_with(&self, text: &str) -> String {
        for _ in 0..100 {
            if self.log().contains(text) {
                break;
            }
            tokio::time::sleep(std::time::Duration::from_millis(50)).await;
        }
        self.log()
    }

    /// SIGKILL.
    pub fn kill(&mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }

    /// SIGTERM.
    pub fn terminate(&self) {
        self.signal("-TERM");
    }

    pub fn signal(&self, name: &str) {
        let pid = self.child.id().to_string();
        assert!(Command::new("kill").args([name, &pid]).status().unwrap().success());
    }

    /// Waits for its end.
    pub fn wait(&mut self) -> ExitStatus {
        let begin = Instant::now();
        loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                return status;
            }
            assert!(begin.elapsed() < PATIENCE, "the service does not end: {}", self.log());
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    pub fn get(&self, path: &str) -> RequestBuilder {
        self.client.get(format!("{}{path}", self.url))
    }

    pub fn delete(&self, path: &str) -> RequestBuilder {
        self.client.delete(format!("{}{path}", self.url))
    }

    pub fn post(&self, path: &str) -> RequestBuilder {
        self.client.post(format!("{}{path}", self.url))
    }

    /// Posts a mesh as raw bytes.
    pub async fn submit(&self, query: &str, body: impl Into<reqwest::Body>) -> Response {
        let request =
            self.post(&format!("/v1/jobs{query}")).header("content-type", "application/octet-stream");
        request.body(body).send().await.unwrap()
    }

    /// Posts a mesh that must be accepted; the job's path.
    pub async fn accepted(&self, query: &str, body: impl Into<reqwest::Body>) -> String {
        let response = self.submit(query, body).await;
        let (status, headers) = (response.status(), response.headers().clone());
        // Read to its end, or its connection would not be used again.
        let text = response.text().await.unwrap();
        assert_eq!(status, StatusCode::CREATED, "{text}");
        headers["location"].to_str().unwrap().to_owned()
    }

    /// Posts more work than is done while it is posted: jobs that smooth their mesh first, which takes long.
    pub async fn backlog(&self, count: usize, mesh: &[u8]) -> Vec<String> {
        let mesh = bytes::Bytes::copy_from_slice(mesh);
        let mut jobs = Vec::new();
        for _ in 0..count {
            jobs.push(self.accepted("?smoothing=true", mesh.clone()).await);
        }
        jobs
    }

    /// A job that runs and is not near its end.
    pub async fn running(&self) -> String {
        let begin = Instant::now();
        loop {
            let response = self.get("/v1/jobs?status=running").send().await.unwrap();
            let list: Value = response.json().await.unwrap();
            let early = |job: &&Value| job["progress"].as_u64().is_some_and(|progress| progress < 50);
            if let Some(job) = list["jobs"].as_array().unwrap().iter().find(early) {
                return job["links"][0]["href"].as_str().unwrap().to_owned();
            }
            assert!(begin.elapsed() < PATIENCE, "no job runs: {}", self.log());
            tokio::time::sleep(Duration::from_millis(2)).await;
        }
    }

    pub async fn status(&self, job: &str) -> Value {
        let response = self.get(job).send().await.unwrap();
        assert_eq!(response.status(), StatusCode::OK);
        response.json().await.unwrap()
    }

    /// The job's status once it has ended.
    pub async fn ended(&self, job: &str) -> Value {
        self.until(job, |status| !matches!(status["status"].as_str(), Some("accepted" | "running"))).await
    }

    /// The job's status once `fits`.
    pub async fn until(&self, job: &str, fits: impl Fn(&Value) -> bool) -> Value {
        let begin = Instant::now();
        loop {
            let status = self.status(job).await;
            if fits(&status) {
                return status;
            }
            assert!(begin.elapsed() < PATIENCE, "{status} after {PATIENCE:?}: {}", self.log());
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    }

    /// It still answers.
    pub async fn assert_alive(&self) {
        assert_eq!(self.get("/readyz").send().await.unwrap().status(), StatusCode::OK);
    }

    /// Files in its blob folder, whoever they belong to.
    pub fn files(&self) -> Vec<PathBuf> {
        let mut files = Vec::new();
        let mut folders = vec![self.data.path().join("blobs")];
        while let Some(folder) = folders.pop() {
            let Ok(entries) = std::fs::read_dir(folder) else { continue };
            for path in entries.map(|entry| entry.unwrap().path()) {
                if path.is_dir() { folders.push(path) } else { files.push(path) }
            }
        }
        files
    }

    /// How many files there are, once there are as many as should be, or after a while.
    #[cfg_attr(
        not(debug_assertions),
        allow(dead_code, reason = "only the tests of faults ask, which need a debug build")
    )]
    pub async fn settled_files(&self, expected: usize) -> usize {
        let begin = Instant::now();
        while self.files().len() != expected && begin.elapsed() < Duration::from_secs(5) {
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
        self.files().len()
    }

    /// The blob folder has no files; a short while is granted for those of a request that has just ended.
    pub async fn assert_no_files(&self) {
        let begin = Instant::now();
        while !self.files().is_empty() {
            assert!(begin.elapsed() < Duration::from_secs(10), "{:?} stay", self.files());
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    }
}

impl Drop for Service {
    fn drop(&mut self) {
        self.child.kill().ok();
        self.child.wait().ok();
    }
}

/// The first line of stdout, `None` when it ends before one or nothing comes. Reads on to the end.
fn first_line(stdout: impl Read + Send + 'static) -> Option<String> {
    let (sender, receiver) = mpsc::channel();
    std::thread::spawn(move || {
        let mut lines = BufReader::new(stdout).lines();
        if let Some(Ok(line)) = lines.next() {
            sender.send(line).ok();
        }
        lines.for_each(drop);
    });
    receiver.recv_timeout(PATIENCE).ok()
}

/// Ends when nobody writes any more.
fn collect(stderr: impl Read + Send + 'static, log: Arc<Mutex<String>>) -> JoinHandle<()> {
    std::thread::spawn(move || {
        for line in BufReader::new(stderr).lines().map_while(Result::ok) {
            let mut log = log.lock().unwrap();
            log.push_str(&line);
            log.push('\n');
        }
    })
}

/// Asserts a problem body of this kind and status; the body.
pub async fn problem(response: Response, status: u16, word: &str) -> Value {
    let (found, kind) = (response.status().as_u16(), response.headers().get("content-type").cloned());
    let text = response.text().await.unwrap();
    assert_eq!(found, status, "{text}");
    assert_eq!(kind.unwrap(), "application/problem+json", "{text}");
    let body: Value = serde_json::from_str(&text).unwrap();
    assert_eq!(body["type"], format!("urn:rosaline:problem:{word}"), "{text}");
    assert_eq!(body["status"], status);
    assert!(body["title"].is_string() && body["detail"].is_string(), "{text}");
    body
}
