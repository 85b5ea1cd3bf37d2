//! What a dry run answers: the surface and every defect of it, without its centerline.

use serde::Serialize;
use utoipa::ToSchema;

use crate::centerline::DIAGONALS;
use crate::mesh::TriangleMesh;
use crate::mesh::format::Format;
use crate::mesh::preparation::{PreparationError, PreparationReport, Prepared, Sites, Surface, prepare};

/// A mesh as a job would find it.
#[derive(Debug, Serialize, ToSchema)]
#[schema(title = "Inspection")]
pub struct Inspection {
    /// Whether a job would go on to extract; what is `repaired` does not stand in its way. Whether the surface is a vessel
    /// (`not-tubular`, `undersampled`) only a job finds out.
    acceptable: bool,
    /// The format that the reader found the content to be.
    #[schema(example = "stl")]
    format: &'static str,
    /// SHA-256 of the mesh's bytes, in lower-case hexadecimal.
    #[schema(min_length = 64, max_length = 64)]
    sha256: String,
    bytes: u64,
    /// After equal ones were joined.
    vertices: usize,
    triangles: usize,
    /// Connected surfaces, after repair.
    components: usize,
    /// Sum over the components, openings capped.
    genus: usize,
    /// Boundary loops: no defect, a vessel may be cut open.
    openings: usize,
    /// Diagonal of the bounding box, in the mesh's own unit.
    diagonal: f64,
    /// Every kind of defect that was found.
    defects: Vec<Defect>,
}

/// One kind of defect.
#[derive(Debug, Serialize, ToSchema)]
pub struct Defect {
    /// A stable word, that of the result's warning where there is one.
    #[schema(example = "duplicate-triangles")]
    code: &'static str,
    /// How many there are.
    count: usize,
    /// What `indices` number: `triangle`, `vertex`, or `component`.
    #[schema(example = "triangle")]
    of: &'static str,
    /// Numbers of the first 24, from 0, in the order of the file; of an edge, a triangle beside it.
    indices: Vec<u32>,
    /// Whether a job repairs it and goes on.
    repaired: bool,
    /// For people.
    detail: &'static str,
}

impl Inspection {
    /// Of a mesh that was read; prepares it as a job does.
    pub(super) fn new(mesh: &TriangleMesh, format: Format, sha256: &str, bytes: u64) -> Self {
        let prepared = prepare(mesh);
        let (acceptable, defects) = match &prepared {
            Ok(prepared) => {
                let fits = DIAGONALS.contains(&prepared.report.diagonal);
                let out = (!fits).then(|| out_of_scale(mesh.vertices.len()));
                (fits, repaired(&prepared.report).into_iter().chain(out).collect())
            }
            Err(error) => (false, vec![fatal(error, mesh.vertices.len())]),
        };
        let Prepared { components, report } = prepared.unwrap_or_default();
        Self {
            acceptable,
            format: format.name(),
            sha256: sha256.to_owned(),
            bytes,
            vertices: mesh.vertices.len(),
            triangles: mesh.triangles.len(),
            components: components.len(),
            genus: components.iter().map(Surface::genus).sum(),
            openings: components.iter().map(Surface::open_cuts).sum(),
            diagonal: report.diagonal,
            defects,
        }
    }
}

fn repaired(report: &PreparationReport) -> Vec<Defect> {
    let found = |code, sites: Sites, of, detail| Defect {
        code,
        count: sites.count,
        of,
        indices: sites.indices().to_vec(),
        repaired: true,
        detail,
    };
    let matching = &report.matching;
    let mut defects = vec![
        found(
            "snapped-vertices",
            report.snapped_vertices,
            "vertex",
            "it lies within a millionth of the diagonal of another of a mesh in pieces; made one with it",
        ),
        found("degenerate-triangles", report.degenerate, "triangle", "two corners are equal; left out"),
        found("duplicate-triangles", report.duplicates, "triangle", "it repeats another; left out"),
        found("flipped-triangles", matching.flipped, "triangle", "wound against its neighbours; turned"),
        found(
            "non-manifold-edges",
            matching.non_manifold_edges,
            "triangle",
            "an edge has more than two triangles; the surface is taken apart there",
        ),
        found(
            "conflicting-edges",
            matching.conflicting_edges,
            "triangle",
            "an edge has no consistent orientation; the surface is cut there",
        ),
        found("split-vertices", report.split_vertices, "vertex", "the surface touches itself there; doubled"),
        found("holes-closed", report.holes, "vertex", "a hole in the wall, where no vessel was cut; closed"),
        found("internal-cavities", report.cavities, "vertex", "a closed surface inside another; left out"),
    ];
    defects.push(Defect {
        code: "inverted-components",
        count: report.inverted_components,
        of: "component",
        indices: Vec::new(),
        repaired: true,
        detail: "its normals point inward; turned",
    });
    defects.retain(|defect| defect.count > 0);
    defects
}

/// What a job fails with before it looks for a line.
fn out_of_scale(vertices: usize) -> Defect {
    Defect {
        code: "out-of-scale",
        count: vertices,
        of: "vertex",
        indices: Vec::new(),
        repaired: false,
        detail: "the surface's diagonal is out of 1e-30 to 1e30; scale the mesh",
    }
}

/// What a job would fail with.
fn fatal(error: &PreparationError, vertices: usize) -> Defect {
    let (code, count, of, sites, detail) = match error {
        PreparationError::OutOfScale { .. } => return out_of_scale(vertices),
        PreparationError::NoTriangles => ("no-triangles", 0, "triangle", None, "there are no triangles"),
        PreparationError::AllDegenerate { triangles } => {
            ("all-degenerate", *triangles, "triangle", None, "no triangle has an area")
        }
        PreparationError::FarOut(sites) => {
            let detail = "it lies so far out that the rest of the mesh has no size beside it";
            ("far-out", sites.count, "vertex", Some(sites), detail)
        }
        PreparationError::NotFinite(sites) => {
            ("not-finite", sites.count, "vertex", Some(sites), "a coordinate is not a finite number")
        }
        PreparationError::OutOfRange(sites) => {
            ("out-of-range", sites.count, "triangle", Some(sites), "it names a vertex that is not there")
        }
    };
    let indices = sites.map(|sites| sites.indices().to_vec()).unwrap_or_default();
    Defect { code, count, of, indices, repaired: false, detail }
}
