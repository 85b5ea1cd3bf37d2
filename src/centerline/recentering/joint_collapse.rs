//! Joint collapse (IV.D): the points of a joint become one centre, where its branches then meet.
//!
//! As printed a joint is what the linearity finds; which of its points belong together is left open. Here a
//! joint is where branches of the Reeb graph meet, so that the number of joints is right, and its points are
//! those near where the branches' lines cross.

use nalgebra::{Point3, Vector3};

use crate::centerline::connection::network::Network;
use crate::centerline::connection::subsampling::Anchor;
use crate::centerline::cut_plane::CenterlinePoint;
use crate::centerline::cut_plane::normal_lines::NormalLines;
use crate::centerline::point_grid::PointGrid;
use crate::centerline::recentering::joint_centre;
use crate::centerline::segmentation::track::Station;
use crate::centerline::thinning::covariance::Moments;

/// Points closer than this (radii of the thinnest branch) to where the branches cross are of the joint there.
const POINTS_REACH: f64 = 0.75;
/// Fewer points than this do not make a joint.
const FEWEST_POINTS: usize = 20;
/// Samples closer than this (local radii) to a joint's centre are of the joint.
const JOINT_REACH: f64 = 1.5;
/// Nearer than this (local radii) to a joint, a sample that turns off by more than this (cosine) is of the joint.
const STRAY_REACH: f64 = 4.0;
const STRAY_COSINE: f64 = 0.8;
/// Nearer than this (local radii, along the branch) to its last sample, a sample whose largest sphere is smaller
/// than this share of those before it is off the middle: a lumen only widens into a joint.
const OFF_CENTRE_REACH: f64 = 8.0;
const OFF_CENTRE: f64 = 0.75;
/// How many samples before it a sphere is measured against.
const SPHERES: usize = 6;

/// The points that collapse into joint centres, with the normal lines of their cut planes.
pub struct Joints<'a> {
    planes: &'a [CenterlinePoint],
    /// The vertices whose points are in joints, and all.
    members: [Vec<u32>; 2],
    grids: [PointGrid; 2],
}

impl<'a> Joints<'a> {
    /// One point, flag, local radius and plane a vertex.
    pub fn new(points: &[Point3<f64>], joint: &[bool], radii: &[f64], planes: &'a [CenterlinePoint]) -> Self {
        let all = || 0..points.len() as u32;
        let members = [all().filter(|&v| joint[v as usize]).collect(), all().collect::<Vec<u32>>()];
        let cell = radii.iter().sum::<f64>() / radii.len().max(1) as f64;
        let grid = |vertices: &Vec<u32>| {
            PointGrid::new(vertices.iter().map(|&v| points[v as usize]).collect(), cell)
        };
        let grids = [grid(&members[0]), grid(&members[1])];
        Self { planes, members, grids }
    }

    /// Eq. 10 over the cut planes of the joint's points near where the centre is expected; where the
    /// linearity saw no joint, over those of all points there.
    pub fn centre(&self, expected: &Point3<f64>, radius: f64) -> Option<Point3<f64>> {
        for (members, grid) in self.members.iter().zip(&self.grids) {
            let mut near: Vec<usize> = Vec::new();
            grid.for_each_within(expected, POINTS_REACH * radius, |index, _| near.push(index));
            if near.len() >= FEWEST_POINTS {
                return joint_centre(near.iter().map(|&index| &self.planes[members[index] as usize].lines));
            }
        }
        None
    }
}

/// The centre of a joint, `None` where no branch has a sample; takes the samples that are nearer to it than the branches' radii off the branches.
///
/// `sphere` is the distance of a point from the wall, given one that is expected.
pub fn meet(
    network: &mut Network,
    incident: &[(usize, bool)],
    centre: &impl Fn(&Point3<f64>, f64) -> Option<Point3<f64>>,
    sphere: &impl Fn(&Point3<f64>, f64) -> f64,
) -> Option<Anchor> {
    let radius = network.joint_radius(incident);
    for &(track, at_end) in incident {
        network.oriented(track, at_end, |track| drop_off_centre(&mut track.stations, sphere));
    }
    let mut expected = network.prior(incident)?;
    for _ in 0..2 {
        expected = crossing(network, incident).unwrap_or(expected);
        clear(network, incident, &expected);
    }
    let point = centre(&expected, thinnest(network, incident)).unwrap_or(expected);
    clear(network, incident, &point);
    Some(Anchor { point, radius })
}

/// Takes the samples off the end of a branch from the first one on that is off the middle: planes that take in
/// another vessel's wall, or are cut off by a segment's border, put their points there.
fn drop_off_centre(stations: &mut Vec<Station>, sphere: &impl Fn(&Point3<f64>, f64) -> f64) {
    let mut radii: Vec<f64> = stations.iter().map(|station| station.section_radius).collect();
    radii.sort_by(f64::total_cmp);
    let Some(usual) = radii.get(radii.len() / 2) else { return };
    let (mut along, mut first) = (0.0, stations.len() - 1);
    while first > stations.len() / 2 && along < OFF_CENTRE_REACH * usual {
        along += (stations[first].point - stations[first - 1].point).norm();
        first -= 1;
    }
    let from = first.saturating_sub(SPHERES);
    let spheres: Vec<f64> = stations[from..].iter().map(|s| sphere(&s.point, s.section_radius)).collect();
    let off = |i: &usize| {
        let before = &mut spheres[i.saturating_sub(SPHERES)..*i].to_vec();
        before.sort_by(f64::total_cmp);
        before.get(before.len() / 2).is_some_and(|usual| spheres[*i] < OFF_CENTRE * usual)
    };
    if let Some(i) = (3.max(first - from)..spheres.len()).find(off) {
        stations.truncate(from + i);
    }
}

/// The least radius where the branches meet: a thin one leaves the line of a wide one alone but for its own width.
fn thinnest(network: &Network, incident: &[(usize, bool)]) -> f64 {
    let ends = incident.iter().filter_map(|&(track, at_end)| {
        let stations = &network.tracks[track].stations;
        if at_end { stations.last() } else { stations.first() }
    });
    ends.map(|station| station.section_radius).fold(f64::INFINITY, f64::min)
}

/// Takes the samples of a joint off the branches: those near its centre or past it, and from the first one on
/// that leaves the branch's direction on the way there.
fn clear(network: &mut Network, incident: &[(usize, bool)], centre: &Point3<f64>) {
    let thinnest = thinnest(network, incident);
    for &(track, at_end) in incident {
        network.oriented(track, at_end, |track| {
            let away = |station: &Station| (station.point - centre).norm();
            let near = |station: &Station| away(station) < JOINT_REACH * station.section_radius.min(thinnest);
            let stations = &mut track.stations;
            // Past the centre the way to it grows again.
            while let [.., before, last] = &stations[..]
                && (near(last) || away(before) < away(last))
            {
                stations.pop();
            }
            let strays = |i: &usize| {
                let [a, b, c] = [i - 2, i - 1, *i].map(|i| stations[i].point);
                away(&stations[*i]) < STRAY_REACH * stations[*i].section_radius
                    && (b - a).dot(&(c - b)) < STRAY_COSINE * (b - a).norm() * (c - b).norm()
            };
            if let Some(first) = (stations.len() / 2..stations.len()).filter(|i| *i > 2).find(strays) {
                stations.truncate(first);
            }
        });
    }
}

/// Where the branches' lines cross, as far as they do: eq. 10 over the lines instead of the wall's normals.
fn crossing(network: &mut Network, incident: &[(usize, bool)]) -> Option<Point3<f64>> {
    let mut runs: Vec<Vec<Vector3<f64>>> = incident
        .iter()
        .map(|&(track, at_end)| network.oriented(track, at_end, |track| last_run(&track.stations)))
        .collect();
    runs.retain(|run| !run.is_empty());
    let nearest: Vector3<f64> = runs.iter().map(|run| run[0]).sum();
    let mut lines = NormalLines::default();
    for run in &runs {
        let from = run[0];
        if run.len() >= 3 {
            let moments = Moments::of(run.iter().map(|point| point - from));
            lines.add(Point3::from(from + moments.mean()), moments.principal_axes().vectors[0]);
        } else if runs.len() > 1 {
            // A sac has no direction of its own: it points at the middle of the others.
            let others = (nearest - from) / (runs.len() - 1) as f64;
            if let Some(direction) = (from - others).try_normalize(0.0) {
                lines.add(Point3::from(from), direction);
            }
        }
    }
    if lines.count() > 1.0 { lines.nearest_point() } else { None }
}

/// The points of the last stations, from the last one back for three local radii, and three of them at least.
fn last_run(stations: &[Station]) -> Vec<Vector3<f64>> {
    let Some(last) = stations.last() else { return Vec::new() };
    let near = |station: &Station| (station.point - last.point).norm() <= 3.0 * last.section_radius;
    let back = stations.iter().rev().enumerate();
    back.take_while(|(count, station)| *count < 3 || near(station)).map(|(_, s)| s.point.coords).collect()
}
