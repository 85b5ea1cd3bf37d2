//! Ends that were cut aslant and closed, as a finished line shows them.
//!
//! A cap that is noisy, or rounded by marching cubes, is not known for one by its facets (`mesh::flat_caps`), and the
//! line runs to the far corner of the cut. But a vessel's sections well before its end are known, and so is the tube
//! that they go on as. Where nothing of the wall ahead lies outside that tube, and what closes it is a plane that stands
//! aslant, the vessel was cut there.

pub mod openings;
mod plane;
mod region;
mod tube;

use nalgebra::Point3;
use rayon::prelude::*;

use crate::mesh::preparation::Surface;
use crate::mesh::reopening::Closure;

use crate::centerline::component::ComponentGraph;
use crate::centerline::graph::{Branch, NodeKind, Warning};
use crate::centerline::triangle_grid::TriangleGrid;
use crate::centerline::{CancelToken, ExtractError};
use plane::Plane;
use region::{Region, facing};
use tube::{Place, Tube};

/// How far before the end the vessel may be whole again, in radii: a cut at 60 degrees is 3.5 long.
const BEFORE: [f64; 6] = [3.5, 2.5, 4.5, 6.0, 8.0, 1.5];
/// Cosine between cut and vessel above which the line reaches the middle of the cut by itself.
const SQUARE: f64 = 0.9;
/// The same of the steepest cut.
const STEEP: f64 = 0.2;
/// Share of the surface past the last whole section that lies on the tube or on the plane.
const EXPLAINED: f64 = 0.96;
/// Farthest from both that it may lie, in radii.
const NEAR: f64 = 0.2;
/// Most that a cap bulges, in radii: the middle of it against what lies around.
const FLAT: f64 = 0.1;
/// The same where the line leaves the tube's axis by more than [`ASIDE`]: then it is no dome.
const ROUGH: f64 = 0.25;
/// Farthest that the end of a line lies from the axis that it would have gone on along, in the wall's distance.
const ASIDE: f64 = 0.5;
/// Farthest that the end of a line lies from the middle of a cut that need not be opened, in the wall's distance.
const REACHED: f64 = 0.1;
/// The same of one that is open already.
const MISSED: f64 = 0.3;

/// An end that something speaks against.
#[derive(Debug, Clone, PartialEq)]
pub struct Finding {
    /// Number of its node.
    node: usize,
    /// What closes the cut, where it is known for one.
    pub cap: Option<Closure>,
    /// Whether it was taken for a cut before, or a part of it.
    pub known: bool,
    /// How far the line's end lies from the middle of the cut, or else from the axis, over the wall's distance.
    off: f64,
}

/// That of component `index` where ends of its line lie off the middle of their vessel.
pub fn warning(index: usize, graph: &ComponentGraph, findings: &[Finding]) -> Option<Warning> {
    let aside: Vec<&Finding> = findings.iter().filter(|finding| finding.off > ASIDE).collect();
    let place = |finding: &&Finding| {
        let at = graph.nodes[finding.node].position;
        format!("[{:.4}, {:.4}, {:.4}] by {:.2} radii", at.x, at.y, at.z, finding.off)
    };
    (!aside.is_empty()).then(|| Warning {
        code: "end-off-axis",
        detail: format!(
            "{} ends of component {index} lie off the middle of their vessel, as in the corner of a cut aslant: at {}",
            aside.len(),
            told(&aside, place)
        ),
    })
}

/// The first of some places, one by one.
fn told<T>(all: &[T], place: impl Fn(&T) -> String) -> String {
    const TOLD: usize = 8;
    all.iter().take(TOLD).map(place).collect::<Vec<String>>().join(", ")
}

/// What speaks against ends of a line, but for those in openings that the mesh has. O(triangles around the ends).
///
/// # Errors
/// [`ExtractError::Cancelled`].
pub fn look(
    grid: &TriangleGrid<'_>,
    graph: &ComponentGraph,
    cancel: &CancelToken,
) -> Result<Vec<Finding>, ExtractError> {
    let ends = |branch: &Branch| [(branch.from, true), (branch.to, false)];
    let all: Vec<(&Branch, usize, bool)> = graph
        .branches
        .iter()
        .flat_map(|branch| ends(branch).map(|(node, reversed)| (branch, node, reversed)))
        .filter(|&(_, node, _)| graph.nodes[node].kind == NodeKind::End)
        .filter(|&(_, node, _)| !is_in_opening(grid.surface(), &graph.nodes[node].position))
        .collect();
    let one = |&(branch, _, reversed): &(&Branch, usize, bool)| {
        if reversed { examine(grid, &turned(branch), cancel) } else { examine(grid, branch, cancel) }
    };
    let found: Vec<Option<Finding>> = all.par_iter().map(one).collect::<Result<_, ExtractError>>()?;
    Ok(found.into_iter().flatten().collect())
}

fn is_in_opening(surface: &Surface, point: &Point3<f64>) -> bool {
    surface
        .openings
        .iter()
        .filter(|opening| !opening.was_closed)
        .any(|opening| (surface.mesh.vertices[opening.centre as usize] - point).norm() < opening.radius)
}

fn turned(branch: &Branch) -> Branch {
    let mut turned = branch.clone();
    (turned.from, turned.to) = (branch.to, branch.from);
    turned.points.reverse();
    turned.radii.reverse();
    turned.equivalent_radii.reverse();
    turned
}

/// What speaks against the last point of a branch as an end of the line, as the view that explains most shows it.
fn examine(
    grid: &TriangleGrid<'_>,
    branch: &Branch,
    cancel: &CancelToken,
) -> Result<Option<Finding>, ExtractError> {
    /// Share that need not be surpassed.
    const SURE: f64 = 0.99;
    let mut best: Option<(Finding, f64)> = None;
    if ends_squarely(grid, branch) {
        return Ok(None);
    }
    for radii in BEFORE {
        cancel.check()?;
        let Some(place) = whole_before(branch, radii) else { continue };
        let Some(view) = View::from(grid, branch, place, cancel)? else { continue };
        if view.explained < EXPLAINED {
            continue;
        }
        let known = best.as_ref().is_some_and(|(best, _)| best.cap.is_some());
        if !known && (view.is_plain() || (view.is_reached() && view.explained > SURE)) {
            return Ok(None);
        }
        let finding = view.finding(grid, branch.to);
        let better = best.as_ref().is_none_or(|(_, explained)| view.explained > *explained);
        if (finding.cap.is_some() && !known) || (finding.cap.is_some() == known && better) {
            best = Some((finding, view.explained));
        }
        if best.as_ref().is_some_and(|(best, explained)| best.cap.is_some() && *explained > SURE) {
            break;
        }
    }
    let finding = best.map(|(finding, _)| finding);
    Ok(finding.filter(|finding| finding.cap.is_some() || finding.off > ASIDE))
}

/// Whether a branch ends near the axis that it would have gone on along, in a piece of surface that faces along it: so
/// nearly all ends do, and need no closer look.
fn ends_squarely(grid: &TriangleGrid<'_>, branch: &Branch) -> bool {
    let look = || {
        let place = whole_before(branch, BEFORE[0])?;
        let tube = Tube::past(grid, branch, place)?;
        let end = branch.points.last()?;
        let Place { along, share, .. } = tube.place(end);
        let (_, direction) = tube.at(along);
        let cosine = facing(grid, &branch.points, 0.5 * tube.radius, &direction)?;
        Some(share < MISSED && cosine > SQUARE)
    };
    look().unwrap_or(false)
}

/// The last point of a branch that lies `radii` of its own before the end.
fn whole_before(branch: &Branch, radii: f64) -> Option<usize> {
    let mut way = 0.0;
    for place in (2..branch.points.len().saturating_sub(1)).rev() {
        way += (branch.points[place + 1] - branch.points[place]).norm();
        if way > radii * branch.equivalent_radii[place] {
            return Some(place);
        }
    }
    None
}

/// An end as it looks from a point before it.
struct View {
    region: Region,
    plane: Plane,
    /// Where plane and axis meet.
    middle: Point3<f64>,
    /// Share of the surface ahead that tube and plane explain.
    explained: f64,
    /// How far the line's end lies from the tube's axis, over the wall's distance.
    aside: f64,
    /// How far it lies from where plane and axis meet, over the same.
    missed: f64,
    /// Cosine between plane and axis where they meet.
    lean: f64,
    /// Height of the middle of the cap over what lies around it, in radii.
    bulge: f64,
    /// How far ahead the nearest point of the cap lies, in radii.
    nearest: f64,
}

impl View {
    fn from(
        grid: &TriangleGrid<'_>,
        branch: &Branch,
        place: usize,
        cancel: &CancelToken,
    ) -> Result<Option<Self>, ExtractError> {
        let Some(tube) = Tube::past(grid, branch, place) else { return Ok(None) };
        let Some(region) = Region::ahead(grid, &tube, cancel)? else { return Ok(None) };
        Ok(Self::of(branch, &tube, region))
    }

    fn of(branch: &Branch, tube: &Tube, region: Region) -> Option<Self> {
        let mut plane = region.plane(tube)?;
        let along = meeting(tube, &plane);
        let (middle, direction) = tube.at(along);
        if plane.normal.dot(&direction) < 0.0 {
            plane.normal = -plane.normal;
        }
        let end = branch.points.last()?;
        let Place { share: aside, wall, .. } = tube.place(end);
        let fit = region.fit(tube, &plane);
        Some(Self {
            explained: fit.explained,
            bulge: fit.bulge,
            nearest: fit.nearest,
            lean: plane.normal.dot(&direction),
            missed: (end - middle).norm() / wall,
            aside,
            middle,
            region,
            plane,
        })
    }

    /// Whether the line ends as it should in what closes the tube squarely.
    fn is_plain(&self) -> bool {
        self.aside < MISSED && self.lean > SQUARE
    }

    /// Whether the line ends about where it would if the cut were known.
    fn is_reached(&self) -> bool {
        self.missed < if self.region.is_open { MISSED } else { REACHED }
    }

    fn finding(&self, grid: &TriangleGrid<'_>, node: usize) -> Finding {
        let off = if self.is_cut() { self.missed } else { self.aside };
        Finding { node, cap: self.cap(grid), known: self.region.is_open, off }
    }

    /// What closes the cut, where it is one that the line does not reach.
    fn cap(&self, grid: &TriangleGrid<'_>) -> Option<Closure> {
        if self.is_reached() || !self.is_cut() {
            return None;
        }
        let triangles = self.region.cap(grid.surface(), &self.plane, &self.middle)?;
        Some(Closure { triangles, middle: self.middle })
    }

    fn is_cut(&self) -> bool {
        let flat = if self.aside > ASIDE { ROUGH } else { FLAT };
        (STEEP..SQUARE).contains(&self.lean) && self.bulge.abs() < flat && self.nearest > 0.0
    }
}

/// How far along the axis a tube meets a plane.
fn meeting(tube: &Tube, plane: &Plane) -> f64 {
    let mut along = (plane.point - tube.frame.origin).dot(&tube.frame.t);
    for _ in 0..8 {
        let (point, direction) = tube.at(along);
        let aslant = direction.dot(&plane.normal);
        if aslant.abs() < 0.1 {
            break;
        }
        along -= plane.height(&point) / aslant;
    }
    along
}
