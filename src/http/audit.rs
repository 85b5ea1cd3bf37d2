//! The audit trail: who did what to which job, one JSON object a line, in a file that is only ever added to.
//!
//! The members are those of an audit message of DICOM PS3.15, section A.5 (RFC 3881). Written are submissions, results
//! that were handed out, lists, cancellations and purges, retries, webhooks that are sent again, and refusals for want of a key or a scope; polls of
//! a status are not.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::net::IpAddr;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use axum::http::{Method, StatusCode};
use serde_json::{Value, json};
use time::OffsetDateTime;
use time::format_description::well_known::Rfc3339;

use crate::jobs::JobId;
use crate::jobs::faults::{Operation, between};

/// Where a request came from: the connection's other end.
#[derive(Debug, Clone, Copy)]
pub struct Peer(pub IpAddr);

/// What was done, as far as it is told.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Act {
    Import,
    Export,
    Query,
    Retry,
    Delete,
    /// A webhook is sent again.
    Resend,
    /// Somebody was not let in, or not allowed to.
    Refused,
}

impl Act {
    fn of(method: &Method, path: &str, status: StatusCode) -> Option<Self> {
        if matches!(status, StatusCode::UNAUTHORIZED | StatusCode::FORBIDDEN) {
            return Some(Act::Refused);
        }
        match method.as_str() {
            "POST" if path.ends_with("/retry") => Some(Act::Retry),
            "POST" if path.ends_with("/resend") => Some(Act::Resend),
            "POST" => Some(Act::Import),
            "DELETE" => Some(Act::Delete),
            "GET" if matches!(path, "/v1/jobs" | "/v1/webhooks/dead") => Some(Act::Query),
            "GET" if path.contains("/results/") => Some(Act::Export),
            _ => None,
        }
    }

    /// The event's code and meaning in DICOM's dictionary (PS3.16, CID 400), and its action code.
    fn codes(self) -> (&'static str, &'static str, &'static str) {
        match self {
            Act::Import => ("110107", "Import", "C"),
            Act::Export => ("110106", "Export", "R"),
            Act::Query => ("110112", "Query", "E"),
            Act::Retry => ("110103", "DICOM Instances Accessed", "U"),
            Act::Delete => ("110103", "DICOM Instances Accessed", "D"),
            Act::Resend => ("110106", "Export", "E"),
            Act::Refused => ("110113", "Security Alert", "E"),
        }
    }
}

/// One request and its answer.
pub(super) struct Occurrence<'a> {
    pub(super) method: &'a Method,
    pub(super) path: &'a str,
    pub(super) status: StatusCode,
    /// The principal; none where there is no authentication, or it failed.
    pub(super) user: Option<&'a str>,
    pub(super) peer: Option<Peer>,
    pub(super) job: Option<JobId>,
}

impl Occurrence<'_> {
    /// The line, if this is to be told.
    fn message(&self) -> Option<Value> {
        let act = Act::of(self.method, self.path, self.status)?;
        let (code, meaning, action) = act.codes();
        // 0 success, 4 minor failure, 8 serious failure (RFC 3881, section 5.1.4).
        let outcome = match self.status.as_u16() {
            ..400 => 0,
            400..500 => 4,
            _ => 8,
        };
        let mut message = json!({
            "EventIdentification": {
                "EventID": {"csd-code": code, "codeSystemName": "DCM", "originalText": meaning},
                "EventActionCode": action,
                "EventDateTime": OffsetDateTime::now_utc().format(&Rfc3339).unwrap_or_default(),
                "EventOutcomeIndicator": outcome,
                "EventOutcomeDescription": self.status.as_u16().to_string(),
            },
            "ActiveParticipant": [{
                "UserID": self.user.unwrap_or("anonymous"),
                "UserIsRequestor": true,
            }],
            "AuditSourceIdentification": {"AuditSourceID": "rosaline", "AuditSourceTypeCode": "4"},
            "ParticipantObjectIdentification": [],
        });
        if let Some(Peer(address)) = self.peer {
            message["ActiveParticipant"][0]["NetworkAccessPointID"] = json!(address.to_string());
            // 2: an IP address.
            message["ActiveParticipant"][0]["NetworkAccessPointTypeCode"] = json!("2");
        }
        if let Some(job) = self.job {
            message["ParticipantObjectIdentification"] = json!([{
                "ParticipantObjectID": job.to_string(),
                "ParticipantObjectTypeCode": "2",
                "ParticipantObjectTypeCodeRole": "20",
                "ParticipantObjectIDTypeCode": {"originalText": "job"},
            }]);
        }
        Some(message)
    }
}

/// Whether the trail is told of such an answer.
pub(super) fn is_told(method: &Method, path: &str, status: StatusCode) -> bool {
    Act::of(method, path, status).is_some()
}

/// The file that is added to. One that has grown is set aside under the time of its last line and never touched again.
pub struct Trail {
    path: PathBuf,
    rotate_at: u64,
    file: Mutex<File>,
}

impl Trail {
    /// # Errors
    /// When the file cannot be opened for adding.
    pub fn open(path: &Path, rotate_at: u64) -> io::Result<Self> {
        let mut file = append(path)?;
        if !ends_a_line(path)? {
            // What a crash left of a line stays as it is; the next one must not be taken for its end.
            file.write_all(b"\n")?;
        }
        Ok(Self { path: path.to_owned(), rotate_at, file: Mutex::new(file) })
    }

    /// Adds a line, if this is to be told, and waits until it is on disk.
    pub(super) fn tell(&self, occurrence: &Occurrence<'_>) {
        let Some(message) = occurrence.message() else { return };
        if let Err(error) = self.add(&format!("{message}\n")) {
            // The request is answered all the same: a full disk must not keep jobs from being purged.
            tracing::error!(%error, "the audit trail cannot be added to");
        }
    }

    fn add(&self, line: &str) -> io::Result<()> {
        let mut file = self.file.lock().unwrap_or_else(PoisonError::into_inner);
        if file.metadata()?.len() >= self.rotate_at
            && let Err(error) = self.rotate(&mut file)
        {
            tracing::error!(%error, "the audit trail cannot be set aside; it goes on in its file");
        }
        // One write, so that a crash leaves no half of a line but the last.
        between(Operation::AuditWrite, || file.write_all(line.as_bytes()))?;
        between(Operation::AuditSync, || file.sync_data())
    }

    fn rotate(&self, file: &mut File) -> io::Result<()> {
        let renamed = between(Operation::AuditRotate, || fs::rename(&self.path, self.aside()));
        // After an error it may be renamed all the same.
        if renamed.is_ok() || !self.path.exists() {
            *file = append(&self.path)?;
        }
        renamed
    }

    /// A name that no older part has.
    fn aside(&self) -> PathBuf {
        let stamp = OffsetDateTime::now_utc().unix_timestamp_nanos();
        self.path.with_extension(format!("{stamp}.jsonl"))
    }
}

/// Whether the file is empty or ends with a newline.
fn ends_a_line(path: &Path) -> io::Result<bool> {
    let mut file = File::open(path)?;
    if file.metadata()?.len() == 0 {
        return Ok(true);
    }
    file.seek(SeekFrom::End(-1))?;
    let mut last = [0];
    file.read_exact(&mut last)?;
    Ok(last == *b"\n")
}

fn append(path: &Path) -> io::Result<File> {
    let mut options = OpenOptions::new();
    options.append(true).create(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    options.open(path)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tell(trail: &Trail, method: Method, path: &str, status: StatusCode) {
        trail.tell(&Occurrence { method: &method, path, status, user: Some("pacs"), peer: None, job: None });
    }

    #[test]
    fn a_trail_is_set_aside_whole_and_polls_are_not_told() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("audit.jsonl");
        let trail = Trail::open(&path, 1000).unwrap();
        for _ in 0..20 {
            tell(&trail, Method::POST, "/v1/jobs", StatusCode::CREATED);
            tell(&trail, Method::GET, "/v1/jobs/x", StatusCode::OK);
        }
        let mut lines = Vec::new();
        let mut files = 0;
        for entry in fs::read_dir(dir.path()).unwrap() {
            files += 1;
            let text = fs::read_to_string(entry.unwrap().path()).unwrap();
            lines.extend(text.lines().map(|line| serde_json::from_str::<Value>(line).unwrap()));
        }
        assert!(files > 2, "{files}");
        assert_eq!(lines.len(), 20);
        assert!(lines.iter().all(|line| line["EventIdentification"]["EventActionCode"] == "C"));
        // A new process goes on where the last one was.
        let before = fs::read_to_string(&path).unwrap();
        tell(&Trail::open(&path, 1 << 20).unwrap(), Method::DELETE, "/v1/jobs/x", StatusCode::NOT_FOUND);
        let after = fs::read_to_string(&path).unwrap();
        assert!(after.starts_with(&before));
        // Nor is a line that a crash cut short touched, or glued to the next.
        append(&path).unwrap().write_all(b"{\"Event").unwrap();
        tell(&Trail::open(&path, 1 << 20).unwrap(), Method::DELETE, "/v1/jobs/x", StatusCode::NOT_FOUND);
        let after = fs::read_to_string(&path).unwrap();
        assert_eq!(after.lines().rev().nth(1), Some("{\"Event"));
        let last: Value = serde_json::from_str(after.lines().last().unwrap()).unwrap();
        assert_eq!(last["EventIdentification"]["EventOutcomeIndicator"], 4);
    }
}
