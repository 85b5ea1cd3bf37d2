//! The branches of a component and the nodes that they share.

use nalgebra::{Point3, Vector3};

use crate::centerline::component::ComponentGraph;
use crate::centerline::connection::subsampling::{Anchor, subsample};
use crate::centerline::graph::{Branch, Node, NodeKind};
use crate::centerline::laplacian_smoothing::branch::FIRM;
use crate::centerline::laplacian_smoothing::continuation::Process;
use crate::centerline::segmentation::track::Track;
use crate::centerline::tips::Chain;
use crate::centerline::tips::reeb::ReebGraph;

/// A place where branches end or meet.
#[derive(Debug, Clone, Copy)]
pub struct NetworkNode {
    /// Vertex of the Reeb node that it came from.
    pub vertex: u32,
    pub anchor: Option<Anchor>,
}

/// Tracks and nodes.
#[derive(Debug, Clone, Default)]
pub struct Network {
    pub nodes: Vec<NetworkNode>,
    pub tracks: Vec<Track>,
}

impl Network {
    /// One track a chain, without stations yet.
    pub fn new(graph: &ReebGraph, chains: &[Chain]) -> Self {
        let mut name = vec![usize::MAX; graph.nodes.len()];
        let mut nodes = Vec::new();
        let mut number = |reeb: u32| {
            let slot = &mut name[reeb as usize];
            if *slot == usize::MAX {
                *slot = nodes.len();
                nodes.push(NetworkNode { vertex: graph.nodes[reeb as usize].vertex, anchor: None });
            }
            *slot
        };
        let track = |(place, chain): (usize, &Chain)| Track {
            chain: place,
            from: number(chain.from),
            to: number(chain.to),
            rings: Vec::new(),
            stations: Vec::new(),
            bulge: None,
            stiffness: FIRM,
            process: Process::default(),
        };
        let tracks = chains.iter().enumerate().map(track).collect();
        Self { nodes, tracks }
    }

    /// The branch ends at a node: track, and whether it is the track's last station that looks at it.
    pub fn incident(&self, node: usize) -> Vec<(usize, bool)> {
        let mut ends = Vec::new();
        for (index, track) in self.tracks.iter().enumerate() {
            if track.from == node {
                ends.push((index, false));
            }
            if track.to == node {
                ends.push((index, true));
            }
        }
        ends
    }

    pub fn is_end(&self, node: usize) -> bool {
        self.incident(node).len() == 1
    }

    /// A node where nothing but the two ends of one track meet.
    pub fn is_ring(&self, node: usize) -> bool {
        matches!(self.incident(node)[..], [(a, _), (b, _)] if a == b)
    }

    pub fn anchor(&self, node: usize) -> Option<Anchor> {
        self.nodes[node].anchor
    }

    /// Lets `work` see a track so that it runs toward the node in question.
    pub fn oriented<T>(&mut self, track: usize, at_end: bool, work: impl FnOnce(&mut Track) -> T) -> T {
        self.tracks[track].oriented(at_end, work)
    }

    /// A copy of a track, without its rings, that runs toward the node in question.
    pub fn toward(&self, track: usize, at_end: bool) -> Track {
        let track = &self.tracks[track];
        let mut copy = Track { rings: Vec::new(), stations: track.stations.clone(), ..*track };
        if !at_end {
            copy.reverse();
        }
        copy
    }

    /// Middle of the stations nearest to a joint; `None` where no branch has any.
    pub fn prior(&self, incident: &[(usize, bool)]) -> Option<Point3<f64>> {
        let nearest = incident.iter().filter_map(|&(track, at_end)| {
            let stations = &self.tracks[track].stations;
            if at_end { stations.last() } else { stations.first() }
        });
        let points: Vec<Point3<f64>> = nearest.map(|station| station.point).collect();
        let origin = *points.first()?;
        let sum: Vector3<f64> = points.iter().map(|p| p - origin).sum();
        Some(origin + sum / points.len() as f64)
    }

    /// Radius at a joint: that of the widest branch there.
    pub fn joint_radius(&self, incident: &[(usize, bool)]) -> f64 {
        let ends = incident.iter().filter_map(|&(track, at_end)| {
            let stations = &self.tracks[track].stations;
            if at_end { stations.last() } else { stations.first() }
        });
        ends.map(|station| station.radius).fold(0.0, f64::max)
    }

    /// Joins the joints at both ends of a branch that never shows a section of its own: a
    /// trifurcation is one joint, even if its branches part at slightly different places.
    pub fn contract_short(&mut self, trusted: &[bool]) {
        let mut keep = vec![true; self.tracks.len()];
        for index in 0..self.tracks.len() {
            let track = &self.tracks[index];
            let inner = track.from != track.to && !self.is_end(track.from) && !self.is_end(track.to);
            let length = track.way();
            let radius = track.stations.iter().map(|s| s.section_radius).fold(0.0, f64::max);
            if !inner || (trusted[index] && length > radius) || track.rings.len() > 12 {
                continue;
            }
            self.join(index);
            keep[index] = false;
        }
        self.retain(&keep);
    }

    /// Joins joints whose centres turned out to lie within half a radius of each other; the nodes that stay. `carried`:
    /// whether the lines of those that go are led to the centres that stay.
    pub fn contract_close(&mut self, carried: bool) -> Vec<usize> {
        const CLOSE: f64 = 0.5;
        let mut joined = Vec::new();
        let mut keep = vec![true; self.tracks.len()];
        for (index, keep) in keep.iter_mut().enumerate() {
            let track = &self.tracks[index];
            let inner = track.from != track.to && !self.is_end(track.from) && !self.is_end(track.to);
            let (Some(a), Some(b)) = (self.anchor(track.from), self.anchor(track.to)) else { continue };
            let close = (a.point - b.point).norm() < CLOSE * a.radius.max(b.radius);
            if inner && close && self.is_straightest(index) {
                if carried {
                    self.carry(track.to, index, &(a.point - b.point), a.radius.max(b.radius));
                }
                joined.push(self.join(index));
                *keep = false;
            }
        }
        self.retain(&keep);
        joined.retain(|&node| !self.incident(node).is_empty());
        joined.sort_unstable();
        joined.dedup();
        joined
    }

    /// Whether no other track between the same nodes is shorter: that would be the joint, and this one a handle on it.
    fn is_straightest(&self, index: usize) -> bool {
        let ends = |track: &Track| [track.from.min(track.to), track.from.max(track.to)];
        let own = &self.tracks[index];
        let beside = self.tracks.iter().filter(|&other| ends(other) == ends(own));
        beside.map(Track::way).all(|way| way >= own.way())
    }

    /// Leads the branches at a joint that is joined away, all but the track to the one that stays, to that one's centre.
    fn carry(&mut self, gone: usize, but: usize, moved: &Vector3<f64>, radius: f64) {
        /// How far from the joint the lines move along, in its radii.
        const REACH: f64 = 2.0;
        for (index, at_end) in self.incident(gone).into_iter().filter(|&(index, _)| index != but) {
            self.oriented(index, at_end, |track| {
                let mut way = 0.0;
                let mut before: Option<Point3<f64>> = None;
                for station in track.stations.iter_mut().rev() {
                    way +=
                        before.replace(station.point).map_or(0.0, |before| (station.point - before).norm());
                    let share = (1.0 - way / (REACH * radius)).max(0.0);
                    station.point += moved * (share * share);
                }
            });
        }
    }

    /// Makes the two nodes of a track one, which it returns.
    fn join(&mut self, track: usize) -> usize {
        let (gone, stays) = (self.tracks[track].to, self.tracks[track].from);
        if let (Some(other), Some(anchor)) = (self.anchor(gone), &mut self.nodes[stays].anchor) {
            anchor.radius = anchor.radius.max(other.radius);
        }
        for other in &mut self.tracks {
            if other.from == gone {
                other.from = stays;
            }
            if other.to == gone {
                other.to = stays;
            }
        }
        stays
    }

    fn retain(&mut self, keep: &[bool]) {
        let mut flags = keep.iter();
        self.tracks.retain(|_| *flags.next().unwrap_or(&true));
    }

    /// The result: smooth points between the nodes, with radii.
    pub fn connect(&self) -> ComponentGraph {
        let mut graph = ComponentGraph::default();
        let mut name = vec![usize::MAX; self.nodes.len()];
        for (index, node) in self.nodes.iter().enumerate() {
            let incident = self.incident(index);
            let seam = self.tracks.iter().find(|t| t.from == index).and_then(|t| t.stations.first());
            let anchor = match (node.anchor, seam) {
                (Some(anchor), _) => anchor,
                (None, Some(station)) => Anchor { point: station.point, radius: station.radius },
                (None, None) => continue,
            };
            if incident.is_empty() {
                continue;
            }
            name[index] = graph.nodes.len();
            let kind = if incident.len() == 1 { NodeKind::End } else { NodeKind::Junction };
            let Anchor { point: position, radius } = anchor;
            graph.nodes.push(Node { kind, position, radius, equivalent_radius: radius });
        }
        for track in &self.tracks {
            let (from, to) = (name[track.from], name[track.to]);
            if from == usize::MAX || to == usize::MAX {
                continue;
            }
            let (start, end) = (&graph.nodes[from], &graph.nodes[to]);
            let inner = track.stations.iter();
            let skip = usize::from(self.is_ring(track.from));
            let points: Vec<Point3<f64>> = [start.position]
                .into_iter()
                .chain(inner.clone().skip(skip).map(|s| s.point))
                .chain([end.position])
                .collect();
            let radii: Vec<f64> = [start.radius]
                .into_iter()
                .chain(inner.skip(skip).map(|s| s.radius))
                .chain([end.radius])
                .collect();
            let (points, radii) = subsample(&points, &radii);
            graph.branches.push(Branch::new(from, to, points, radii));
        }
        graph
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Unit;

    use super::*;
    use crate::centerline::segmentation::track::Station;

    /// Joints and ends at places along x with radius 1, and tracks between them through `middles`.
    fn network(places: &[f64], tracks: &[(usize, usize, &[[f64; 2]])]) -> Network {
        let anchor = |&x: &f64| Some(Anchor { point: Point3::new(x, 0.0, 0.0), radius: 1.0 });
        let nodes = places.iter().map(|place| NetworkNode { vertex: 0, anchor: anchor(place) }).collect();
        let station = |&[x, y]: &[f64; 2]| {
            Station::rough(Point3::new(x, y, 0.0), Unit::new_normalize(Vector3::x()), 1.0, 0)
        };
        let track = |&(from, to, middles): &(usize, usize, &[[f64; 2]])| Track {
            chain: 0,
            from,
            to,
            rings: Vec::new(),
            stations: middles.iter().map(station).collect(),
            bulge: None,
            stiffness: FIRM,
            process: Process::default(),
        };
        Network { nodes, tracks: tracks.iter().map(track).collect() }
    }

    #[test]
    fn a_chain_of_close_joints_becomes_one() {
        let ways: [(usize, usize, &[[f64; 2]]); 7] = [
            (3, 0, &[[-4.0, 0.0], [-0.5, 0.0]]),
            (0, 1, &[[0.0, 0.0], [0.2, 0.0]]),
            (1, 2, &[[0.2, 0.0], [0.4, 0.0]]),
            (0, 4, &[[0.0, 0.5], [0.0, 9.0]]),
            (1, 5, &[[0.2, 0.5], [0.2, 9.0]]),
            (2, 6, &[[0.4, 0.5], [0.4, 9.0]]),
            (2, 7, &[[0.4, -0.5], [0.4, -9.0]]),
        ];
        let mut found = network(&[0.0, 0.2, 0.4, -5.0, 0.0, 0.2, 0.4, 0.4], &ways);
        assert_eq!(found.contract_close(true), [0]);
        assert_eq!((found.tracks.len(), found.incident(0).len()), (5, 5));
        // The last branch was led to the first joint's centre, its far end not.
        let [near, far] = [0, 1].map(|i| found.tracks[4].stations[i].point.x);
        assert!((near - 0.0).abs() < 1e-9 && (far - 0.4).abs() < 1e-9, "{near} {far}");
        assert!(found.contract_close(true).is_empty());
    }

    #[test]
    fn a_handle_on_a_joint_stays_whatever_its_number() {
        let handle: [[f64; 2]; 3] = [[0.0, 0.0], [0.2, 3.0], [0.4, 0.0]];
        let ways: [(usize, usize, &[[f64; 2]]); 4] = [
            (0, 1, &handle),
            (0, 1, &[[0.0, 0.0], [0.4, 0.0]]),
            (2, 0, &[[-4.0, 0.0], [-0.5, 0.0]]),
            (1, 3, &[[0.5, 0.0], [4.0, 0.0]]),
        ];
        let mut found = network(&[0.0, 0.4, -5.0, 5.0], &ways);
        assert_eq!(found.contract_close(true), [0]);
        assert_eq!(found.tracks.len(), 3);
        assert_eq!((found.tracks[0].stations.len(), found.tracks[0].from, found.tracks[0].to), (3, 0, 0));
    }
}
