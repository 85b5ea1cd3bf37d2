//! Writers of results, one file a format.
//!
//! [`ResultDocument`] is the result as the user sees it; [`write`] turns it into bytes, the
//! same bytes for the same document. The other writers start from the document too, so a
//! stored JSON result is enough to serve every format.

mod document;
mod gltf;
mod json;
mod parameters;
mod quality;
mod schemas;
mod vtp;

pub use document::{
    BranchRecord, KindRecord, MethodRecord, NodeRecord, ResultDocument, SCHEMA, Source, SourceRecord,
    WarningRecord,
};
pub use gltf::{write_glb, write_gltf};
pub use json::{is_result, read_json, write_json};
pub use parameters::ParameterValue;
pub use quality::{CenterednessRecord, HomotopyRecord, QualityRecord};
pub use vtp::write_vtp;

/// The formats a result is served in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum OutputFormat {
    Json,
    Glb,
    Gltf,
    Vtp,
}

impl OutputFormat {
    /// Every format, the preferred one first.
    pub const ALL: [OutputFormat; 4] =
        [OutputFormat::Json, OutputFormat::Glb, OutputFormat::Gltf, OutputFormat::Vtp];

    /// The file name extension, without the dot.
    pub fn extension(self) -> &'static str {
        match self {
            OutputFormat::Json => "json",
            OutputFormat::Glb => "glb",
            OutputFormat::Gltf => "gltf",
            OutputFormat::Vtp => "vtp",
        }
    }

    /// The media type: IANA's, where there is one.
    pub fn media_type(self) -> &'static str {
        match self {
            OutputFormat::Json => "application/json",
            OutputFormat::Glb => "model/gltf-binary",
            OutputFormat::Gltf => "model/gltf+json",
            OutputFormat::Vtp => "model/vtk",
        }
    }

    /// The format of a file name extension, in any case.
    pub fn from_extension(extension: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|format| format.extension().eq_ignore_ascii_case(extension))
    }
}

/// Writes a result in a format.
///
/// # Errors
/// [`OutputError`] when the document holds a number that the format cannot.
pub fn write(document: &ResultDocument, format: OutputFormat) -> Result<Vec<u8>, OutputError> {
    match format {
        OutputFormat::Json => write_json(document),
        OutputFormat::Glb => write_glb(document),
        OutputFormat::Gltf => write_gltf(document),
        OutputFormat::Vtp => write_vtp(document),
    }
}

/// Why a result cannot be written or read back.
#[derive(Debug, thiserror::Error)]
pub enum OutputError {
    #[error("the result has a number that is not finite in {place}; the extraction that made it is at fault")]
    NotFinite { place: String },
    #[error("the result has no branch, and glTF cannot hold an empty line; ask for JSON")]
    Empty,
    #[error(
        "{place} does not fit a 32-bit float as glTF needs it; ask for JSON, or change the unit of the mesh"
    )]
    TooLarge { place: String },
    #[error("the result of {bytes} bytes is longer than the 4 GiB that a GLB can hold; ask for JSON")]
    TooLong { bytes: usize },
    #[error("this is not a {SCHEMA} document: {0}")]
    Json(#[from] serde_json::Error),
    #[error("this is not a {SCHEMA} document: its schema is '{found}'")]
    Schema { found: String },
    #[error("the document contradicts itself: {detail}")]
    Inconsistent { detail: String },
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn extensions_name_their_formats_in_any_case() {
        for format in OutputFormat::ALL {
            assert_eq!(OutputFormat::from_extension(format.extension()), Some(format));
        }
        assert_eq!(OutputFormat::from_extension("GLB"), Some(OutputFormat::Glb));
        assert_eq!(OutputFormat::from_extension("stl"), None);
    }
}
