//! The service that is loaded.

use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use super::wire::Client;

/// Longer than any job here takes.
const PATIENCE: Duration = Duration::from_secs(300);

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
        let begin = Instant::now();
        // Answered when the status changes.
        client.headers = "Prefer: wait=10\r\n";
        loop {
            assert!(begin.elapsed() < PATIENCE, "{job} does not end");
            let status = client.ask(&format!("GET {job}"), b"").unwrap();
            assert_eq!(status.status, 200);
            let text = String::from_utf8(status.body).unwrap();
            if !text.contains("\"status\":\"accepted\"") && !text.contains("\"status\":\"running\"") {
                client.headers = "";
                return;
            }
        }
    }

    /// A line of /proc/PID/status in KiB.
    pub fn kibibytes(&self, name: &str) -> u64 {
        number(self.child.id(), name).unwrap()
    }

    /// Resident memory once it stands still, in KiB.
    pub fn settled(&self) -> u64 {
        let begin = Instant::now();
        let mut before = 0;
        loop {
            let now = self.kibibytes("VmRSS");
            if now.abs_diff(before) < 64 || begin.elapsed() > PATIENCE {
                return now;
            }
            before = now;
            std::thread::sleep(Duration::from_millis(500));
        }
    }

    /// Memory that the processes of its runs have for themselves, in KiB.
    pub fn of_runs(&self) -> u64 {
        let processes = std::fs::read_dir("/proc").unwrap().filter_map(|entry| {
            let process = entry.ok()?.file_name().to_str()?.parse().ok()?;
            (number(process, "PPid")? == u64::from(self.child.id())).then_some(process)
        });
        processes.filter_map(|process| number(process, "RssAnon")).sum()
    }

    /// [`Service::kibibytes`] in MiB.
    pub fn memory(&self, name: &str) -> u64 {
        self.kibibytes(name) / 1024
    }
}

/// A number in /proc/PID/status; `None` where it is gone.
fn number(process: u32, name: &str) -> Option<u64> {
    let text = std::fs::read_to_string(format!("/proc/{process}/status")).ok()?;
    text.lines().find(|line| line.starts_with(name))?.split_whitespace().nth(1)?.parse().ok()
}

impl Drop for Service {
    fn drop(&mut self) {
        self.child.kill().ok();
        self.child.wait().ok();
    }
}
