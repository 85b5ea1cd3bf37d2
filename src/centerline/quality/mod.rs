//! How good a line is: measured on the result and the prepared surface alone, whichever preset made it.
//!
//! One file a property: [`homotopy`], [`inside`], [`centeredness`], [`coverage`], [`thinness`], [`room`]. A component's
//! line is measured against that component; what fails is a warning as well.

mod centeredness;
mod coverage;
mod homotopy;
mod inside;
mod piece;
mod reach;
mod room;
mod thinness;

use crate::centerline::component::ComponentGraph;
use crate::centerline::graph::Warning;
use crate::centerline::line_tree::LineTree;
use crate::centerline::own_sections::OwnSection;
use crate::centerline::triangle_grid::TriangleGrid;
use centeredness::Offsets;
use coverage::Covered;
pub use homotopy::Homotopy;
use inside::Inside;
use room::Against;

/// What was measured of a whole result.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Quality {
    pub homotopy: Homotopy,
    /// Share of the line's length inside the lumen, 0 to 1.
    pub inside: f64,
    pub centeredness: Centeredness,
    /// Share of the surface's area, caps of openings included, within 1.5 local radii of the line.
    pub coverage: f64,
    /// Whether the line is one-dimensional; [`thinness`] says what that means.
    pub thinness: bool,
}

/// Distance of the line's points from the centroids of their sections, in radii of the circles that have the
/// sections' areas; [`super::own_sections`] says which points count.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Centeredness {
    /// `None` where no point counts.
    pub mean: Option<f64>,
    pub max: Option<f64>,
    /// How many points count.
    pub sections: usize,
}

/// The line of one component, and what it is measured with.
#[derive(Debug, Clone, Copy)]
pub struct Line<'a> {
    pub grid: &'a TriangleGrid<'a>,
    pub graph: &'a ComponentGraph,
    pub tree: &'a LineTree,
    pub sections: &'a [OwnSection],
}

/// Sums over the components that have a line.
#[derive(Debug, Clone, Default)]
pub struct Measured {
    components: usize,
    homotopy: Homotopy,
    inside: Inside,
    offsets: Offsets,
    covered: Covered,
    thick: bool,
}

impl Measured {
    /// The line of component `index` alone, with the warnings of what fails.
    ///
    /// O(points of the line x (triangles nearby + log segments)).
    pub fn of(index: usize, line: Line<'_>) -> (Self, Vec<Warning>) {
        let Line { grid, graph, tree, sections } = line;
        let surface = grid.surface();
        let homotopy = Homotopy::of(surface, graph);
        let inside = inside::measure(grid, graph);
        let covered = coverage::measure(surface, tree, graph);
        let tight = |against| room::measure(graph, sections, against);
        let tight =
            tight(Against::Wall).or_else(|| tight(Against::Facets)).map(|tight| tight.warning(index, graph));
        let thick = thinness::first_thick(tree, graph);
        let twice = thick.map(|thick| thick.warning(index));
        let offsets = centeredness::measure(sections);
        let (unequal, outside) = (homotopy.warning(index), inside.warning(index));
        let warnings = [unequal, outside, covered.warning(index, tree), tight, twice, offsets.warning(index)];
        let measured = Self { components: 1, homotopy, inside, offsets, covered, thick: thick.is_some() };
        (measured, warnings.into_iter().flatten().collect())
    }

    /// Adds what was measured of other components.
    pub fn add(&mut self, other: &Self) {
        self.offsets.add(&other.offsets);
        self.homotopy.add(&other.homotopy);
        self.inside.add(&other.inside);
        self.covered.add(&other.covered);
        self.thick |= other.thick;
        self.components += other.components;
    }

    /// `None` when no component was added.
    pub fn quality(&self) -> Option<Quality> {
        (self.components > 0).then(|| Quality {
            homotopy: self.homotopy,
            inside: self.inside.share(),
            centeredness: self.offsets.centeredness(),
            coverage: self.covered.share(),
            thinness: !self.thick,
        })
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use nalgebra::Point3;
    use proptest::prelude::*;

    use super::*;
    use crate::centerline::graph::{Branch, Node, NodeKind};
    use crate::centerline::own_sections::own_sections;
    use crate::centerline::shapes::{open_tube, torus};
    use crate::centerline::test_surfaces::closed_surface;
    use crate::mesh::preparation::Surface;

    /// One branch of radius 1 through `points`, between two ends or round one seam.
    fn line(points: Vec<Point3<f64>>, ring: bool) -> ComponentGraph {
        let node = |position: &Point3<f64>| Node {
            kind: NodeKind::End,
            position: *position,
            radius: 1.0,
            equivalent_radius: 1.0,
        };
        let ends = if ring { vec![&points[0]] } else { vec![&points[0], &points[points.len() - 1]] };
        ComponentGraph {
            nodes: ends.into_iter().map(node).collect(),
            branches: vec![Branch::new(0, usize::from(!ring), points.clone(), vec![1.0; points.len()])],
            ..ComponentGraph::default()
        }
    }

    /// Points along z between two places, at a distance from the axis.
    fn straight(from: f64, to: f64, aside: f64) -> ComponentGraph {
        let point = |k: u32| Point3::new(aside, 0.0, from + (to - from) * f64::from(k) / 100.0);
        line((0..=100).map(point).collect(), false)
    }

    fn measured(surface: &Surface, graph: &ComponentGraph) -> (Quality, Vec<&'static str>) {
        let (grid, tree) = (TriangleGrid::new(surface), LineTree::new(graph));
        let sections = &own_sections(&grid, &tree, graph, 0..graph.branches.len());
        let (sum, warnings) = Measured::of(0, Line { grid: &grid, graph, tree: &tree, sections });
        (sum.quality().unwrap(), warnings.iter().map(|warning| warning.code).collect())
    }

    /// A tube of radius 1 and length 20.
    fn tube() -> Surface {
        closed_surface(&open_tube(20.0, 101, 96))
    }

    #[test]
    fn the_axis_of_a_tube_is_perfect() {
        let (quality, warnings) = measured(&tube(), &straight(0.0, 20.0, 0.0));
        assert_eq!(quality.homotopy, Homotopy { components: 1, genus: 0, parts: 1, loops: 0, equal: true });
        assert_eq!((quality.inside, quality.coverage, quality.thinness), (1.0, 1.0, true));
        // Every 0.6 of the 18 radii that lie a radius away from both ends.
        assert_eq!(quality.centeredness.sections, 30);
        assert!(quality.centeredness.max.unwrap() < 1e-9);
        assert!(warnings.is_empty(), "{warnings:?}");
    }

    #[test]
    fn the_circle_of_a_torus_is_a_loop_a_little_inside_of_the_sections_middles() {
        let ring = closed_surface(&torus(10.0, 1.0, 320, 96));
        let circle = |k: u32| {
            Point3::new(
                10.0 * (TAU * f64::from(k) / 300.0).cos(),
                10.0 * (TAU * f64::from(k) / 300.0).sin(),
                0.0,
            )
        };
        let mut points: Vec<_> = (0..300).map(circle).collect();
        points.push(points[0]);
        let (quality, warnings) = measured(&ring, &line(points, true));
        assert_eq!(quality.homotopy, Homotopy { components: 1, genus: 1, parts: 1, loops: 1, equal: true });
        assert_eq!((quality.inside, quality.coverage, quality.thinness), (1.0, 1.0, true));
        assert!(quality.centeredness.sections > 90 && quality.centeredness.max.unwrap() < 0.002);
        assert!(warnings.is_empty(), "{warnings:?}");
    }

    #[test]
    fn a_line_that_leaves_the_lumen_is_told() {
        let (quality, warnings) = measured(&tube(), &straight(-5.0, 20.0, 0.0));
        assert!((quality.inside - 0.8).abs() < 1e-9, "{}", quality.inside);
        assert_eq!(warnings, ["outside"]);
        let (quality, warnings) = measured(&tube(), &straight(0.0, 20.0, 1.2));
        assert_eq!((quality.inside, quality.centeredness.sections), (0.0, 0));
        assert_eq!(
            (quality.centeredness.mean, warnings),
            (None, vec!["outside", "wall-without-line", "no-section"])
        );
    }

    #[test]
    fn a_line_beside_the_middle_is_told() {
        assert!(!measured(&tube(), &straight(0.0, 20.0, 0.5)).1.contains(&"off-center"));
        let (quality, warnings) = measured(&tube(), &straight(0.0, 20.0, 0.7));
        assert!((quality.centeredness.max.unwrap() - 0.7).abs() < 0.01);
        assert!(warnings.contains(&"off-center"), "{warnings:?}");
    }

    #[test]
    fn radii_that_no_sphere_has_are_told() {
        let wide = |of: f64, from: usize, to: usize| {
            let mut line = straight(0.0, 20.0, 0.0);
            line.branches[0].radii[from..to].fill(of);
            line
        };
        assert_eq!(measured(&tube(), &wide(1.1, 0, 101)).1, Vec::<&str>::new());
        assert_eq!(measured(&tube(), &wide(1.4, 0, 101)).1, ["radius"]);
        assert_eq!(measured(&tube(), &wide(1.4, 30, 60)).1, ["radius"]);
        assert_eq!(measured(&tube(), &wide(1.4, 45, 50)).1, Vec::<&str>::new());
        // As where a line has passed over a narrow place.
        assert_eq!(measured(&tube(), &wide(2.0, 45, 55)).1, ["radius"]);
        // Of three sides nobody knows what they are of.
        for sides in 3..=6 {
            let coarse = closed_surface(&open_tube(20.0, 10, sides));
            assert_eq!(measured(&coarse, &straight(0.0, 20.0, 0.0)).1, ["few-sides"], "{sides}");
        }
        let octagon = closed_surface(&open_tube(20.0, 10, 8));
        assert_eq!(measured(&octagon, &straight(0.0, 20.0, 0.0)).1, Vec::<&str>::new());
    }

    #[test]
    fn half_a_line_covers_half_a_tube() {
        let (quality, warnings) = measured(&tube(), &straight(0.0, 10.0, 0.0));
        // The wall up to the ball around the line's end, and one of the two caps.
        let covered = (10.0 + (1.5_f64 * 1.5 - 1.0).sqrt() + 0.5) / 21.0;
        assert!((quality.coverage - covered).abs() < 0.005, "{} against {covered}", quality.coverage);
        assert_eq!(warnings, ["wall-without-line"]);
    }

    #[test]
    fn a_lost_end_is_told_and_a_flat_vessel_is_none() {
        let warnings = |graph: &ComponentGraph| measured(&tube(), graph).1;
        assert_eq!(warnings(&straight(0.0, 18.5, 0.0)), ["wall-without-line"]);
        let mut flat = straight(0.0, 20.0, 0.0);
        flat.branches[0].radii.fill(0.5);
        flat.branches[0].equivalent_radii.fill(0.5);
        assert_eq!(warnings(&flat), ["wall-without-line"]);
        // An ellipse of half axes 0.5 and 1 has this radius.
        flat.branches[0].equivalent_radii.fill(0.5_f64.sqrt());
        assert!(warnings(&flat).is_empty());
    }

    #[test]
    fn what_is_little_of_a_large_wall_is_told_where_it_is_one_piece() {
        let long = closed_surface(&open_tube(400.0, 801, 32));
        let warnings = |to: f64| measured(&long, &straight(0.0, to, 0.0)).1;
        // Over 1.7 radii away lie the cap, but for its middle, and a strip of wall: no hundredth of a per cent of it all.
        assert_eq!(warnings(398.2), ["wall-without-line"]);
        // Only the rim of the cap.
        assert!(warnings(398.6).is_empty());
    }

    #[test]
    fn past_a_cut_aslant_only_the_vessels_own_wall_is_no_miss() {
        // Cut at 70 degrees: its corner lies three radii from the line's end.
        let mut mesh = open_tube(20.0, 101, 96);
        mesh.vertices.iter_mut().for_each(|p| p.z += 2.75 * p.x * (p.z / 10.0 - 1.0));
        let surface = closed_surface(&mesh);
        let warnings = |graph: &ComponentGraph| measured(&surface, graph).1;
        assert_eq!(warnings(&straight(0.0, 20.0, 0.0)), Vec::<&str>::new());
        assert_eq!(warnings(&straight(2.0, 18.0, 0.0)), ["wall-without-line"]);
        // A joint there ends no vessel.
        let mut joint = straight(0.0, 20.0, 0.0);
        joint.nodes.iter_mut().for_each(|node| node.kind = NodeKind::Junction);
        assert_eq!(warnings(&joint), ["wall-without-line"]);
        // A line of half the radius is another vessel's.
        let mut thin = straight(0.0, 20.0, 0.0);
        thin.branches[0].radii.fill(0.5);
        thin.branches[0].equivalent_radii.fill(0.5);
        assert_eq!(warnings(&thin), ["wall-without-line"]);
    }

    #[test]
    fn a_line_that_passes_a_place_twice_is_not_thin() {
        let tube = tube();
        let thin = |graph: &ComponentGraph| {
            let (quality, warnings) = measured(&tube, graph);
            assert_eq!(quality.thinness, !warnings.contains(&"not-thin"));
            quality.thinness
        };
        let axis = straight(0.0, 20.0, 0.0);
        let mut twice = axis.clone();
        twice.branches.push(twice.branches[0].clone());
        assert!(!thin(&twice));
        let mut standing = axis.clone();
        standing.branches[0].points[50] = standing.branches[0].points[49];
        assert!(!thin(&standing));
        let mut back = axis.clone();
        back.branches[0].points[50].z = 9.5;
        assert!(!thin(&back));
        let mut apart = axis.clone();
        apart.branches.extend(straight(0.0, 20.0, 0.1).branches);
        assert!(thin(&apart), "0.1 radii apart");
        let crossing = (0..=20).map(|k| Point3::new(0.1 * f64::from(k) - 1.0, 0.0, 10.0)).collect();
        let mut crossed = axis;
        crossed.branches.extend(line(crossing, false).branches);
        assert!(!thin(&crossed));
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 32, failure_persistence: None, ..ProptestConfig::default() })]

        #[test]
        fn a_line_aside_is_off_by_how_far_it_was_moved(aside in 0.0..0.9_f64, size in -20..20_i32) {
            let scale = 10_f64.powi(size);
            let (mut surface, mut graph) = (tube(), straight(0.0, 20.0, aside));
            surface.mesh.vertices.iter_mut().for_each(|point| *point *= scale);
            graph.nodes.iter_mut().for_each(|node| (node.position, node.radius) = (node.position * scale, scale));
            for branch in &mut graph.branches {
                branch.points.iter_mut().for_each(|point| *point *= scale);
                branch.radii.iter_mut().for_each(|radius| *radius *= scale);
            }
            let (quality, warnings) = measured(&surface, &graph);
            let Centeredness { mean, max, sections } = quality.centeredness;
            prop_assert!(sections >= 28, "{}", sections);
            // The far side of the wall lies a radius and `aside` away, the near one where no sphere fits.
            prop_assert!(aside > 0.2 || warnings.is_empty(), "{:?}", warnings);
            prop_assert!(aside < 0.5 || warnings.contains(&"radius"), "{:?}", warnings);
            // A polygon of 96 sides has a little less area than its circle.
            prop_assert!((mean.unwrap() - aside).abs() < 0.002 && (max.unwrap() - aside).abs() < 0.002);
            prop_assert_eq!((quality.inside, quality.thinness), (1.0, true));
        }
    }
}
