//! The service that is loaded.

use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use super::wire::Client;

/// A running service with a data folder of its own.
pub struct Service {
    child: Child,
    pub address: String,
    _data: tempfile::TempDir,
}

impl Service {
    pub fn start() -> Self {
        let data = tempfile::tempdir().unwrap();
        // Beside the folder of examples.
        let program = std::env::current_exe().unwrap().parent().unwrap().with_file_name("rosaline");
        let mut command = Command::new(program);
        command.args(["serve", "--listen", "127.0.0.1:0", "--data"]).arg(data.path());
        command.args(std::env::var("SERVE").unwrap_or_default().split_whitespace());
        let mut child = command.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let address = line.trim().strip_prefix("listening on http://").unwrap().to_owned();
        Self { child, address, _data: data }
    }

    /// Waits until a job has ended, well or not.
    pub fn wait_for(&self, client: &mut Client, job: &str) {
        loop {
            let status = client.ask(&format!("GET {job}"), b"").unwrap();
            assert_eq!(status.status, 200);
            let text = String::from_utf8(status.body).unwrap();
            if !text.contains("\"status\":\"accepted\"") && !text.contains("\"status\":\"running\"") {
                return;
            }
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    /// A line of /proc/PID/status in KiB.
    pub fn kibibytes(&self, name: &str) -> u64 {
        let text = std::fs::read_to_string(format!("/proc/{}/status", self.child.id())).unwrap();
        let line = text.lines().find(|line| line.starts_with(name)).unwrap();
        line.split_whitespace().nth(1).unwrap().parse().unwrap()
    }

    /// [`Service::kibibytes`] in MiB.
    pub fn memory(&self, name: &str) -> u64 {
        self.kibibytes(name) / 1024
    }
}

impl Drop for Service {
    fn drop(&mut self) {
        self.child.kill().ok();
        self.child.wait().ok();
    }
}
