//! The method: a mesh and parameters in, a centerline or a typed error out.
//!
//! No I/O, no clock, no global state. The caller's rayon pool is used.

mod component;
mod connection;
mod control;
mod cut_plane;
mod equivalent_radius;
mod error;
mod graph;
mod laplacian_smoothing;
mod line_tree;
mod orientation;
mod own_sections;
mod parameters;
mod point_grid;
mod preset_default;
mod preset_paper;
mod quality;
mod ray;
mod recentering;
mod segmentation;
#[cfg(test)]
mod shapes;
mod smoothing_filter;
#[cfg(test)]
mod test_surfaces;
mod thinning;
mod tips;
mod triangle_grid;

pub use control::{CancelToken, Control, Part, Progress, Stage};
pub use error::ExtractError;
pub use graph::{Branch, Centerline, Extraction, Node, NodeKind, SurfaceSummary, Warning};
pub use parameters::{
    POINTS, ParameterError, ParameterKind, ParameterSpec, Parameters, PointsSpec, Preset, TABLE,
};
pub use quality::{Centeredness, Homotopy, Quality};

use crate::mesh::TriangleMesh;
use crate::mesh::preparation::{
    PreparationError, PreparationReport, Prepared, Sites, Surface, prepare_while,
};
use component::ComponentGraph;
use line_tree::LineTree;
use own_sections::own_sections;
use quality::{Line, Measured};
use tips::picks;
use triangle_grid::TriangleGrid;

/// A component smaller than this share of the largest one's diagonal is a speck of the segmentation.
const SPECK: f64 = 0.02;

/// Extracts the centerline of a vessel surface, component by component.
///
/// `mesh` is welded (see [`crate::mesh::format::read`]); unit and frame of the result are its own.
///
/// # Errors
/// [`ExtractError`] when the surface cannot have a centerline, or when `control` was cancelled.
pub fn extract(
    mesh: &TriangleMesh,
    parameters: &Parameters,
    control: &Control<'_>,
) -> Result<Extraction, ExtractError> {
    control.report(Stage::Preparation, 0.0)?;
    let mut prepared = prepare_while(mesh, || control.cancel.check())?;
    control.report(Stage::Preparation, 1.0)?;
    let diagonal = prepared.report.diagonal;
    // Lengths are kept in single precision on the way, squares in double.
    if !(1e-30..=1e30).contains(&diagonal) {
        return Err(ExtractError::OutOfScale { diagonal });
    }
    let mut extraction = Extraction { surface: summary(&prepared), ..Extraction::default() };
    extraction.warnings = repair_warnings(&prepared.report);
    let mut measured = Measured::default();
    let mut refusal = None;
    let mut specks = 0;
    let parts = parts(&prepared.components);
    let taken = prepared.components.iter().zip(&parts).map(|(surface, part)| part.as_ref().map(|_| surface));
    let picks = picks::place(&taken.collect::<Vec<_>>(), diagonal, parameters, &control.cancel)?;
    let mut graphs: Vec<ComponentGraph> = Vec::new();
    for (index, ((surface, part), picks)) in prepared.components.iter_mut().zip(parts).zip(&picks).enumerate()
    {
        let Some(part) = part else {
            specks += 1;
            continue;
        };
        let control = &control.of_part(part);
        if parameters.smoothing() {
            // The cuts stay where they are.
            let openings = surface.openings.iter();
            let cuts: Vec<u32> = openings.flat_map(|o| o.rim.iter().copied().chain([o.centre])).collect();
            smoothing_filter::smooth(&mut surface.mesh, &cuts, control)?;
        }
        let grid = TriangleGrid::new(surface);
        let found = match parameters.preset() {
            Preset::Default => preset_default::extract_component(&grid, parameters, picks, control),
            Preset::Paper => preset_paper::extract_component(surface, diagonal, parameters, picks, control),
        };
        match found {
            Ok(mut graph) => {
                if let Some(root) = picks.root {
                    orientation::tell_from(&mut graph, &surface.mesh.vertices[root.vertex as usize]);
                }
                extraction.warnings.extend(settle_and_measure(&mut measured, index, &grid, &mut graph));
                // The root's component comes first, so that the root is the first node of all.
                graphs.insert(if picks.root.is_some() { 0 } else { graphs.len() }, graph);
            }
            Err(ExtractError::Cancelled) => return Err(ExtractError::Cancelled),
            Err(error) => {
                let detail = format!("component {index} has no centerline: {error}");
                extraction.warnings.push(Warning { code: "component-skipped", detail });
                refusal = Some(error);
            }
        }
    }
    if specks > 0 {
        let detail = format!("{specks} components smaller than {SPECK} of the largest were left out");
        extraction.warnings.push(Warning { code: "specks-skipped", detail });
    }
    graphs.into_iter().for_each(|graph| append(&mut extraction, graph));
    extraction.quality = measured.quality();
    match refusal {
        Some(error) if extraction.centerline.branches.is_empty() => Err(error),
        _ => Ok(extraction),
    }
}

/// Sets the equivalent radii of a component's line and measures how good it is; returns the warnings of what fails.
fn settle_and_measure(
    measured: &mut Measured,
    index: usize,
    grid: &TriangleGrid<'_>,
    graph: &mut ComponentGraph,
) -> Vec<Warning> {
    let (surface, tree) = (grid.surface(), LineTree::new(graph));
    let sections = own_sections(surface, grid, &tree, graph);
    equivalent_radius::settle(graph, &sections);
    measured.add(index, Line { surface, grid, graph, tree: &tree, sections: &sections })
}

/// The part of the work that each component is, by its vertices; `None` for specks.
fn parts(components: &[Surface]) -> Vec<Option<Part>> {
    let largest = components.iter().map(Surface::diagonal).fold(0.0, f64::max);
    let is_speck = |surface: &Surface| surface.diagonal() < SPECK * largest;
    let vertices = |surface: &Surface| surface.mesh.vertices.len() as f64;
    let total: f64 = components.iter().filter(|surface| !is_speck(surface)).map(vertices).sum();
    let mut before = 0.0;
    let mut part = |surface: &Surface| {
        let part = Part { before, share: vertices(surface) / total };
        before += part.share;
        part
    };
    components.iter().map(|surface| (!is_speck(surface)).then(|| part(surface))).collect()
}

fn summary(prepared: &Prepared) -> SurfaceSummary {
    SurfaceSummary {
        vertices: prepared.report.vertices,
        triangles: prepared.report.triangles,
        components: prepared.components.len(),
        genus: prepared.components.iter().map(Surface::genus).sum(),
        openings: prepared.components.iter().map(|surface| surface.openings.len()).sum(),
        diagonal: prepared.report.diagonal,
    }
}

/// Repairs that a user should know of, with their counts and the numbers of the first.
fn repair_warnings(report: &PreparationReport) -> Vec<Warning> {
    let found = [
        (
            "degenerate-triangles",
            report.degenerate,
            "triangles with two equal corners were left out",
            "triangle",
        ),
        ("duplicate-triangles", report.duplicates, "triangles that repeat another were left out", "triangle"),
        (
            "flipped-triangles",
            report.matching.flipped,
            "triangles were turned to agree with their neighbours",
            "triangle",
        ),
        (
            "non-manifold-edges",
            report.matching.non_manifold_edges,
            "edges have more than two triangles; the surface was taken apart there",
            "an edge of triangle",
        ),
        (
            "conflicting-edges",
            report.matching.conflicting_edges,
            "edges have no consistent orientation; the surface was cut there",
            "an edge of triangle",
        ),
        (
            "split-vertices",
            report.split_vertices,
            "vertices where the surface touches itself were doubled",
            "vertex",
        ),
    ];
    let warn = |(code, sites, text, site): (&'static str, Sites, &str, &str)| Warning {
        code,
        detail: format!("{sites} {text}: {site} {}", sites.list()),
    };
    let mut warnings: Vec<Warning> = found.into_iter().filter(|entry| entry.1.count > 0).map(warn).collect();
    if report.inverted_components > 0 {
        let detail =
            format!("{} components had their normals inward and were turned", report.inverted_components);
        warnings.push(Warning { code: "inverted-components", detail });
    }
    warnings
}

/// Adds a component's graph, its nodes after those already there.
fn append(extraction: &mut Extraction, graph: ComponentGraph) {
    let offset = extraction.centerline.nodes.len();
    extraction.centerline.nodes.extend(graph.nodes);
    extraction.centerline.branches.extend(graph.branches.into_iter().map(|branch| Branch {
        from: branch.from + offset,
        to: branch.to + offset,
        ..branch
    }));
    extraction.warnings.extend(graph.warnings);
}

impl From<PreparationError> for ExtractError {
    fn from(error: PreparationError) -> Self {
        match error {
            PreparationError::NoTriangles => ExtractError::NoTriangles,
            PreparationError::AllDegenerate { triangles } => ExtractError::AllDegenerate { triangles },
            PreparationError::NotFinite(sites) => {
                ExtractError::NotFinite { count: sites.count, first: sites.list() }
            }
            PreparationError::OutOfRange(sites) => {
                ExtractError::OutOfRange { count: sites.count, first: sites.list() }
            }
        }
    }
}
