//! Where the line's own sections do not agree with the radii that were told.

use super::window::{Stretch, ways};
use super::{AGREED, COARSE};
use crate::centerline::component::ComponentGraph;
use crate::centerline::own_sections::OwnSection;
use crate::centerline::triangle_grid::TriangleGrid;

/// Way from a joint or an end, in radii of the wider, within which no section is believed.
const CLEAR: f64 = 1.0;
/// How far a stretch reaches beyond the last section that does not agree, in radii.
const BEYOND: f64 = 1.5;
/// Distance of the sections of a stretch that are looked at first, in radii of the narrowest.
const STEP: f64 = 0.25;

/// The stretches where a section does not agree with what was told, in the order of the line; those that overlap are one.
pub fn suspects(
    grid: &TriangleGrid<'_>,
    sections: &[OwnSection],
    graph: &ComponentGraph,
    noise: f64,
) -> Vec<Stretch> {
    let mut found: Vec<Stretch> = Vec::new();
    for of_branch in sections.chunk_by(|a, b| a.branch == b.branch) {
        // Of a vessel of a few vertices around, its smooth curve is all that is known.
        if 2 * of_branch.iter().filter(|section| section.near.is_finite()).count() < of_branch.len() {
            continue;
        }
        let branch = &graph.branches[of_branch[0].branch];
        let ways = ways(branch);
        let differs = |section: &&OwnSection| {
            let wall = || grid.wall_distance(&branch.points[section.place]);
            differs(section, branch.radii[section.place], wall, noise) && is_clear(graph, section, &ways)
        };
        for section in of_branch.iter().filter(differs) {
            let told = branch.radii[section.place];
            let (at, reach) = (ways[section.place], BEYOND * told.max(section.inscribed));
            let next = Stretch {
                branch: section.branch,
                from: (at - reach).max(0.0),
                to: (at + reach).min(ways[ways.len() - 1]),
                step: STEP * section.inscribed.min(told),
            };
            match found.last_mut().filter(|last| last.overlaps(&next)) {
                Some(last) => last.add(&next),
                None => found.push(next),
            }
        }
    }
    found
}

/// Whether a section is another than what was told. Wider only where its wall is farther all around the line: a sac beside it is
/// not the vessel.
fn differs(section: &OwnSection, told: f64, wall: impl Fn() -> f64, noise: f64) -> bool {
    let agreed = AGREED * noise * if section.near.is_finite() { 1.0 } else { COARSE };
    let is_wider = || section.inscribed.min(section.near) > agreed * told && noise * wall() > agreed * told;
    told > agreed * section.inscribed || is_wider()
}

/// Whether a section lies outside of the joint or the end cap at either end of its branch.
pub fn is_clear(graph: &ComponentGraph, section: &OwnSection, ways: &[f64]) -> bool {
    let branch = &graph.branches[section.branch];
    let (way, widest) = (ways[section.place], section.inscribed.max(branch.radii[section.place]));
    let is_past = |node: usize, way: f64| way > CLEAR * widest.max(graph.nodes[node].radius);
    is_past(branch.from, way) && is_past(branch.to, ways[ways.len() - 1] - way)
}

/// By what ratio sections differ from their neighbours that have nothing but noise.
pub fn noise(sections: &[OwnSection], graph: &ComponentGraph) -> f64 {
    /// A normal deviation over the median of the absolute distances of values from the middle of both their neighbours.
    const NORMAL: f64 = 1.4826 * 0.8165;
    const DEVIATIONS: f64 = 3.0;
    let told = |section: &OwnSection| graph.branches[section.branch].radii[section.place];
    let apart = |three: &[OwnSection]| {
        let [a, b, c] = [0, 1, 2].map(|k| (told(&three[k]) / three[k].inscribed).ln());
        (three[0].branch == three[2].branch).then(|| (b - 0.5 * (a + c)).abs())
    };
    let mut all: Vec<f64> = sections.windows(3).filter_map(apart).filter(|apart| apart.is_finite()).collect();
    if all.is_empty() {
        return 1.0;
    }
    let middle = all.len() / 2;
    (DEVIATIONS * NORMAL * *all.select_nth_unstable_by(middle, f64::total_cmp).1).exp()
}
