//! The run of a real job: read the mesh, extract its centerline, write every output format.

use super::runner::{Artifact, JobRunner, RunControl, Work};
use super::{FileName, FormatHint, JobFailure, JobStage};
use crate::centerline::{CancelToken, Control, ExtractError, Parameters, Part, Progress, extract};
use crate::mesh::format::{Hint, Limits, ReadError, ReadErrorKind, read};
use crate::output::{OutputError, OutputFormat, ResultDocument, Source, write};

/// Extracts centerlines. The same input and parameters give the same bytes.
#[derive(Debug, Clone, Default)]
pub struct Extraction {
    limits: Limits,
}

impl Extraction {
    /// Refuses meshes beyond `limits`.
    pub fn new(limits: Limits) -> Self {
        Self { limits }
    }
}

impl JobRunner for Extraction {
    fn run(&self, work: Work, control: &RunControl) -> Result<Vec<Artifact>, JobFailure> {
        self.perform(work, control.cancel(), &|stage, fraction, part| {
            control.report_part(stage, fraction, part)
        })
    }
}

impl Extraction {
    /// [`JobRunner::run`] without a queue.
    pub(super) fn perform(
        &self,
        work: Work,
        cancel: &CancelToken,
        report: &(dyn Fn(JobStage, f64, Part) + Sync),
    ) -> Result<Vec<Artifact>, JobFailure> {
        let Work { input, bytes, spec } = work;
        let parameters = Parameters::try_from(&spec.parameters)
            .map_err(|error| JobFailure::stale_parameters(error.to_string()))?;
        let (mesh, format) =
            read(&bytes, hint(&spec.hint), &self.limits).map_err(|error| unreadable(&error))?;
        drop(bytes);
        let progress = |Progress { stage, fraction, part }: Progress| {
            report(JobStage::Method(stage), fraction, part);
        };
        let inside = Control::new(cancel.clone(), &progress);
        let extraction = extract(&mesh, &parameters, &inside).map_err(|error| impossible(&error))?;
        drop(mesh);
        report(JobStage::Writing, 0.0, Part::WHOLE);
        let source = Source {
            name: spec.name.as_ref().map(FileName::expose),
            format: format.name(),
            sha256: &input.sha256,
            units: spec.units,
        };
        let document = ResultDocument::new(&extraction, &source, &parameters);
        OutputFormat::ALL.into_iter().map(|format| artifact(&document, format)).collect()
    }
}

fn hint(hint: &FormatHint) -> Hint<'_> {
    Hint { extension: hint.extension.as_deref(), content_type: hint.content_type.as_deref() }
}

fn artifact(document: &ResultDocument, format: OutputFormat) -> Result<Artifact, JobFailure> {
    let bytes = write(document, format).map_err(|error| unwritable(&error))?;
    Ok(Artifact { format, bytes })
}

/// The reader's failure as a job's.
fn unreadable(error: &ReadError) -> JobFailure {
    let (status, title) = match error.kind() {
        ReadErrorKind::Unsupported => (415, "The file is not a mesh that is read here"),
        ReadErrorKind::Malformed | ReadErrorKind::Empty => (400, "The mesh file is damaged"),
        ReadErrorKind::Unprocessable => (422, "The mesh file holds no usable surface"),
        ReadErrorKind::TooLarge => (413, "The mesh is larger than the service takes"),
    };
    JobFailure::new(error.code(), status, title, error.to_string())
}

/// The method's failure as a job's.
fn impossible(error: &ExtractError) -> JobFailure {
    JobFailure::new(error.code(), 422, "The mesh has no centerline", error.to_string())
}

/// The writer's failure as a job's.
fn unwritable(error: &OutputError) -> JobFailure {
    let title = "The centerline cannot be written";
    match error {
        OutputError::TooLarge { .. } | OutputError::TooLong { .. } => {
            JobFailure::new("result-too-large", 422, title, error.to_string())
        }
        _ => JobFailure::new("internal-error", 500, title, error.to_string()),
    }
}
