//! The method: a mesh and parameters in, a centerline or a typed error out.
//!
//! No I/O, no clock, no global state. The caller's rayon pool is used.

mod component;
mod connection;
mod control;
mod cut_ends;
mod cut_plane;
mod equivalent_radius;
mod error;
mod focal;
mod graph;
mod laplacian_smoothing;
mod least_radii;
mod line_tree;
mod median;
mod orientation;
mod own_sections;
mod parameters;
mod point_grid;
mod preset_default;
mod preset_paper;
mod quality;
mod recentering;
mod segment;
mod segmentation;
#[cfg(test)]
mod shapes;
mod smoothing_filter;
#[cfg(test)]
mod test_surfaces;
mod thinning;
mod tips;
mod traced_line;
mod triangle_grid;

use std::ops::RangeInclusive;

pub use control::{CancelToken, Control, Part, Progress, Stage};
pub use error::ExtractError;
pub use graph::{Branch, Centerline, Extraction, Node, NodeKind, SurfaceSummary, Warning};
pub(crate) use parameters::shown;
pub use parameters::{
    FARTHEST, POINTS, ParameterError, ParameterKind, ParameterSpec, Parameters, PointsSpec, Preset, TABLE,
};
pub use quality::{Centeredness, Homotopy, Quality};
pub use tips::picks::check_reach;

use crate::mesh::TriangleMesh;
use crate::mesh::preparation::{
    PreparationError, PreparationReport, Prepared, Sites, Surface, prepare_while,
};
use crate::mesh::reopening::Closure;
use component::ComponentGraph;
use quality::{Line, Measured};
use tips::picks::{self, Picks};
use traced_line::{TracedLine, traced};
use triangle_grid::TriangleGrid;

/// Diagonals, in the input's unit, of surfaces that can be reckoned with: lengths are kept in single precision on the way,
/// squares in double.
pub const DIAGONALS: RangeInclusive<f64> = 1e-30..=1e30;

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
    if !DIAGONALS.contains(&diagonal) {
        return Err(ExtractError::OutOfScale { diagonal });
    }
    let mut extraction = Extraction { surface: summary(&prepared), ..Extraction::default() };
    extraction.warnings = repair_warnings(&prepared.report);
    let parts = parts(&prepared.components);
    let taken = prepared.components.iter().zip(&parts).map(|(surface, part)| part.as_ref().map(|_| surface));
    let picks = picks::place(&taken.collect::<Vec<_>>(), diagonal, parameters, &control.cancel)?;
    // One after another, as progress and timings tell them: the stages inside use all threads.
    let work = prepared.components.iter_mut().zip(&parts).zip(&picks).enumerate();
    let lines = work.filter_map(|(index, ((surface, part), picks))| {
        let control = &control.of_part((*part)?);
        Some((index, component(index, surface, (diagonal, parameters, picks), control)))
    });
    let lines: Vec<(usize, Result<ComponentLine, ExtractError>)> = lines.collect();
    let specks = parts.iter().filter(|part| part.is_none()).count();
    put_together(&mut extraction, lines, &picks)?;
    if specks > 0 {
        let detail = format!("{specks} components smaller than {SPECK} of the largest were left out");
        extraction.warnings.push(Warning { code: "specks-skipped", detail });
    }
    Ok(extraction)
}

/// A component's line, how good it is, and the warnings of what fails.
struct ComponentLine {
    graph: ComponentGraph,
    measured: Measured,
    warnings: Vec<Warning>,
}

/// How often cuts that a line shows are opened and the line is found anew.
const REOPENED: usize = 3;

/// Extracts and measures the line of component `index`.
fn component(
    index: usize,
    surface: &mut Surface,
    (diagonal, parameters, picks): (f64, &Parameters, &Picks),
    control: &Control<'_>,
) -> Result<ComponentLine, ExtractError> {
    refuse_sheet(surface)?;
    if parameters.smoothing() {
        // The cuts stay where they are.
        let openings = surface.openings.iter();
        let cuts: Vec<u32> = openings.flat_map(|o| o.rim.iter().copied().chain([o.centre])).collect();
        smoothing_filter::smooth(&mut surface.mesh, &cuts, control)?;
    }
    let surface = &*surface;
    let (grid, mut line) = traced(surface, (diagonal, parameters, picks), control)?;
    let mut findings = cut_ends::look(&grid, &line.graph, &control.cancel)?;
    let mut opened: Option<(Surface, Picks)> = None;
    for _ in 0..REOPENED {
        let (seen, picks) = opened.as_ref().map_or((surface, picks), |(surface, picks)| (surface, picks));
        let caps: Vec<&Closure> = findings.iter().filter_map(|finding| finding.cap.as_ref()).collect();
        if caps.is_empty() {
            break;
        }
        let Some(next) = seen.reopened(&caps, || control.cancel.check())? else { break };
        let picks = picks.renumbered(seen, &next);
        match traced(&next, (diagonal, parameters, &picks), &control.quiet()) {
            Ok((grid, found)) if found.graph.ends() >= line.graph.ends() => {
                line = found;
                findings = cut_ends::look(&grid, &line.graph, &control.cancel)?;
            }
            Err(ExtractError::Cancelled) => return Err(ExtractError::Cancelled),
            // What is no vessel once it is open, or lost an end, was not cut.
            Ok(_) | Err(_) => break,
        }
        // What was opened once is as open as it gets.
        findings.iter_mut().filter(|finding| finding.known).for_each(|finding| finding.cap = None);
        opened = Some((next, picks));
    }
    let mut line = match &opened {
        None => finished(index, &grid, line, parameters, control),
        Some((surface, _)) => finished(index, &TriangleGrid::new(surface), line, parameters, control),
    }?;
    line.warnings.extend(cut_ends::warning(index, &line.graph, &findings));
    // What is excluded is missed as it should be.
    if picks.exclude.is_empty() {
        line.warnings.extend(cut_ends::openings::warning(index, surface, &line.graph));
    }
    Ok(line)
}

/// The line with its focal places, and how good it is.
fn finished(
    index: usize,
    grid: &TriangleGrid<'_>,
    mut line: TracedLine,
    parameters: &Parameters,
    control: &Control<'_>,
) -> Result<ComponentLine, ExtractError> {
    if parameters.preset() == Preset::Default
        && let Some(focal) = focal::told_anew(grid, &line.sections, &line.graph, &control.cancel)?
    {
        line = line.told_anew(focal, grid)?;
    }
    control.cancel.check()?;
    let TracedLine { graph, tree, sections } = &line;
    let (measured, warnings) = Measured::of(index, Line { grid, graph, tree, sections });
    Ok(ComponentLine { graph: line.graph, measured, warnings })
}

/// Refuses a component that encloses nothing, before anything is looked for on it: a soup has thousands.
fn refuse_sheet(surface: &Surface) -> Result<(), ExtractError> {
    /// Least volume against the area to the power of one and a half: that of a tube a million radii long is twenty
    /// times as much.
    const LUMEN: f64 = 1e-5;
    if surface.volume() < LUMEN * surface.area().powf(1.5) {
        return Err(ExtractError::NotTubular { detail: "it encloses no lumen: it is a sheet".to_owned() });
    }
    Ok(())
}

/// The lines of all components as one result; the refusal of the last where none has a line.
fn put_together(
    extraction: &mut Extraction,
    lines: Vec<(usize, Result<ComponentLine, ExtractError>)>,
    picks: &[Picks],
) -> Result<(), ExtractError> {
    /// So many components without a line are told one by one.
    const TOLD: usize = 16;
    let mut measured = Measured::default();
    let mut graphs: Vec<ComponentGraph> = Vec::new();
    let mut refusals = Vec::new();
    for (index, line) in lines {
        match line {
            Ok(line) => {
                extraction.warnings.extend(line.warnings);
                measured.add(&line.measured);
                // The root's component comes first, so that the root is the first node of all.
                graphs.insert(if picks[index].root.is_some() { 0 } else { graphs.len() }, line.graph);
            }
            Err(ExtractError::Cancelled) => return Err(ExtractError::Cancelled),
            Err(error) => {
                let detail = format!("component {index} has no centerline: {error}");
                if refusals.len() < TOLD {
                    extraction.warnings.push(Warning { code: "component-skipped", detail });
                }
                refusals.push(error);
            }
        }
    }
    if refusals.len() > TOLD {
        let detail = format!("{} more components have no centerline", refusals.len() - TOLD);
        extraction.warnings.push(Warning { code: "component-skipped", detail });
    }
    graphs.into_iter().for_each(|graph| append(extraction, graph));
    extraction.quality = measured.quality();
    match refusals.pop() {
        Some(error) if extraction.centerline.branches.is_empty() => Err(error),
        _ => Ok(()),
    }
}

/// The part of the work that each component is, by its vertices; `None` for specks.
fn parts(components: &[Surface]) -> Vec<Option<Part>> {
    let diagonals: Vec<f64> = components.iter().map(Surface::diagonal).collect();
    let largest = diagonals.iter().copied().fold(0.0, f64::max);
    // Of those that are no speck.
    let vertices = |(surface, diagonal): (&Surface, &f64)| {
        (*diagonal >= SPECK * largest).then_some(surface.mesh.vertices.len() as f64)
    };
    let counts: Vec<Option<f64>> = components.iter().zip(&diagonals).map(vertices).collect();
    let total: f64 = counts.iter().flatten().sum();
    let mut before = 0.0;
    let mut part = |count: f64| {
        let part = Part { before, share: count / total };
        before += part.share;
        part
    };
    counts.into_iter().map(|count| count.map(&mut part)).collect()
}

fn summary(prepared: &Prepared) -> SurfaceSummary {
    SurfaceSummary {
        vertices: prepared.report.vertices,
        triangles: prepared.report.triangles,
        components: prepared.components.len(),
        genus: prepared.components.iter().map(Surface::genus).sum(),
        openings: prepared.components.iter().map(Surface::open_cuts).sum(),
        diagonal: prepared.report.diagonal,
    }
}

/// Repairs that a user should know of, with their counts and the numbers of the first.
fn repair_warnings(report: &PreparationReport) -> Vec<Warning> {
    let found = [
        (
            "snapped-vertices",
            report.snapped_vertices,
            "vertices of a mesh in pieces became one with another within a millionth of its diagonal",
            "vertex",
        ),
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
        (
            "holes-closed",
            report.holes,
            "holes in the wall were closed; no vessel was cut there",
            "beside vertex",
        ),
        (
            "internal-cavities",
            report.cavities,
            "closed surfaces inside another were left out: no vessels of their own",
            "with vertex",
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
            PreparationError::OutOfScale { diagonal } => ExtractError::OutOfScale { diagonal },
            PreparationError::AllDegenerate { triangles } => ExtractError::AllDegenerate { triangles },
            PreparationError::FarOut(sites) => {
                ExtractError::FarOut { count: sites.count, first: sites.list() }
            }
            PreparationError::NotFinite(sites) => {
                ExtractError::NotFinite { count: sites.count, first: sites.list() }
            }
            PreparationError::OutOfRange(sites) => {
                ExtractError::OutOfRange { count: sites.count, first: sites.list() }
            }
        }
    }
}
