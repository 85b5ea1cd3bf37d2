//! Reads an uploaded mesh once before its job is accepted, so that a bad file is refused at once.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

use bytes::Bytes;
use rayon::{ThreadPool, ThreadPoolBuildError, ThreadPoolBuilder};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, oneshot};

use super::inspection::Inspection;
use super::limits::{Limits, SMALL_FILE};
use super::problem::{
    EMPTY, INDEX_OUT_OF_RANGE, INTERNAL_ERROR, INVALID_PARAMETER, Kind, MALFORMED, MESH_TOO_LARGE,
    NO_POLYGONS, NON_FINITE_COORDINATE, Problem, TRUNCATED, UNSUPPORTED_FEATURE, UNSUPPORTED_FORMAT,
};
use crate::centerline::{ExtractError, Parameters, check_reach};
use crate::jobs::FormatHint;
use crate::mesh::TriangleMesh;
use crate::mesh::format::{self, Format, Hint, ReadError};
use crate::output;

/// A bounded number of readers on threads of their own, away from the async ones. Small meshes have others than large
/// ones: one that is read in milliseconds waits for none that takes seconds, neither for its turn nor within rayon, where a
/// thread that waits for a part of its own mesh takes on a part of another.
pub(super) struct Validator {
    small: Lane,
    large: Lane,
}

/// Readers of meshes within the same limits.
struct Lane {
    permits: Arc<Semaphore>,
    pool: ThreadPool,
    limits: format::Limits,
}

/// The right to hold one mesh in memory.
pub(super) struct Turn<P> {
    permit: OwnedSemaphorePermit,
    /// Of a small file: what it holds until it is known that its mesh is small too.
    small: Option<P>,
}

impl Lane {
    fn new(name: &'static str, readers: usize, limits: format::Limits) -> Result<Self, ThreadPoolBuildError> {
        let pool = ThreadPoolBuilder::new()
            .num_threads(readers)
            .thread_name(move |thread| format!("{name}-{thread}"))
            .build()?;
        Ok(Self { permits: Arc::new(Semaphore::new(readers)), pool, limits })
    }

    async fn permit(&self) -> Result<OwnedSemaphorePermit, Problem> {
        let permit = self.permits.clone().acquire_owned().await;
        permit.map_err(|_| Problem::new(&INTERNAL_ERROR, "the service is stopping; try again later"))
    }
}

impl Validator {
    pub(super) fn new(limits: &Limits) -> Result<Self, ThreadPoolBuildError> {
        Ok(Self {
            small: Lane::new("small-validator", limits.validations, limits.small_mesh())?,
            large: Lane::new("validator", limits.validations, limits.mesh)?,
        })
    }

    /// Waits until a mesh whose file has so many bytes may be loaded. It has its `place` among the uploads as long as it may
    /// have to wait.
    pub(super) async fn turn<P>(&self, bytes: u64, place: P) -> Result<Turn<P>, Problem> {
        let is_small = bytes <= SMALL_FILE;
        let permit = if is_small { self.small.permit().await } else { self.large.permit().await }?;
        Ok(Turn { permit, small: is_small.then_some(place) })
    }

    /// The mesh's format, if it can be read and the points of `parameters` are near it.
    pub(super) async fn check<P>(
        &self,
        turn: Turn<P>,
        bytes: Bytes,
        hint: FormatHint,
        parameters: Parameters,
    ) -> Result<Format, Problem> {
        self.read(turn, bytes, hint, parameters, |_, format| format).await
    }

    /// The mesh as a job would find it, under the same conditions.
    pub(super) async fn inspect<P>(
        &self,
        turn: Turn<P>,
        bytes: Bytes,
        hint: FormatHint,
        parameters: Parameters,
        sha256: String,
    ) -> Result<Inspection, Problem> {
        let size = bytes.len() as u64;
        let then = move |mesh: TriangleMesh, format| Inspection::new(&mesh, format, &sha256, size);
        self.read(turn, bytes, hint, parameters, then).await
    }

    /// Whether a small mesh that has too many of `what` has so for a large one too.
    fn is_final(&self, what: &str) -> bool {
        let (small, large) = (self.small.limits, self.large.limits);
        match what {
            "vertices" => small.vertices == large.vertices,
            "triangles" | "faces" => small.triangles == large.triangles,
            // Of them there is one bound for all.
            "primitives" => true,
            _ => small.decoded_bytes == large.decoded_bytes,
        }
    }

    /// Reads the mesh and goes on with `then`; one that turns out to be large waits for the turn of such a one first.
    async fn read<T: Send + 'static, P>(
        &self,
        turn: Turn<P>,
        bytes: Bytes,
        hint: FormatHint,
        parameters: Parameters,
        then: impl FnOnce(TriangleMesh, Format) -> T + Clone + Send + 'static,
    ) -> Result<T, Problem> {
        let mut permit = turn.permit;
        if let Some(place) = turn.small {
            let then = then.clone();
            match self.small.read(permit, bytes.clone(), hint.clone(), parameters.clone(), then).await {
                Ok(Err(ReadError::TooLarge { what, .. })) if !self.is_final(what) => {
                    permit = self.large.permit().await?;
                }
                outcome => return outcome?.map_err(|error| refusal(&error))?,
            }
            drop(place);
        }
        self.large.read(permit, bytes, hint, parameters, then).await?.map_err(|error| refusal(&error))?
    }
}

impl Lane {
    /// On a thread of its own.
    async fn read<T: Send + 'static>(
        &self,
        permit: OwnedSemaphorePermit,
        bytes: Bytes,
        hint: FormatHint,
        parameters: Parameters,
        then: impl FnOnce(TriangleMesh, Format) -> T + Send + 'static,
    ) -> Result<Result<Result<T, Problem>, ReadError>, Problem> {
        let (answer, outcome) = oneshot::channel();
        let limits = self.limits;
        self.pool.spawn(move || {
            let read = || {
                let hint =
                    Hint { extension: hint.extension.as_deref(), content_type: hint.content_type.as_deref() };
                let read = format::read(&bytes, hint, &limits);
                let (mesh, format) = read.map_err(|error| named(error, &bytes))?;
                drop(bytes);
                Ok(check_reach(&mesh, &parameters).map(|()| then(mesh, format)))
            };
            let outcome: Result<Result<Result<T, ExtractError>, ReadError>, _> =
                catch_unwind(AssertUnwindSafe(read));
            drop(permit);
            // Nobody listens any more when the client has left.
            let _ = answer.send(outcome);
        });
        match outcome.await {
            Ok(Ok(read)) => Ok(read.map(|found| found.map_err(|error| far_off(&error)))),
            Ok(Err(_)) | Err(_) => {
                Err(Problem::new(&INTERNAL_ERROR, "the mesh's reader stopped on an internal error"))
            }
        }
    }
}

/// The error, or that the bytes are a result of this service's own, sent back by mistake.
fn named(error: ReadError, bytes: &[u8]) -> ReadError {
    let advice = "send the mesh that it was made from";
    let result = ReadError::Unsupported { found: "a centerline, the result of an extraction", advice };
    if output::is_result(bytes) { result } else { error }
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
    use super::super::limits::SMALL_MESH;
    use super::*;

    #[test]
    fn problems_use_the_readers_words() {
        let errors = [
            ReadError::Empty,
            ReadError::Unsupported { found: "x", advice: "y" },
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
            let turn = validator.turn(16, ()).await.unwrap();
            let bytes = Bytes::from_static(b"\x89PNG\r\n\x1a\n....");
            let problem =
                validator.check(turn, bytes, FormatHint::default(), Parameters::default()).await.unwrap_err();
            assert_eq!(problem.status(), 415);
        }
    }

    #[test]
    fn what_is_to_be_done_stands_behind_what_was_found() {
        let said = |bytes: &[u8]| {
            let read = format::read(bytes, Hint::default(), &format::Limits::default());
            read.unwrap_err().to_string()
        };
        let gzip = said(b"\x1f\x8b\x08\0\0\0\0\0\0\x03");
        assert_eq!(
            gzip,
            "this is gzip-compressed data, not a mesh that is read here; unpack it first and send the mesh itself"
        );
        assert!(
            said(b"\x89PNG\r\n\x1a\n....")
                .starts_with("this is a PNG picture, not a mesh that is read here; send STL")
        );
    }

    /// The check of an OBJ file with so many times the same triangle.
    async fn checked(validator: &Validator, triangles: usize, place: Arc<()>) -> Result<Format, Problem> {
        let text = ["v 0 0 0\nv 1 0 0\nv 0 1 0\n", &"f 1 2 3\n".repeat(triangles)].concat();
        let turn = validator.turn(text.len() as u64, place).await?;
        validator.check(turn, text.into(), FormatHint::default(), Parameters::default()).await
    }

    #[tokio::test]
    async fn a_small_mesh_waits_for_no_large_one() {
        let validator = Validator::new(&Limits { validations: 1, ..Limits::default() }).unwrap();
        // A large one has the only turn, and keeps the only thread busy.
        let turn = validator.turn(SMALL_FILE + 1, ()).await.unwrap();
        let (go_on, wait) = std::sync::mpsc::channel::<()>();
        validator.large.pool.spawn(move || while wait.recv().is_ok() {});
        let place = Arc::new(());
        assert!(checked(&validator, 10, place.clone()).await.is_ok());
        // A small file of many triangles is a large mesh, and has its place until its turn comes.
        let mut many = std::pin::pin!(checked(&validator, SMALL_MESH + 1, place.clone()));
        let soon = std::time::Duration::from_millis(500);
        assert!(tokio::time::timeout(soon, many.as_mut()).await.is_err(), "it waits for its turn");
        assert_eq!(Arc::strong_count(&place), 2);
        drop((turn, go_on));
        assert!(many.await.is_ok());
    }

    /// It would be read twice for the same answer.
    #[tokio::test]
    async fn what_is_too_large_for_the_service_waits_for_no_large_one() {
        let mesh = format::Limits::of_triangles(1000);
        let validator = Validator::new(&Limits { validations: 1, mesh, ..Limits::default() }).unwrap();
        let _turn = validator.turn(SMALL_FILE + 1, ()).await.unwrap();
        let soon = std::time::Duration::from_secs(60);
        let many = tokio::time::timeout(soon, checked(&validator, 1001, Arc::new(()))).await;
        assert_eq!(many.unwrap().unwrap_err().status(), 413);
        let header = "OFF\n3 1001 0\n0 0 0\n1 0 0\n0 1 0\n";
        let points: String = (0..600).map(|x| format!("v {x} 0 0\nv {x} 1 0\n")).collect();
        let faces: String = (1..900).map(|at| format!("f {at} {} {}\n", at + 1, at + 2)).collect();
        for text in [format!("{header}{}", "3 0 1 2\n".repeat(1001)), [points, faces].concat()] {
            let turn = validator.turn(text.len() as u64, ()).await.unwrap();
            let check = validator.check(turn, text.into(), FormatHint::default(), Parameters::default());
            assert_eq!(tokio::time::timeout(soon, check).await.unwrap().unwrap_err().status(), 413);
        }
    }
}
