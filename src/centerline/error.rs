//! Why a surface has no centerline.

/// Each variant says what was found and what to do.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ExtractError {
    #[error("the mesh has no triangles; send a surface, not a point cloud or a line set")]
    NoTriangles,
    #[error("all {triangles} triangles have no area; check the unit and the exporter of the mesh")]
    AllDegenerate { triangles: usize },
    #[error(
        "the rest of the mesh has no size beside {count} of its vertices, so far out do they lie (vertex {first}); repair \
         them and export the mesh again"
    )]
    FarOut { count: usize, first: String },
    #[error(
        "{count} vertices have a coordinate that is not a finite number (vertex {first}); export the mesh again"
    )]
    NotFinite { count: usize, first: String },
    #[error("{count} triangles name a vertex that is not there (triangle {first}); export the mesh again")]
    OutOfRange { count: usize, first: String },
    #[error("the surface is no vessel ({detail}); a centerline needs a tubular surface")]
    NotTubular { detail: String },
    #[error("the surface is undersampled past use: {detail}; re-mesh it with shorter edges")]
    Undersampled { detail: String },
    #[error("the surface's diagonal is {diagonal:e}, out of 1e-30 to 1e30; scale the mesh")]
    OutOfScale { diagonal: f64 },
    #[error(
        "point {number} of {name} lies {distance} from the nearest vertex, farther than {most}; give points on the surface"
    )]
    OffSurface { name: &'static str, number: usize, distance: f64, most: f64 },
    #[error("the extraction was cancelled")]
    Cancelled,
}

impl ExtractError {
    /// A stable word for logs and API problem types.
    pub fn code(&self) -> &'static str {
        match self {
            ExtractError::NoTriangles => "no-triangles",
            ExtractError::AllDegenerate { .. } => "all-degenerate",
            ExtractError::FarOut { .. } => "far-out",
            ExtractError::NotFinite { .. } => "not-finite",
            ExtractError::OutOfRange { .. } => "out-of-range",
            ExtractError::NotTubular { .. } => "not-tubular",
            ExtractError::Undersampled { .. } => "undersampled",
            ExtractError::OutOfScale { .. } => "out-of-scale",
            ExtractError::OffSurface { .. } => "off-surface",
            ExtractError::Cancelled => "cancelled",
        }
    }
}
