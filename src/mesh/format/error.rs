//! Why a file could not be read.

use super::Format;

/// Classes of failure, by what the sender can do about them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ReadErrorKind {
    /// Not a mesh format that is read here.
    Unsupported,
    /// A known format whose bytes break its rules.
    Malformed,
    /// Well formed, yet not a surface that can be worked on.
    Unprocessable,
    /// Declares or contains more than the limits allow.
    TooLarge,
    /// No bytes at all.
    Empty,
}

/// Says what was found, with its index or offset, and what to do.
///
/// No variant carries text out of the file: names and comments in a mesh are patient data.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ReadError {
    #[error("the file is empty; send the bytes of a mesh")]
    Empty,
    #[error("this is {found}, not a mesh that is read here; {advice}")]
    Unsupported { found: &'static str, advice: &'static str },
    #[error("the {format} file ends early: {detail}; send the whole file again")]
    Truncated { format: Format, detail: String },
    #[error("the {format} file is malformed: {detail}; export the mesh again")]
    Malformed { format: Format, detail: String },
    #[error(
        "vertex {vertex} of the {format} file has a coordinate that is not a finite number; repair the mesh and export it again"
    )]
    NonFinite { format: Format, vertex: usize },
    #[error(
        "face {face} of the {format} file refers to vertex {index} of {vertices}; repair the mesh and export it again"
    )]
    IndexOutOfRange { format: Format, face: usize, index: i64, vertices: usize },
    #[error("the {format} file holds no polygons{instead}; export the surface itself as polygons")]
    NoPolygons { format: Format, instead: &'static str },
    #[error("the {format} file uses {feature}, which is not read here; {advice}")]
    UnsupportedFeature { format: Format, feature: &'static str, advice: &'static str },
    #[error(
        "the {format} file has {found} {what}, more than the limit of {limit}; send a coarser mesh or raise the limit"
    )]
    TooLarge { format: Format, what: &'static str, found: u64, limit: u64 },
}

/// The advice where what was found says no more than that it is something else.
pub(super) const SEND_A_MESH: &str = "send STL, OBJ, PLY, glTF, GLB, VTP, legacy VTK polydata or OFF";
/// The advice where the surface may be in the file, among what is no surface.
pub(super) const EXTRACT_THE_SURFACE: &str = "extract the surface, save that and send it";

impl ReadError {
    pub fn kind(&self) -> ReadErrorKind {
        match self {
            ReadError::Empty => ReadErrorKind::Empty,
            ReadError::Unsupported { .. } => ReadErrorKind::Unsupported,
            ReadError::Truncated { .. } | ReadError::Malformed { .. } => ReadErrorKind::Malformed,
            ReadError::NonFinite { .. }
            | ReadError::IndexOutOfRange { .. }
            | ReadError::NoPolygons { .. }
            | ReadError::UnsupportedFeature { .. } => ReadErrorKind::Unprocessable,
            ReadError::TooLarge { .. } => ReadErrorKind::TooLarge,
        }
    }

    /// A stable word for logs and API problem types.
    pub fn code(&self) -> &'static str {
        match self {
            ReadError::Empty => "empty",
            ReadError::Unsupported { .. } => "unsupported-format",
            ReadError::Truncated { .. } => "truncated",
            ReadError::Malformed { .. } => "malformed",
            ReadError::NonFinite { .. } => "non-finite-coordinate",
            ReadError::IndexOutOfRange { .. } => "index-out-of-range",
            ReadError::NoPolygons { .. } => "no-polygons",
            ReadError::UnsupportedFeature { .. } => "unsupported-feature",
            ReadError::TooLarge { .. } => "too-large",
        }
    }
}
