//! The branches led into their joints, a few rounds: centres of the joints, the way of each branch to them, and the
//! branches' own sections cut anew where that moved them (IV.D).
//!
//! In a round each joint sees what those before it did to their branches; joints that are no neighbours go at once.

use nalgebra::Point3;
use rayon::prelude::*;
use rustc_hash::FxHashMap;

use crate::mesh::preparation::Surface;

use crate::centerline::connection::network::Network;
use crate::centerline::connection::subsampling::{Anchor, settle_radii};
use crate::centerline::cut_plane::bulges::line_through;
use crate::centerline::cut_plane::cross_sections::recut;
use crate::centerline::laplacian_smoothing::branch::{smooth, smooth_ring};
use crate::centerline::recentering::approach::{Approach, run_up};
use crate::centerline::recentering::ends::{EndPoint, far_wall};
use crate::centerline::recentering::joints::{joint_centre, run_to_centre};
use crate::centerline::segmentation::level_sets::LevelSet;
use crate::centerline::segmentation::track::{Bulge, Track};
use crate::centerline::triangle_grid::TriangleGrid;
use crate::centerline::{Control, ExtractError, Stage};

/// Rounds of centering joints and judging the walls on the way to them.
const ROUNDS: usize = 4;
/// How far around a joint level sets may tell of its wall, in their radii.
const AROUND: f64 = 8.0;
/// How far the mouth of a sac's stalk may lie from its joint, in the widest radius there.
const ASTRAY: f64 = 3.0;

/// Where branches meet, as their lines tell it, and the level sets around it.
struct Meeting {
    centre: Anchor,
    rings: Vec<LevelSet>,
    /// Sacs on stalks that bend, as they are without their necks' axes, which lead elsewhere.
    bent: Vec<(usize, Bulge)>,
}

/// Finds the joints' centres and leads the branches into them.
///
/// # Errors
/// [`ExtractError::Cancelled`].
pub fn meet_in_joints(
    grid: &TriangleGrid<'_>,
    owners: &[u32],
    network: &mut Network,
    control: &Control<'_>,
) -> Result<(), ExtractError> {
    for round in 0..ROUNDS {
        control.report(Stage::Recentering, round as f64 / ROUNDS as f64)?;
        for batch in batches(network) {
            meet(grid, owners, network, &batch, control)?;
        }
        if round == 0 {
            let _ = network.contract_close(false);
        }
        settle(grid.surface(), network);
    }
    Ok(())
}

/// The joints in batches: none sees branches that another of its batch moves, and as in the order of their numbers all
/// that come before it have moved theirs. O(branches x those that meet at a joint).
fn batches(network: &Network) -> Vec<Vec<usize>> {
    let mut around = vec![Vec::new(); network.nodes.len()];
    for track in &network.tracks {
        around[track.from].push(track.to);
        around[track.to].push(track.from);
    }
    let is_ring = |node: usize| around[node] == [node, node];
    let mut batches: Vec<Vec<usize>> = Vec::new();
    let mut batch_after = vec![0; around.len()];
    for node in (0..around.len()).filter(|&node| around[node].len() > 1 && !is_ring(node)) {
        // A joint sees its branches, and beyond their other ends those that they continue.
        let near = around[node].iter().flat_map(|&other| around[other].iter().copied().chain([other]));
        let batch = near.map(|other| batch_after[other]).max().unwrap_or(0);
        batch_after[node] = batch + 1;
        batches.resize(batches.len().max(batch + 1), Vec::new());
        batches[batch].push(node);
    }
    batches
}

/// Finds the centres of the joints of one batch, and leads their branches in.
fn meet(
    grid: &TriangleGrid<'_>,
    owners: &[u32],
    network: &mut Network,
    joints: &[usize],
    control: &Control<'_>,
) -> Result<(), ExtractError> {
    let seen = &*network;
    let one = |&node: &usize| {
        control.cancel.check()?;
        Ok(Meeting::of(grid.surface(), seen, node))
    };
    let found: Vec<Meeting> = joints.par_iter().map(one).collect::<Result<_, ExtractError>>()?;
    for (&node, meeting) in joints.iter().zip(&found) {
        for &(track, bulge) in &meeting.bent {
            network.tracks[track].bulge = Some(bulge);
        }
        network.nodes[node].anchor = Some(meeting.centre);
        aim_bulges(grid, network, &network.incident(node), &meeting.centre.point);
    }
    let meetings = joints.iter().copied().zip(&found).collect();
    lead_in(grid.surface(), owners, network, &meetings, control)
}

impl Meeting {
    fn of(surface: &Surface, network: &Network, node: usize) -> Self {
        let incident = network.incident(node);
        let radius = network.joint_radius(&incident);
        let approach = |&(track, at_end): &(usize, bool)| {
            let before = run_up(network, track, at_end);
            Some((track, Approach::of(&network.toward(track, at_end), &before)?))
        };
        let mut approaches: Vec<(usize, Approach)> = incident.iter().filter_map(approach).collect();
        let on_wall = surface.mesh.vertices[network.nodes[node].vertex as usize];
        let prior = network.prior(&incident).unwrap_or(on_wall);
        let (point, bent) = centre_and_strays(network, &mut approaches, &prior, radius);
        let near = |ring: &&LevelSet| (ring.centroid - point).norm() < AROUND * ring.radius();
        let all = incident.iter().flat_map(|&(track, _)| &network.tracks[track].rings);
        let rings = all.filter(near).cloned().collect();
        Self { centre: Anchor { point, radius }, rings, bent }
    }
}

/// The centre of a joint of such a radius, and the sacs whose necks lead far from it, which say nothing of it then. One
/// that leads astray may have drawn the others' joint away: the farthest goes first.
fn centre_and_strays(
    network: &Network,
    approaches: &mut [(usize, Approach)],
    prior: &Point3<f64>,
    radius: f64,
) -> (Point3<f64>, Vec<(usize, Bulge)>) {
    let centre = |approaches: &[(usize, Approach)]| {
        let lines: Vec<Approach> = approaches.iter().map(|(_, approach)| *approach).collect();
        joint_centre(&lines, prior)
    };
    let with_mouth = |(slot, &(track, _)): (usize, &(usize, Approach))| {
        let bulge = network.tracks[track].bulge?;
        Some((slot, bulge, bulge.neck?.mouth?))
    };
    let mut sacs: Vec<_> = approaches.iter().enumerate().filter_map(with_mouth).collect();
    let mut strays = Vec::new();
    let mut point = centre(approaches);
    loop {
        let off = |i: &usize| (sacs[*i].2 - point).norm();
        let farthest = (0..sacs.len()).max_by(|a, b| off(a).total_cmp(&off(b)));
        let Some(stray) = farthest.filter(|i| radius > 0.0 && off(i) > ASTRAY * radius) else { break };
        let (slot, bulge, _) = sacs.remove(stray);
        let bulge = bulge.on_a_bent_stalk();
        approaches[slot].1 = Approach::of_bulge(&bulge);
        strays.push((approaches[slot].0, bulge));
        point = centre(approaches);
    }
    (point, strays)
}

/// Draws the lines of the bulges at a joint straight from its centre through their middles.
pub fn aim_bulges(
    grid: &TriangleGrid<'_>,
    network: &mut Network,
    incident: &[(usize, bool)],
    centre: &Point3<f64>,
) {
    for &(index, at_end) in incident {
        let track = &network.tracks[index];
        let Some(bulge) = &track.bulge else { continue };
        let far = if at_end { track.from } else { track.to };
        let tip = grid.surface().mesh.vertices[network.nodes[far].vertex as usize];
        let end = far_wall(grid, bulge, centre).unwrap_or(EndPoint { point: tip, radius: 0.0 });
        let stations = line_through(grid, track, centre, &end.point, !at_end);
        network.nodes[far].anchor = Some(Anchor { point: end.point, radius: end.radius });
        network.tracks[index].stations = stations;
    }
}

/// Runs the branches of some joints to their centres, each judged by the level sets of all that meet there.
fn lead_in(
    surface: &Surface,
    owners: &[u32],
    network: &mut Network,
    meetings: &FxHashMap<usize, &Meeting>,
    control: &Control<'_>,
) -> Result<(), ExtractError> {
    network.tracks.par_iter_mut().filter(|track| track.is_line()).try_for_each(|track| {
        for (node, at_end) in [(track.from, false), (track.to, true)] {
            let Some(Meeting { centre, rings, .. }) = meetings.get(&node) else { continue };
            control.cancel.check()?;
            track.oriented(at_end, |track| run_to_centre(surface, owners, track, &centre.point, rings));
        }
        Ok(())
    })
}

/// Smooths every branch between its ends, cuts it anew where that moved it, and smooths it again.
fn settle(surface: &Surface, network: &mut Network) {
    let anchors: Vec<_> =
        network.tracks.iter().map(|t| (network.anchor(t.from), network.anchor(t.to))).collect();
    let rings: Vec<bool> = network.tracks.iter().map(|t| network.is_ring(t.from)).collect();
    let work = network.tracks.par_iter_mut().zip(anchors).zip(rings);
    work.filter(|((track, _), _)| track.is_line()).for_each(|((track, (from, to)), ring)| {
        let smooth = |track: &mut Track| if ring { smooth_ring(track) } else { smooth(track, from, to) };
        smooth(track);
        recut(surface, track);
        smooth(track);
        settle_radii(&mut track.stations);
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::centerline::connection::network::NetworkNode;
    use crate::centerline::laplacian_smoothing::continuation::Process;

    /// A network of branches between numbered nodes.
    fn network(branches: &[(usize, usize)]) -> Network {
        let count = branches.iter().map(|&(from, to)| from.max(to) + 1).max().unwrap_or(0);
        let track = |&(from, to): &(usize, usize)| Track {
            chain: 0,
            from,
            to,
            rings: Vec::new(),
            stations: Vec::new(),
            bulge: None,
            stiffness: 0.0,
            process: Process::default(),
        };
        Network {
            nodes: vec![NetworkNode { vertex: 0, anchor: None }; count],
            tracks: branches.iter().map(track).collect(),
        }
    }

    #[test]
    fn joints_of_a_batch_are_no_neighbours_and_those_before_have_gone() {
        // A trunk of joints 0 to 6, each with an end of its own.
        let mut branches: Vec<(usize, usize)> = (0..6).map(|joint| (joint, joint + 1)).collect();
        branches.extend((0..7).map(|joint| (joint, 7 + joint)));
        branches.push((0, 14));
        branches.push((6, 15));
        assert_eq!(batches(&network(&branches)), (0..7).map(|joint| vec![joint]).collect::<Vec<_>>());
        // Two forks at either end of a long way of joints that were numbered last.
        let far = [
            (0, 2),
            (1, 3),
            (2, 4),
            (4, 5),
            (5, 3),
            (0, 6),
            (0, 7),
            (1, 8),
            (1, 9),
            (2, 10),
            (3, 11),
            (4, 12),
            (5, 13),
        ];
        assert_eq!(batches(&network(&far)), [vec![0, 1], vec![2, 3], vec![4], vec![5]]);
    }

    #[test]
    fn ends_and_rings_are_no_joints() {
        assert!(batches(&network(&[(0, 1)])).is_empty());
        assert!(batches(&network(&[(0, 0)])).is_empty());
        assert_eq!(batches(&network(&[(0, 0), (0, 1)])), [[0]]);
    }
}
