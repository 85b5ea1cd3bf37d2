//! Every bound of the service, in one type.

use std::time::Duration;

use crate::jobs::RUN_LIMIT;
use crate::jobs::isolation::JOB_MEMORY;
use crate::mesh::format;

/// Bytes of an upload that must come within its idle time: a byte now and then does not keep it alive.
pub const UPLOAD_STEP: usize = 16 << 10;

/// What one request may use, and for how long.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Bytes of one upload's mesh.
    pub upload_bytes: u64,
    /// Bytes of the `parameters` part of a multipart upload.
    pub parameters_bytes: usize,
    /// An upload of which less than [`UPLOAD_STEP`] (or the rest) comes in this long is given up.
    pub upload_idle: Duration,
    /// A connection whose next request's head is not whole after this long is closed.
    pub head: Duration,
    /// Meshes that are checked at the same time, and as many small ones beside them; further uploads wait their turn on disk.
    /// Each takes one copy of its file in memory and the mesh that is read from it, so this bounds the memory of any number
    /// of uploads.
    pub validations: usize,
    /// Uploads that may come in at the same time.
    pub uploads: usize,
    /// Uploads of one principal, or where no key is needed of one address, that may come in at the same time.
    pub uploads_each: usize,
    /// Jobs that may wait.
    pub queue: u64,
    /// Jobs of one principal that may wait or run.
    pub jobs_per_principal: u64,
    /// How long one run of a job may take.
    pub run: Duration,
    /// Bytes of memory that one run of a job may have.
    pub job_memory: u64,
    /// The largest mesh that is read.
    pub mesh: format::Limits,
    /// The longest that `Prefer: wait` is honoured.
    pub wait: Duration,
    /// Jobs on one page of the list, where the client does not say.
    pub page_default: u32,
    /// The most jobs on one page of the list.
    pub page_most: u32,
    /// Characters of a source name.
    pub name_chars: usize,
    /// Characters of a client's reference and of its request id.
    pub reference_chars: usize,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            upload_bytes: 1 << 30,
            parameters_bytes: 64 << 10,
            upload_idle: Duration::from_secs(30),
            head: Duration::from_secs(30),
            validations: 2,
            uploads: 256,
            uploads_each: 64,
            queue: 100_000,
            jobs_per_principal: 10_000,
            run: RUN_LIMIT,
            job_memory: JOB_MEMORY.get(),
            mesh: format::Limits::default(),
            wait: Duration::from_secs(60),
            page_default: 50,
            page_most: 500,
            name_chars: 255,
            reference_chars: 128,
        }
    }
}
