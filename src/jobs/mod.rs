//! The durable job queue and its worker pool.
//!
//! [`JobService`] is the door: it takes uploads, answers status, waits, cancels, hands out results and
//! shuts down. Behind it are two interfaces, [`store::JobStore`] (one table) and [`blob::BlobStore`]
//! (inputs and results), and [`runner::JobRunner`], which turns one input into results on a rayon pool.
//!
//! What holds at any moment, kill -9 included:
//! * an input is on disk (fsynced) before its job row, and the row is committed before `submit` returns;
//! * results are on disk before their job says `successful`;
//! * every update of a running job is fenced by the lease of its claim, so a job ends once;
//! * a purged job's files go before its row; files without a row are removed at the next start.
//!
//! Nothing here knows of HTTP, and nothing here logs a mesh's file name or content.

mod backoff;
pub mod blob;
pub mod checkup;
mod clock;
mod coding;
mod error;
pub mod extraction;
mod failure;
pub mod faults;
mod folder;
mod fresh_file;
mod housekeeping;
mod id;
mod input;
pub mod isolation;
mod live;
mod meter;
mod model;
pub mod operator_file;
mod outbox;
mod panics;
mod parameters;
mod presence;
mod priority;
mod readiness;
mod recovery;
mod removal;
mod results;
mod retention;
pub mod runner;
mod service;
mod settings;
mod slots;
mod spans;
mod stamp;
mod storage;
pub mod store;
mod timeline;
mod watch;
mod worker;

use clock::Steadiness;
pub use clock::{Clock, Doubt, ManualClock, SystemClock};
pub use coding::Coding;
pub use error::{JobError, Unready};
pub use failure::JobFailure;
pub use folder::{DataFolder, FolderError, keep_files_to_owner};
pub use id::{IdSource, JobId, ParseJobIdError};
pub use live::JobStage;
pub use meter::{Histogram, StageTimes};
pub use model::{
    BadName, Counts, FileName, FormatHint, Idempotency, Job, JobSpec, JobStatus, Lease, Load, Origin,
    StoredArtifact, StoredInput, UnknownStatus,
};
pub use outbox::{Delivery, DeliveryCounts, LONGEST_WAIT, Listener, Outbox, Told};
pub use panics::log_panics_without_text;
pub use parameters::ParameterValues;
pub use presence::Displaced;
pub use priority::{Priority, UnknownPriority};
pub use removal::Removed;
pub use retention::Retention;
pub use service::{JobService, Upload};
pub use settings::{LEAST_FREE, MAX_CRASHES, RUN_LIMIT, Settings, TooManyWorkers};
pub use spans::{Span, SpanKind, Spans, TRACEPARENT};
pub use storage::Storage;
