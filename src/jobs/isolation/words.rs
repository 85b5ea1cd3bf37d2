//! What the service and the process of a run say to each other: a line of JSON each, bytes behind some.

use std::num::NonZeroU64;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::jobs::runner::Work;
use crate::jobs::{FileName, FormatHint, JobFailure, JobSpec, ParameterValues, StoredInput};
use crate::mesh::Units;
use crate::mesh::format::Limits;

/// Bytes of a line at most: a job's points may be many.
pub(super) const LONGEST_LINE: u64 = 1 << 20;

/// What is to be done, to the child; the mesh's bytes follow.
///
/// On a pipe and not among the arguments, which other users of the machine may see.
#[derive(Serialize, Deserialize)]
pub(super) struct Order {
    /// Bytes of the mesh.
    pub(super) size: u64,
    sha256: String,
    extension: Option<String>,
    content_type: Option<String>,
    name: Option<String>,
    units: String,
    parameters: ParameterValues,
    /// Bytes that the run may have.
    pub(super) memory: NonZeroU64,
    pub(super) threads: usize,
    vertices: usize,
    triangles: usize,
    decoded_bytes: usize,
    expansion: usize,
}

impl Order {
    /// On as many threads as the calling pool has.
    pub(super) fn new(work: &Work, memory: NonZeroU64, limits: &Limits) -> Self {
        let Work { input, bytes, spec } = work;
        Self {
            size: bytes.len() as u64,
            sha256: input.sha256.clone(),
            extension: spec.hint.extension.clone(),
            content_type: spec.hint.content_type.clone(),
            name: spec.name.as_ref().map(|name| name.expose().to_owned()),
            units: spec.units.name().to_owned(),
            parameters: spec.parameters.clone(),
            memory,
            threads: rayon::current_num_threads(),
            vertices: limits.vertices,
            triangles: limits.triangles,
            decoded_bytes: limits.decoded_bytes,
            expansion: limits.expansion,
        }
    }

    pub(super) fn line(&self) -> Vec<u8> {
        line(self)
    }

    pub(super) fn limits(&self) -> Limits {
        let Self { vertices, triangles, decoded_bytes, expansion, .. } = *self;
        Limits { vertices, triangles, decoded_bytes, expansion }
    }

    /// The work, of which `bytes` is the mesh.
    pub(super) fn work(self, bytes: Vec<u8>) -> Work {
        let spec = JobSpec {
            hint: FormatHint { extension: self.extension, content_type: self.content_type },
            name: self.name.map(FileName::new),
            // Written from a unit.
            units: Units::from_str(&self.units).unwrap_or_default(),
            parameters: self.parameters,
            ..JobSpec::default()
        };
        let input = StoredInput { key: String::new(), size: self.size, sha256: self.sha256 };
        Work { input, bytes: bytes.into(), spec }
    }
}

/// What the child says.
#[derive(Serialize, Deserialize)]
pub(super) enum Word {
    /// The order and the mesh are here.
    Begun,
    Report {
        stage: String,
        fraction: f64,
        before: f64,
        share: f64,
    },
    /// A form of the result; its bytes follow.
    Artifact {
        format: String,
        size: u64,
    },
    Failed(JobFailure),
    /// By its place in the source alone: the message may quote the mesh.
    Panicked {
        place: String,
    },
    /// Every artifact was told.
    Done,
}

/// A line of JSON.
pub(super) fn line(word: &impl Serialize) -> Vec<u8> {
    // Strings and numbers under string keys always serialise; an empty line would be no word.
    let mut line = serde_json::to_vec(word).unwrap_or_default();
    line.push(b'\n');
    line
}
