//! A component's line as a preset traced it, with its own sections.

use crate::mesh::preparation::Surface;

use super::component::ComponentGraph;
use super::focal::FocalPlaces;
use super::line_tree::LineTree;
use super::own_sections::{OwnSection, own_sections};
use super::tips::picks::Picks;
use super::triangle_grid::TriangleGrid;
use super::{
    Control, ExtractError, Parameters, Preset, equivalent_radius, least_radii, orientation, preset_default,
    preset_paper,
};

/// A line with its own sections.
pub struct TracedLine {
    pub graph: ComponentGraph,
    pub tree: LineTree,
    pub sections: Vec<OwnSection>,
}

impl TracedLine {
    /// The equivalent radii come from the sections.
    fn of(graph: ComponentGraph, grid: &TriangleGrid<'_>) -> Self {
        let branches = 0..graph.branches.len();
        Self::with_sections(graph, grid, Vec::new(), branches)
    }

    /// The line with the sections of other branches, and those of `branches` cut on it.
    fn with_sections(
        mut graph: ComponentGraph,
        grid: &TriangleGrid<'_>,
        mut sections: Vec<OwnSection>,
        branches: impl IntoIterator<Item = usize>,
    ) -> Self {
        let tree = LineTree::new(&graph);
        sections.extend(own_sections(grid, &tree, &graph, branches.into_iter()));
        sections.sort_by_key(|section| section.branch);
        equivalent_radius::settle(&mut graph, &sections);
        Self { graph, tree, sections }
    }

    /// The same with the focal places of the branches that have any.
    ///
    /// # Errors
    /// [`ExtractError::NotTubular`], see [`ComponentGraph::check_numbers`].
    pub fn told_anew(self, focal: FocalPlaces, grid: &TriangleGrid<'_>) -> Result<Self, ExtractError> {
        let FocalPlaces { graph, branches } = focal;
        graph.check_numbers()?;
        let mut sections = self.sections;
        sections.retain(|section| branches.binary_search(&section.branch).is_err());
        Ok(Self::with_sections(graph, grid, sections, branches))
    }
}

/// The line of a prepared surface, and the surface's triangles, sorted on the way.
///
/// # Errors
/// [`ExtractError`] when the surface cannot have a centerline.
pub fn traced<'a>(
    surface: &'a Surface,
    (diagonal, parameters, picks): (f64, &Parameters, &Picks),
    control: &Control<'_>,
) -> Result<(TriangleGrid<'a>, TracedLine), ExtractError> {
    let (grid, mut graph) = match parameters.preset() {
        Preset::Default => preset_default::extract_component(surface, parameters, picks, control),
        Preset::Paper => preset_paper::extract_component(surface, diagonal, parameters, picks, control)
            .map(|graph| (TriangleGrid::new(surface), graph)),
    }?;
    graph.check_numbers()?;
    least_radii::raise(&grid, &mut graph);
    if let Some(root) = picks.root {
        orientation::tell_from(&mut graph, &surface.mesh.vertices[root.vertex as usize]);
    }
    let line = TracedLine::of(graph, &grid);
    Ok((grid, line))
}
