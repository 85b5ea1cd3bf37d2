//! Why a job failed, as it is stored and shown.

use serde::{Deserialize, Serialize};

/// A job's failure: the parts of a problem (RFC 9457) that do not depend on HTTP.
///
/// Never holds text out of the mesh file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
#[error("{title}: {detail}")]
pub struct JobFailure {
    /// A stable word, e.g. `no-triangles`, for the problem type and for logs.
    pub code: String,
    /// Whose fault, in HTTP's numbers: 4xx the input's, 5xx the service's.
    pub status: u16,
    /// What kind of failure, the same for every job with this `code`.
    pub title: String,
    /// What was found in this job and what to do.
    pub detail: String,
}

impl JobFailure {
    /// The codes of the failures below, whatever the mesh: what a job may fail with beside its reader's and its
    /// method's errors.
    pub const CODES: [&str; 8] = [
        "time-limit",
        "memory-limit",
        "internal-error",
        "crashed",
        "input-lost",
        "unreadable-job",
        "stale-parameters",
        "result-too-large",
    ];

    pub fn new(code: &str, status: u16, title: &str, detail: impl Into<String>) -> Self {
        Self { code: code.to_owned(), status, title: title.to_owned(), detail: detail.into() }
    }

    /// The runner panicked. The panic's message stays out: it may quote the mesh.
    pub fn panicked() -> Self {
        Self::new(
            "internal-error",
            500,
            "The extraction stopped on an internal error",
            "the service is at fault, not the mesh's sender; the service's log has the place under this job's id",
        )
    }

    /// The process died `crashes` times while this job and no other ran.
    pub fn crashed(crashes: u32) -> Self {
        Self::new(
            "crashed",
            500,
            "The job was given up after repeated crashes",
            format!(
                "the service died {crashes} times while this job ran alone (out of memory is the usual cause); it \
                 is not tried again"
            ),
        )
    }

    /// The run's own process died `crashes` times; `how` is the last time's exit status.
    pub fn run_crashed(crashes: u32, how: &str) -> Self {
        Self::new(
            "crashed",
            500,
            "The job was given up after repeated crashes",
            format!(
                "the process of this job's run died {crashes} times, last by {how} (a machine out of memory is the \
                 usual cause of signal 9); it is not tried again"
            ),
        )
    }

    /// The run needs more memory than one may have.
    pub fn out_of_memory(bytes: u64) -> Self {
        let detail = format!(
            "one run may have {bytes} bytes of memory; send a coarser mesh, or let the operator raise --max-memory"
        );
        Self::new("memory-limit", 422, "The extraction needs too much memory", detail)
    }

    /// No process can be started for the run.
    pub(super) fn not_started(error: &std::io::Error) -> Self {
        let detail = format!("no process can be started for it: {error}; see to the limits of the machine");
        Self::new("internal-error", 500, "The extraction stopped on an internal error", detail)
    }

    /// The run was stopped; nobody reads this.
    pub(super) fn cancelled() -> Self {
        Self::new("cancelled", 422, "The run was cancelled", "the run was stopped before its end")
    }

    /// The run took longer than one may.
    pub fn out_of_time(seconds: u64) -> Self {
        let detail = format!("one run may take {seconds} s; send a coarser mesh, or raise the limit");
        Self::new("time-limit", 422, "The extraction took too long", detail)
    }

    /// The stored input cannot be read.
    pub fn input_lost(detail: impl Into<String>) -> Self {
        Self::new("input-lost", 500, "The stored mesh cannot be read", detail)
    }

    /// The job's row was written by something else.
    pub fn unreadable_row() -> Self {
        let detail =
            "its row in the job database was changed by hand or by another version; send the mesh again";
        Self::new("unreadable-job", 500, "The stored job cannot be read", detail)
    }

    /// The stored parameters are not those of this version.
    pub fn stale_parameters(detail: impl Into<String>) -> Self {
        Self::new("stale-parameters", 422, "The job's parameters are not known to this version", detail)
    }
}
