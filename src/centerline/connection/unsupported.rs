//! Stretches of the line that no section supports: bridged between sections far apart.

use nalgebra::Point3;

use crate::centerline::component::ComponentGraph;
use crate::centerline::graph::Warning;
use crate::centerline::line_tree::LineTree;
use crate::centerline::own_sections::{OwnSection, own_sections};
use crate::centerline::segmentation::track::Sight;
use crate::centerline::triangle_grid::TriangleGrid;

use super::network::Network;

/// Longest stretch without a clean section, in radii of its wider end; into a joint also the joint's.
const LONGEST: f64 = 5.0;

/// Farthest that the line lies from the middle of a section that supports it, in its radii.
const CENTRED: f64 = 0.1;
/// Longest way from one of these sections to the next, in radii of the stretch's wider end.
const SHOWN: f64 = 2.0;
/// Farthest that a point of the line lies from a stretch that it is of, in the stretch's radii.
const BESIDE: f64 = 0.5;

/// A stretch of a branch between two firm places.
struct Stretch {
    length: f64,
    middle: Point3<f64>,
    /// Its points from one firm place to the next.
    points: Vec<Point3<f64>>,
    /// Of its wider end.
    radius: f64,
}

/// A warning of what was bridged and where the line as it was connected, `graph`, shows no sections either: past a throat, where
/// none was like that before, it may run in the middle all the same. O(points of the line), and where there are stretches its own
/// sections and O(sections x points of the stretches).
pub fn check(network: &Network, grid: &TriangleGrid<'_>, graph: &ComponentGraph) -> Option<Warning> {
    let mut stretches = stretches(network);
    if stretches.is_empty() {
        return None;
    }
    let own = own_sections(grid, &LineTree::new(graph), graph, 0..graph.branches.len());
    stretches.retain(|stretch| !stretch.is_shown(&own, graph));
    let longest = stretches.iter().max_by(|a, b| a.length.total_cmp(&b.length))?;
    let at = longest.middle;
    Some(Warning {
        code: "bridged",
        detail: format!(
            "{} stretches of the line show no section of one vessel alone and were bridged, the longest {:.4} long \
             around [{:.4}, {:.4}, {:.4}]: check them",
            stretches.len(),
            longest.length,
            at.x,
            at.y,
            at.z
        ),
    })
}

fn stretches(network: &Network) -> Vec<Stretch> {
    let mut found = Vec::new();
    for track in network.tracks.iter().filter(|track| track.bulge.is_none()) {
        let anchor = |node: usize| network.anchor(node).map(|anchor| (anchor.point, anchor.radius, true));
        let stations =
            track.stations.iter().map(|s| (s.point, s.section_radius, s.sight == Sight::Clean)).map(Some);
        let places: Vec<(Point3<f64>, f64, bool)> =
            [anchor(track.from)].into_iter().chain(stations).chain([anchor(track.to)]).flatten().collect();
        let firm: Vec<usize> = (0..places.len()).filter(|&i| places[i].2).collect();
        for pair in firm.windows(2) {
            let run = &places[pair[0]..=pair[1]];
            let length: f64 = run.windows(2).map(|two| (two[1].0 - two[0].0).norm()).sum();
            let (Some(first), Some(last)) = (run.first(), run.last()) else { continue };
            let radius = first.1.max(last.1);
            if length > LONGEST * radius {
                let points = run.iter().map(|place| place.0).collect();
                found.push(Stretch { length, middle: run[run.len() / 2].0, points, radius });
            }
        }
    }
    found
}

impl Stretch {
    /// Whether the finished line has sections of its own there, in whose middle it lies, without such a gap.
    fn is_shown(&self, own: &[OwnSection], graph: &ComponentGraph) -> bool {
        let mut ways: Vec<f64> = own
            .iter()
            .filter(|section| section.offset < CENTRED * section.radius)
            .filter_map(|section| self.way_to(&graph.branches[section.branch].points[section.place]))
            .collect();
        ways.extend([0.0, self.length]);
        ways.sort_unstable_by(f64::total_cmp);
        ways.windows(2).all(|pair| pair[1] - pair[0] <= SHOWN * self.radius)
    }

    /// How far along it a point lies that is near it.
    fn way_to(&self, point: &Point3<f64>) -> Option<f64> {
        let mut way = 0.0;
        let mut nearest: Option<(f64, f64)> = None;
        for pair in self.points.windows(2) {
            let step = pair[1] - pair[0];
            let share =
                ((point - pair[0]).dot(&step) / step.norm_squared().max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
            let away = (point - (pair[0] + step * share)).norm();
            if away < nearest.map_or(BESIDE * self.radius, |(least, _)| least) {
                nearest = Some((away, way + share * step.norm()));
            }
            way += step.norm();
        }
        nearest.map(|(_, way)| way)
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::centerline::connection::network::NetworkNode;
    use crate::centerline::connection::subsampling::Anchor;
    use crate::centerline::graph::{Branch, Node, NodeKind};
    use crate::centerline::laplacian_smoothing::continuation::Process;
    use crate::centerline::segmentation::track::{Station, Track};
    use crate::centerline::test_surfaces::{capsule, closed_surface};

    /// A line along z of length 20, clean everywhere but between 5 and `until`.
    fn network(until: f64) -> Network {
        let station = |i: i32| {
            let z = 0.5 * f64::from(i);
            let lost = z > 5.0 && z < until;
            let place = Point3::new(0.0, 0.0, z);
            let mut station = Station::rough(place, Vector3::z_axis(), 1.0, 0);
            station.sight = if lost { Sight::Lost } else { Sight::Clean };
            station
        };
        let stations = (1..40).map(station).collect();
        let rings = Vec::new();
        let track = Track {
            chain: 0,
            from: 0,
            to: 1,
            rings,
            stations,
            bulge: None,
            stiffness: 1.0,
            process: Process::default(),
        };
        let node = |z: f64| NetworkNode {
            vertex: 0,
            anchor: Some(Anchor { point: Point3::new(0.0, 0.0, z), radius: 1.0 }),
        };
        Network { nodes: vec![node(0.0), node(20.0)], tracks: vec![track] }
    }

    #[test]
    fn long_gaps_are_told_where_the_line_shows_no_sections_either() {
        let check = |until: f64, aside: f64| {
            let surface = closed_surface(&capsule(1.0, 20.0, 32));
            let points = (0..=40).map(|i| Point3::new(aside, 0.0, 0.5 * f64::from(i))).collect();
            let line = Branch::new(0, 1, points, vec![1.0; 41]);
            let node = |z: f64| Node {
                kind: NodeKind::End,
                position: Point3::new(aside, 0.0, z),
                radius: 1.0,
                equivalent_radius: 1.0,
            };
            let graph = ComponentGraph {
                nodes: vec![node(0.0), node(20.0)],
                branches: vec![line],
                warnings: Vec::new(),
            };
            super::check(&network(until), &TriangleGrid::new(&surface), &graph)
        };
        assert_eq!(check(9.0, 0.4), None);
        let warning = check(12.0, 0.4).unwrap();
        assert_eq!(warning.code, "bridged");
        assert!(warning.detail.starts_with("1 stretches"), "{}", warning.detail);
        assert_eq!(check(12.0, 0.05), None, "it lies in the middle of the vessel");
    }
}
