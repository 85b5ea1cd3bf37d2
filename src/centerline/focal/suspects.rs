//! Where the line's own sections do not agree with the radii that were told.

use super::window::Stretch;
use super::{AGREED, COARSE};
use crate::centerline::component::ComponentGraph;
use crate::centerline::graph::Branch;
use crate::centerline::median::median;
use crate::centerline::own_sections::OwnSection;
use crate::centerline::triangle_grid::TriangleGrid;

/// Way from a joint or an end, in radii of the wider, within which no section is believed and nothing told anew.
const CLEAR: f64 = 1.0;
/// How far a stretch reaches beyond the last section that does not agree, in radii.
const BEYOND: f64 = 1.5;
/// Distance of the sections of a stretch that are looked at first, in radii of the narrowest.
const STEP: f64 = 0.25;

/// The stretches where a section does not agree with what was told, in the order of the line and apart from each other. `noise` is
/// that of each branch.
pub fn suspects(
    grid: &TriangleGrid<'_>,
    sections: &[OwnSection],
    graph: &ComponentGraph,
    noise: &[f64],
) -> Vec<Stretch> {
    let mut found: Vec<Stretch> = Vec::new();
    for of_branch in sections.chunk_by(|a, b| a.branch == b.branch) {
        // Of a vessel of a few vertices around, its smooth curve is all that is known.
        if 2 * of_branch.iter().filter(|section| section.near.is_finite()).count() < of_branch.len() {
            continue;
        }
        let number = of_branch[0].branch;
        let branch = &graph.branches[number];
        let ways = branch.ways();
        let [from, to] = clear(graph, branch, &ways);
        let differs = |section: &&OwnSection| {
            let wall = || grid.wall_distance(&branch.points[section.place]);
            differs(section, branch.radii[section.place], wall, noise[number])
                && is_clear(graph, section, &ways)
        };
        for section in of_branch.iter().filter(differs) {
            let told = branch.radii[section.place];
            let (at, reach) = (ways[section.place], BEYOND * told.max(section.inscribed));
            let step = STEP * section.inscribed.min(told);
            add(
                &mut found,
                Stretch { branch: number, from: (at - reach).max(from), to: (at + reach).min(to), step },
            );
        }
    }
    found
}

/// Adds a stretch; those before it that it overlaps become one with it.
fn add(found: &mut Vec<Stretch>, mut next: Stretch) {
    while let Some(before) = found.pop_if(|last| last.overlaps(&next)) {
        next.add(&before);
    }
    found.push(next);
}

/// Whether a section is another than what was told. Wider only where its wall is farther all around the line: a sac beside it is
/// not the vessel.
fn differs(section: &OwnSection, told: f64, wall: impl Fn() -> f64, noise: f64) -> bool {
    let agreed = AGREED * noise * if section.near.is_finite() { 1.0 } else { COARSE };
    let is_wider = || section.inscribed.min(section.near) > agreed * told && noise * wall() > agreed * told;
    told > agreed * section.inscribed || is_wider()
}

/// Where a branch leaves the joint or the end cap at its start, and where it comes to the other.
fn clear(graph: &ComponentGraph, branch: &Branch, ways: &[f64]) -> [f64; 2] {
    let within = |node: usize| CLEAR * graph.nodes[node].radius;
    [within(branch.from), ways[ways.len() - 1] - within(branch.to)]
}

/// Whether a section lies outside of the joint or the end cap at either end of its branch.
pub fn is_clear(graph: &ComponentGraph, section: &OwnSection, ways: &[f64]) -> bool {
    let branch = &graph.branches[section.branch];
    let (way, length) = (ways[section.place], ways[ways.len() - 1]);
    let within = CLEAR * section.inscribed.max(branch.radii[section.place]);
    let [from, to] = clear(graph, branch, ways);
    way > from.max(within) && way < to.min(length - within)
}

/// Of each branch, by what ratio sections differ from what was told by noise alone; that of all where a branch has too few.
pub fn noise(sections: &[OwnSection], graph: &ComponentGraph) -> Vec<f64> {
    const FEW: usize = 8;
    let ratio = |section: &OwnSection| {
        let told = graph.branches[section.branch].radii[section.place];
        let ratio = (told / section.inscribed).ln();
        ratio.is_finite().then_some((section.branch, ratio))
    };
    let ratios: Vec<(usize, f64)> = sections.iter().filter_map(ratio).collect();
    let usual = reached_by_noise(&ratios);
    let mut noise = vec![usual; graph.branches.len()];
    for of_branch in ratios.chunk_by(|a, b| a.0 == b.0).filter(|of_branch| of_branch.len() >= FEW) {
        noise[of_branch[0].0] = reached_by_noise(of_branch);
    }
    noise
}

/// The ratio that noise reaches, of the logarithms along branches: it moves each away from the middle of both its neighbours, and as
/// the ellipse of a rough section is narrower than that of a smooth one, all of them a little.
fn reached_by_noise(ratios: &[(usize, f64)]) -> f64 {
    /// A normal deviation over the median of the absolute values.
    const NORMAL: f64 = 1.4826 * 0.8165;
    const DEVIATIONS: f64 = 4.0;
    /// The most that all sections are off; by more, what was told is wrong.
    const ALL: f64 = 0.06;
    let apart = |three: &[(usize, f64)]| {
        (three[0].0 == three[2].0).then(|| (three[1].1 - 0.5 * (three[0].1 + three[2].1)).abs())
    };
    let apart: Vec<f64> = ratios.windows(3).filter_map(apart).collect();
    let off = median(ratios.iter().map(|(_, ratio)| *ratio).collect()).abs().min(ALL);
    (DEVIATIONS * NORMAL * median(apart) + off).exp()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stretches_that_overlap_are_one_however_far_back_the_last_reaches() {
        let stretch = |from: f64, to: f64| Stretch { branch: 0, from, to, step: 1.0 };
        let mut found = Vec::new();
        for next in [stretch(8.5, 11.5), stretch(11.55, 14.85), stretch(10.9, 16.9), stretch(20.0, 21.0)] {
            add(&mut found, next);
        }
        assert_eq!(found, [stretch(8.5, 16.9), stretch(20.0, 21.0)]);
    }
}
