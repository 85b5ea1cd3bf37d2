//! Sub-sampling of the centerline points and their connection into the 1D centerline (IV.D).
//!
//! The paper does not print how. Here the Reeb graph is the skeleton to hang them on: the points of the
//! vertices between two of its nodes, in bands of the level, become the samples of one branch, so that parts
//! and loops are right whatever the points do.

pub mod network;
pub mod subsampling;
pub mod unsupported;

use nalgebra::{Point3, Vector3};

use crate::centerline::ExtractError;
use crate::centerline::component::ComponentGraph;
use crate::centerline::connection::network::Network;
use crate::centerline::connection::subsampling::Anchor;
use crate::centerline::control::{Control, Stage};
use crate::centerline::point_grid::PointGrid;
use crate::centerline::recentering::ends::{end_point, far_wall};
use crate::centerline::recentering::joint_collapse::meet;
use crate::centerline::segmentation::track::{Bulge, Station, Track, tangents};
use crate::centerline::tips::Chain;
use crate::centerline::tips::reeb::ReebGraph;
use crate::centerline::triangle_grid::TriangleGrid;

/// Width of a band of the level, in local radii.
const BAND: f64 = 0.5;
/// The line is led from the last sample this far (local radii) before a cap on to the cap: nearer, cut planes
/// run along the axis and say nothing.
const CAP_REACH: f64 = 1.0;
/// Samples nearer than this (local radii) to the mouth of an excluded branch are drawn into it.
const MOUTH_REACH: f64 = 1.5;
/// Samples closer than this (local radii) to the one before say nothing more.
const CROWD: f64 = 0.2;
/// A gap wider than this (local radii) between samples is filled where the line has points.
const GAP: f64 = 1.0;

/// Points of every vertex, and the Reeb graph's chains over the same vertices.
pub struct Connection<'a> {
    pub grid: &'a TriangleGrid<'a>,
    pub reeb: &'a ReebGraph,
    pub chains: &'a [Chain],
    /// Reeb arcs of ends that are not wanted: the line is not to be led there.
    pub excluded: &'a [u32],
    /// Centerline point of each vertex, re-centered, in the input's frame.
    pub points: &'a [Point3<f64>],
    /// Local radius at each vertex.
    pub radii: &'a [f64],
    /// Whether the vertex's point belongs to a joint.
    pub joint: &'a [bool],
}

/// The mean of a band's points.
#[derive(Debug, Clone, Copy)]
struct Sample {
    point: Point3<f64>,
    radius: f64,
    /// Geodesic way from the start of the chain.
    along: f64,
}

impl Connection<'_> {
    /// The component's graph: a sample a band along every branch, led to the caps and to one centre a joint.
    ///
    /// `centre` gives a joint's centre from where it is expected and the local radius there.
    /// `O(n log n)`.
    ///
    /// # Errors
    /// [`ExtractError::Cancelled`].
    pub fn connect(
        &self,
        centre: impl Fn(&Point3<f64>, f64) -> Option<Point3<f64>>,
        radius: impl Fn(&Point3<f64>, f64) -> f64,
        control: &Control<'_>,
    ) -> Result<ComponentGraph, ExtractError> {
        control.report(Stage::Connection, 0.0)?;
        let mut network = Network::new(self.reeb, self.chains);
        let line = self.branch_points();
        for (index, chain) in self.chains.iter().enumerate() {
            control.cancel.check()?;
            let nodes = [network.tracks[index].from, network.tracks[index].to];
            let samples = self.clear_samples(chain, nodes.map(|node| network.is_end(node)));
            let samples = bridged(&samples, network.is_ring(nodes[0]), &line);
            network.tracks[index].stations = stations(&samples);
        }
        network.contract_short(&vec![true; network.tracks.len()]);
        // Joints first: a short branch is led to its end from there.
        for node in 0..network.nodes.len() {
            control.cancel.check()?;
            let incident = network.incident(node);
            if incident.len() > 1 && !network.is_ring(node) {
                network.nodes[node].anchor = meet(&mut network, &incident, &centre, &radius);
            }
        }
        for node in 0..network.nodes.len() {
            control.cancel.check()?;
            if let [(track, at_end)] = network.incident(node)[..] {
                network.nodes[node].anchor = Some(self.end(&mut network, node, track, at_end));
            }
        }
        control.report(Stage::Connection, 0.5)?;
        for station in network.tracks.iter_mut().flat_map(|track| &mut track.stations) {
            station.radius = radius(&station.point, station.section_radius);
        }
        for node in 0..network.nodes.len() {
            let Some(anchor) = network.nodes[node].anchor else { continue };
            let found = match network.incident(node)[..] {
                [(track, at_end)] => network.oriented(track, at_end, |track| radius_before(track, anchor)),
                _ => radius(&anchor.point, anchor.radius),
            };
            network.nodes[node].anchor = Some(Anchor { radius: found, ..anchor });
        }
        control.report(Stage::Connection, 1.0)?;
        Ok(network.connect())
    }

    /// The vertices of a chain from its start to its end, with the geodesic way to each, and the whole way.
    fn vertices(&self, chain: &Chain) -> (Vec<(f64, u32)>, f64) {
        let mut all = Vec::new();
        let mut base = 0.0;
        for &(index, upward) in &chain.arcs {
            let arc = &self.reeb.arcs[index as usize];
            let [low, high] = [arc.lower, arc.upper].map(|node| self.reeb.nodes[node as usize].level);
            let level = |v: u32| self.reeb.function[v as usize];
            if upward {
                all.extend(arc.vertices.iter().map(|&v| (base + level(v) - low, v)));
            } else {
                all.extend(arc.vertices.iter().rev().map(|&v| (base + high - level(v), v)));
            }
            base += high - low;
        }
        (all, base)
    }

    /// The points of the branches alone that are wanted, to be searched.
    fn branch_points(&self) -> PointGrid {
        let mut left_out = self.joint.to_vec();
        for &arc in self.excluded {
            self.reeb.arcs[arc as usize].vertices.iter().for_each(|&v| left_out[v as usize] = true);
        }
        let points = self.points.iter().zip(left_out);
        let of_branches = points.filter(|(_, left_out)| !left_out).map(|(point, _)| *point).collect();
        let mut radii = self.radii.to_vec();
        radii.sort_by(f64::total_cmp);
        PointGrid::new(of_branches, radii.get(radii.len() / 2).copied().unwrap_or(1.0))
    }

    /// A sample a band, without those of joints and of caps; `ends` says which of the chain's two ends are caps.
    fn clear_samples(&self, chain: &Chain, ends: [bool; 2]) -> Vec<Sample> {
        let (vertices, whole) = self.vertices(chain);
        let of_branches = |v: u32| !self.joint[v as usize];
        let mut samples = self.samples(&vertices, of_branches);
        if samples.len() < 3 {
            samples = self.samples(&vertices, |_| true);
        }
        let mouths = self.mouths(chain);
        let clear = |sample: &&Sample| {
            let reach = (CAP_REACH * sample.radius).min(whole / 3.0);
            let beside = |mouth: &f64| (sample.along - mouth).abs() < MOUTH_REACH * sample.radius;
            (!ends[0] || sample.along > reach)
                && (!ends[1] || whole - sample.along > reach)
                && !mouths.iter().any(beside)
        };
        let clear: Vec<Sample> = samples.iter().filter(clear).copied().collect();
        let mut samples = if clear.is_empty() { samples } else { clear };
        samples.dedup_by(|b, a| (b.point - a.point).norm() < CROWD * a.radius);
        samples
    }

    /// The geodesic ways from the start of a chain at which excluded branches leave it.
    fn mouths(&self, chain: &Chain) -> Vec<f64> {
        let leaves = |node: u32| {
            let ends = self.excluded.iter().map(|&arc| &self.reeb.arcs[arc as usize]);
            ends.flat_map(|arc| [arc.lower, arc.upper]).any(|end| end == node)
        };
        let mut way = 0.0;
        let mut found = Vec::new();
        for &(index, upward) in &chain.arcs {
            let arc = &self.reeb.arcs[index as usize];
            let [low, high] = [arc.lower, arc.upper].map(|node| self.reeb.nodes[node as usize].level);
            way += high - low;
            found.extend(leaves(if upward { arc.upper } else { arc.lower }).then_some(way));
        }
        found
    }

    fn samples(&self, vertices: &[(f64, u32)], counts: impl Fn(u32) -> bool) -> Vec<Sample> {
        let mut samples = Vec::new();
        let mut rest = vertices;
        while let Some(&(start, first)) = rest.first() {
            let width = BAND * self.radii[first as usize];
            let count = rest.partition_point(|&(along, _)| along < start + width).max(1);
            let (band, after) = rest.split_at(count);
            rest = after;
            samples.extend(self.sample(band, &counts));
        }
        samples
    }

    /// The middle of a band's points, of those that count; `None` unless most do.
    ///
    /// The mean of all lies inside a bend and follows stragglers: it is taken again over the quarter nearest to it.
    fn sample(&self, band: &[(f64, u32)], counts: impl Fn(u32) -> bool) -> Option<Sample> {
        let mut counted: Vec<(f64, u32)> = band.iter().copied().filter(|&(_, v)| counts(v)).collect();
        let point = |v: u32| self.points[v as usize];
        let mean = |of: &[(f64, u32)]| {
            let sum: Vector3<f64> = of.iter().map(|&(_, v)| point(v).coords).sum();
            Point3::from(sum / of.len() as f64)
        };
        if 2 * counted.len() <= band.len() {
            return None;
        }
        let all = counted.len() as f64;
        let along = counted.iter().map(|&(way, _)| way).sum::<f64>() / all;
        let radius = counted.iter().map(|&(_, v)| self.radii[v as usize]).sum::<f64>() / all;
        let middle = mean(&counted);
        let away = |v: u32| (point(v) - middle).norm_squared();
        counted.sort_by(|a, b| away(a.1).total_cmp(&away(b.1)).then(a.1.cmp(&b.1)));
        counted.truncate(counted.len().div_ceil(4));
        Some(Sample { point: mean(&counted), radius, along })
    }

    /// Where the line meets the cap ahead of it; the tip's vertex for a branch without samples.
    fn end(&self, network: &mut Network, node: usize, track: usize, at_end: bool) -> Anchor {
        let tip = network.nodes[node].vertex;
        let other = if at_end { network.tracks[track].from } else { network.tracks[track].to };
        let joint = network.anchor(other);
        let end = network.oriented(track, at_end, |track| {
            // Two samples of a sac have no direction worth the name: it runs from the joint through them.
            let few = (1..3).contains(&track.stations.len());
            let middle = track.stations.first().filter(|_| few);
            let sac = middle.map(|s| Bulge::ball(s.point, s.section_radius));
            let across = joint.zip(sac).and_then(|(joint, sac)| far_wall(self.grid, &sac, &joint.point));
            across.unwrap_or_else(|| end_point(self.grid, track, tip))
        });
        Anchor { point: end.point, radius: end.radius }
    }
}

/// Samples in the gaps between others, where the bands' vertices went to bumps that are no branches: of the
/// line's points nearest to the middle of the gap. A ring's last sample is followed by its first.
fn bridged(samples: &[Sample], ring: bool, line: &PointGrid) -> Vec<Sample> {
    let mut all = Vec::with_capacity(samples.len());
    for (k, sample) in samples.iter().enumerate() {
        all.push(*sample);
        let next = if ring { samples.get((k + 1) % samples.len()) } else { samples.get(k + 1) };
        if let Some(next) = next {
            fill_gap(sample, next, 4, line, &mut all);
        }
    }
    all
}

fn fill_gap(a: &Sample, b: &Sample, depth: usize, line: &PointGrid, all: &mut Vec<Sample>) {
    let radius = 0.5 * (a.radius + b.radius);
    let gap = (b.point - a.point).norm();
    if depth == 0 || gap <= GAP * radius {
        return;
    }
    let middle = nalgebra::center(&a.point, &b.point);
    let mut nearest = (0.5 * gap, middle);
    line.for_each_within(&middle, 0.5 * gap, |index, distance| {
        if distance < nearest.0 {
            nearest = (distance, line.point(index));
        }
    });
    let (mut sum, mut count) = (Vector3::zeros(), 0.0);
    line.for_each_within(&nearest.1, 0.5 * BAND * radius, |index, _| {
        sum += line.point(index).coords;
        count += 1.0;
    });
    let point = Point3::from(sum / count);
    // Where the line has no points (in a joint) the gap stays.
    if count < 1.0 || (point - a.point).norm().max((point - b.point).norm()) > 0.9 * gap {
        return;
    }
    let between = Sample { point, radius, along: 0.5 * (a.along + b.along) };
    fill_gap(a, &between, depth - 1, line, all);
    all.push(between);
    fill_gap(&between, b, depth - 1, line, all);
}

fn stations(samples: &[Sample]) -> Vec<Station> {
    let points: Vec<Point3<f64>> = samples.iter().map(|sample| sample.point).collect();
    let directed = samples.iter().zip(tangents(&points));
    directed.map(|(sample, tangent)| Station::rough(sample.point, tangent, sample.radius, 0)).collect()
}

/// The radius of the vessel that a cap cuts, for the cap and the stations whose nearest wall it is.
fn radius_before(track: &mut Track, cap: Anchor) -> f64 {
    let clear = |station: &Station| (station.point - cap.point).norm() > 1.2 * station.section_radius;
    let Some(last) = track.stations.iter().rposition(clear) else {
        return track.stations.first().map_or(cap.radius, |station| station.radius);
    };
    let radius = track.stations[last].radius;
    track.stations[last..].iter_mut().for_each(|station| station.radius = radius);
    radius
}
