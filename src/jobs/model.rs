//! What a job is.

use std::fmt;
use std::str::FromStr;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::{Coding, JobFailure, JobId, ParameterValues, Priority, StageTimes};
use crate::centerline::Parameters;
use crate::mesh::Units;
use crate::output::OutputFormat;

/// A job's state, in the words of OGC API Processes (statusInfo).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum JobStatus {
    /// Waits for a worker.
    Accepted,
    Running,
    Successful,
    Failed,
    /// Cancelled by its client.
    Dismissed,
}

impl JobStatus {
    pub const ALL: [JobStatus; 5] = [
        JobStatus::Accepted,
        JobStatus::Running,
        JobStatus::Successful,
        JobStatus::Failed,
        JobStatus::Dismissed,
    ];

    /// The state's word in the API, the store and logs.
    pub fn name(self) -> &'static str {
        match self {
            JobStatus::Accepted => "accepted",
            JobStatus::Running => "running",
            JobStatus::Successful => "successful",
            JobStatus::Failed => "failed",
            JobStatus::Dismissed => "dismissed",
        }
    }

    /// Whether the job will still change.
    pub fn is_active(self) -> bool {
        matches!(self, JobStatus::Accepted | JobStatus::Running)
    }
}

impl fmt::Display for JobStatus {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

/// A word that is none of [`JobStatus`]' names.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("this is not a job status; use accepted, running, successful, failed or dismissed")]
pub struct UnknownStatus;

impl FromStr for JobStatus {
    type Err = UnknownStatus;

    fn from_str(text: &str) -> Result<Self, UnknownStatus> {
        JobStatus::ALL.into_iter().find(|status| status.name() == text).ok_or(UnknownStatus)
    }
}

/// The mesh's file name as its client gave it: patient data. `Debug` and `Display` hide it.
#[derive(Clone, PartialEq, Eq)]
pub struct FileName(String);

/// A name that cannot be one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("a name has 1 to {0} characters and no control characters")]
pub struct BadName(usize);

impl FileName {
    /// The last part of a path: a browser's file name may carry folders of a client's machine. `None`: only folders, or dots,
    /// which would be one where the name is used as a file's.
    ///
    /// # Errors
    /// [`BadName`] where it is empty, longer than `most` characters, or holds control characters.
    pub fn of(path: &str, most: usize) -> Result<Option<Self>, BadName> {
        if path.is_empty() || path.chars().count() > most || path.chars().any(char::is_control) {
            return Err(BadName(most));
        }
        let last = path.rsplit(['/', '\\']).next().unwrap_or_default().trim();
        Ok(if last.bytes().all(|byte| byte == b'.') { None } else { Some(Self::new(last)) })
    }

    pub fn new(name: impl Into<String>) -> Self {
        Self(name.into())
    }

    /// The name itself: for the result's `source.name` and the store, never for a log.
    pub fn expose(&self) -> &str {
        &self.0
    }
}

impl fmt::Debug for FileName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("FileName(hidden)")
    }
}

/// What the client says the mesh is; decides only where the content leaves doubts.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct FormatHint {
    /// Of the file name, without its stem: that is patient data.
    pub extension: Option<String>,
    pub content_type: Option<String>,
}

/// What a client says of its request, to find its job by. May be patient data: `Debug` hides it.
#[derive(Clone, Default, PartialEq, Eq)]
pub struct Origin {
    /// Its `X-Request-ID`.
    pub request_id: Option<String>,
    /// Its own word for the job.
    pub client_reference: Option<String>,
    /// The span of its request, which the job's run belongs to.
    pub traceparent: Option<String>,
}

impl fmt::Debug for Origin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Origin(hidden)")
    }
}

/// The request that made a job, so that the same request makes no second one.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Idempotency {
    /// The client's; no two jobs have the same.
    pub key: String,
    /// Equal for equal requests.
    pub fingerprint: String,
}

/// What a client asks for, beside the mesh's bytes.
#[derive(Debug, Clone, PartialEq)]
pub struct JobSpec {
    pub hint: FormatHint,
    /// For the result's `source.name`.
    pub name: Option<FileName>,
    pub units: Units,
    pub parameters: ParameterValues,
    pub origin: Origin,
    pub idempotency: Option<Idempotency>,
    pub priority: Priority,
    /// The principal that the job belongs to; none where there is no authentication.
    pub owner: Option<String>,
}

impl Default for JobSpec {
    fn default() -> Self {
        let parameters = ParameterValues::from(&Parameters::default());
        Self {
            hint: FormatHint::default(),
            name: None,
            units: Units::default(),
            parameters,
            origin: Origin::default(),
            idempotency: None,
            priority: Priority::default(),
            owner: None,
        }
    }
}

/// A mesh in the blob store.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StoredInput {
    pub key: String,
    /// Bytes.
    pub size: u64,
    /// SHA-256 of the bytes, lower-case hex.
    pub sha256: String,
}

/// A result in the blob store.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct StoredArtifact {
    #[serde(with = "format_word")]
    pub format: OutputFormat,
    pub key: String,
    /// Bytes.
    pub size: u64,
    /// SHA-256 of the bytes, lower-case hex: a strong ETag.
    pub sha256: String,
    #[serde(default, skip_serializing_if = "Coding::is_identity")]
    pub coding: Coding,
}

/// Output formats as their extensions.
mod format_word {
    use serde::{Deserialize, Deserializer, Serializer, de};

    use crate::output::OutputFormat;

    pub(super) fn serialize<S: Serializer>(format: &OutputFormat, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(format.extension())
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<OutputFormat, D::Error> {
        let word = String::deserialize(deserializer)?;
        OutputFormat::from_extension(&word).ok_or_else(|| de::Error::custom("an unknown result format"))
    }
}

/// A claim's secret: updates of a running job must show it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Lease(String);

impl Lease {
    pub fn new() -> Self {
        Self(uuid::Uuid::now_v7().simple().to_string())
    }

    pub fn as_str(&self) -> &str {
        &self.0
    }

    pub(super) fn from_stored(text: String) -> Self {
        Self(text)
    }
}

impl Default for Lease {
    fn default() -> Self {
        Self::new()
    }
}

/// One row of the store. Times are milliseconds since the epoch.
#[derive(Debug, Clone, PartialEq)]
pub struct Job {
    pub id: JobId,
    pub status: JobStatus,
    /// Percent, 0 to 100.
    pub progress: u8,
    /// The stage at work, or at which the job failed or was dismissed.
    pub stage: Option<String>,
    pub created: i64,
    /// Of the last attempt.
    pub started: Option<i64>,
    pub updated: i64,
    pub finished: Option<i64>,
    /// Of a failed job.
    pub error: Option<JobFailure>,
    pub input: StoredInput,
    pub spec: JobSpec,
    /// Of a successful job.
    pub artifacts: Vec<StoredArtifact>,
    /// How often the job was started and not put back by an orderly shutdown.
    pub attempts: u32,
    /// Of a running job.
    pub lease: Option<Lease>,
    /// When its purge was begun: some of its files may be gone.
    pub purging: Option<i64>,
    /// When its input was removed, before the job itself.
    pub input_removed: Option<i64>,
}

impl Job {
    /// The forms that its result is there in: fewer than [all](OutputFormat::ALL) where an older version made it.
    pub fn forms(&self) -> impl Iterator<Item = OutputFormat> {
        let is_there = |format: &OutputFormat| self.artifacts.iter().any(|made| made.format == *format);
        OutputFormat::ALL.into_iter().filter(is_there)
    }

    /// A job that waits for its first run.
    pub fn accepted(id: JobId, input: StoredInput, spec: JobSpec, now: i64) -> Self {
        Self {
            id,
            status: JobStatus::Accepted,
            progress: 0,
            stage: None,
            created: now,
            started: None,
            updated: now,
            finished: None,
            error: None,
            input,
            spec,
            artifacts: Vec::new(),
            attempts: 0,
            lease: None,
            purging: None,
            input_removed: None,
        }
    }
}

/// How many jobs are in each state.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct Counts {
    pub accepted: u64,
    pub running: u64,
    pub successful: u64,
    pub failed: u64,
    pub dismissed: u64,
}

/// How much there is to do, and who does it.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Load {
    pub counts: Counts,
    /// How often jobs have ended in each way since the start.
    pub ends: Vec<(JobStatus, u64)>,
    /// How long the oldest waiting job has waited.
    pub queue_age: Duration,
    pub workers: usize,
    /// Workers whose run goes on; more of them may store results.
    pub busy: usize,
    /// Workers that wait for a cancelled run which does not stop.
    pub held: usize,
    /// Threads that compute, over all workers.
    pub threads: usize,
    /// Those of them that a run has.
    pub busy_threads: usize,
    /// Processes that wait for a next run.
    pub resting: usize,
    /// Of the runs since the start.
    pub stages: Vec<StageTimes>,
}

#[cfg(test)]
mod tests {
    use super::*;
    #[test]
    fn a_job_does_not_show_its_file_name() {
        let spec = JobSpec { name: Some(FileName::new("doe_jane_1970.stl")), ..JobSpec::default() };
        assert!(!format!("{spec:?}").contains("doe"));
        assert_eq!(spec.name.map(|name| name.expose().to_owned()).as_deref(), Some("doe_jane_1970.stl"));
    }

    #[test]
    fn a_name_of_dots_is_none() {
        let name = |path| FileName::of(path, 255).unwrap().map(|name| name.expose().to_owned());
        for path in ["..", "../..", "a/.", "C:\\x\\..", "...", "a/ .. "] {
            assert_eq!(name(path), None, "{path}");
        }
        assert_eq!(name("../.doe.stl").as_deref(), Some(".doe.stl"));
    }

    #[test]
    fn words_read_back() {
        for status in JobStatus::ALL {
            assert_eq!(status.name().parse(), Ok(status));
        }
        assert_eq!("Running".parse::<JobStatus>(), Err(UnknownStatus));
        for format in OutputFormat::ALL {
            let artifact = StoredArtifact {
                format,
                key: "k".into(),
                size: 1,
                sha256: "00".into(),
                coding: Coding::Gzip,
            };
            let json = serde_json::to_string(&artifact).unwrap();
            assert!(json.contains(&format!("\"format\":\"{}\"", format.extension())), "{json}");
            assert_eq!(serde_json::from_str::<StoredArtifact>(&json).unwrap(), artifact);
        }
    }
}
