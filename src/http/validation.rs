//! Reads an uploaded mesh once before its job is accepted, so that a bad file is refused at once.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

use bytes::Bytes;
use rayon::{ThreadPool, ThreadPoolBuildError, ThreadPoolBuilder};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, oneshot};

use super::inspection::Inspection;
use super::limits::Limits;
use super::problem::{
    EMPTY, INDEX_OUT_OF_RANGE, INTERNAL_ERROR, INVALID_PARAMETER, Kind, MALFORMED, MESH_TOO_LARGE,
    NO_POLYGONS, NON_FINITE_COORDINATE, Problem, TRUNCATED, UNSUPPORTED_FEATURE, UNSUPPORTED_FORMAT,
};
use crate::centerline::{ExtractError, Parameters, check_reach};
use crate::jobs::FormatHint;
use crate::mesh::TriangleMesh;
use crate::mesh::format::{self, Format, Hint, ReadError};

/// A bounded number of readers on threads of their own, away from the async ones.
pub(super) struct Validator {
    permits: Arc<Semaphore>,
    pool: ThreadPool,
    limits: format::Limits,
}

/// The right to hold one mesh in memory.
pub(super) struct Turn(OwnedSemaphorePermit);

impl Validator {
    pub(super) fn new(limits: &Limits) -> Result<Self, ThreadPoolBuildError> {
        let pool = ThreadPoolBuilder::new()
            .num_threads(limits.validations)
            .thread_name(|thread| format!("validator-{thread}"))
            .build()?;
        Ok(Self { permits: Arc::new(Semaphore::new(limits.validations)), pool, limits: limits.mesh })
    }

    /// Waits until a mesh may be loaded.
    pub(super) async fn turn(&self) -> Result<Turn, Problem> {
        let permit = self.permits.clone().acquire_owned().await;
        permit
            .map(Turn)
            .map_err(|_| Problem::new(&INTERNAL_ERROR, "the service is stopping; try again later"))
    }

    /// The mesh's format, if it can be read and the points of `parameters` are near it.
    pub(super) async fn check(
        &self,
        turn: Turn,
        bytes: Bytes,
        hint: FormatHint,
        parameters: Parameters,
    ) -> Result<Format, Problem> {
        self.read(turn, bytes, hint, parameters, |_, format| format).await
    }

    /// The mesh as a job would find it, under the same conditions.
    pub(super) async fn inspect(
        &self,
        turn: Turn,
        bytes: Bytes,
        hint: FormatHint,
        parameters: Parameters,
        sha256: String,
    ) -> Result<Inspection, Problem> {
        let size = bytes.len() as u64;
        let then = move |mesh: TriangleMesh, format| Inspection::new(&mesh, format, &sha256, size);
        self.read(turn, bytes, hint, parameters, then).await
    }

    /// Reads the mesh on a thread of the pool and goes on with `then` there.
    async fn read<T: Send + 'static>(
        &self,
        turn: Turn,
        bytes: Bytes,
        hint: FormatHint,
        parameters: Parameters,
        then: impl FnOnce(TriangleMesh, Format) -> T + Send + 'static,
    ) -> Result<T, Problem> {
        let (answer, outcome) = oneshot::channel();
        let limits = self.limits;
        self.pool.spawn(move || {
            let read = || {
                let hint =
                    Hint { extension: hint.extension.as_deref(), content_type: hint.content_type.as_deref() };
                let (mesh, format) = format::read(&bytes, hint, &limits)?;
                drop(bytes);
                Ok(check_reach(&mesh, &parameters).map(|()| then(mesh, format)))
            };
            let outcome: Result<Result<Result<T, ExtractError>, ReadError>, _> =
                catch_unwind(AssertUnwindSafe(read));
            drop(turn.0);
            // Nobody listens any more when the client has left.
            let _ = answer.send(outcome);
        });
        match outcome.await {
            Ok(Ok(Ok(found))) => found.map_err(|error| far_off(&error)),
            Ok(Ok(Err(error))) => Err(refusal(&error)),
            Ok(Err(_)) | Err(_) => {
                Err(Problem::new(&INTERNAL_ERROR, "the mesh's reader stopped on an internal error"))
            }
        }
    }
}

/// A point that a job would fail for.
fn far_off(error: &ExtractError) -> Problem {
    let problem = Problem::new(&INVALID_PARAMETER, error.to_string());
    match error {
        ExtractError::OffSurface { name, .. } => problem.with("parameter", *name),
        _ => problem,
    }
}

/// The reader's error as the client sees it: one kind for each of the reader's words.
pub(super) fn refusal(error: &ReadError) -> Problem {
    Problem::new(kind(error), error.to_string())
}

fn kind(error: &ReadError) -> &'static Kind {
    match error {
        ReadError::Empty => &EMPTY,
        ReadError::Unsupported { .. } => &UNSUPPORTED_FORMAT,
        ReadError::Truncated { .. } => &TRUNCATED,
        ReadError::Malformed { .. } => &MALFORMED,
        ReadError::NonFinite { .. } => &NON_FINITE_COORDINATE,
        ReadError::IndexOutOfRange { .. } => &INDEX_OUT_OF_RANGE,
        ReadError::NoPolygons { .. } => &NO_POLYGONS,
        ReadError::UnsupportedFeature { .. } => &UNSUPPORTED_FEATURE,
        ReadError::TooLarge { .. } => &MESH_TOO_LARGE,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn problems_use_the_readers_words() {
        let errors = [
            ReadError::Empty,
            ReadError::Unsupported { found: "a PNG picture" },
            ReadError::Truncated { format: Format::Obj, detail: "x".to_owned() },
            ReadError::Malformed { format: Format::Obj, detail: "x".to_owned() },
            ReadError::NonFinite { format: Format::Obj, vertex: 1 },
            ReadError::IndexOutOfRange { format: Format::Obj, face: 1, index: 9, vertices: 3 },
            ReadError::NoPolygons { format: Format::Obj, instead: "" },
            ReadError::UnsupportedFeature { format: Format::Obj, feature: "x", advice: "y" },
            ReadError::TooLarge { format: Format::Obj, what: "vertices", found: 9, limit: 3 },
        ];
        for error in errors {
            assert_eq!(kind(&error).word, error.code());
        }
    }

    #[tokio::test]
    async fn a_picture_is_refused_and_the_turn_comes_back() {
        let validator = Validator::new(&Limits { validations: 1, ..Limits::default() }).unwrap();
        for _ in 0..3 {
            let turn = validator.turn().await.unwrap();
            let bytes = Bytes::from_static(b"\x89PNG\r\n\x1a\n....");
            let problem =
                validator.check(turn, bytes, FormatHint::default(), Parameters::default()).await.unwrap_err();
            assert_eq!(problem.status(), 415);
        }
    }
}
