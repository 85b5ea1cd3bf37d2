//! Joints that the meeting of two fronts has displaced.
//!
//! On a ring, the front that passes a branch's mouth may meet the other before it has parted from the
//! branch: the Reeb graph then has its joint a few radii along the ring, and the branch's track begins
//! with a piece of the ring. The third track still ends at the mouth: there the joint belongs, and what
//! lies before it is given to the track that it is a piece of.

use nalgebra::Point3;

use crate::mesh::preparation::Surface;

use crate::centerline::connection::network::Network;
use crate::centerline::cut_plane::march::{Toward, march};
use crate::centerline::cut_plane::ownership::Wall;
use crate::centerline::segmentation::track::{Sight, Station, Track};

/// A joint is displaced when it lies farther than this (radii) along a track from where another ends.
const FAR: f64 = 3.0;
/// How near (radii) that end must be to the track.
const NEAR: f64 = 1.2;

/// Clean sections in a row that are surely the track's own.
const RUN: usize = 4;

/// Moves every displaced joint of three tracks to its place. O(joints x stations).
pub fn settle_displaced(surface: &Surface, owners: &[u32], network: &mut Network) {
    for node in 0..network.nodes.len() {
        let incident = network.incident(node);
        let &[a, b, c] = &incident[..] else { continue };
        let orders = [(a, b, c), (a, c, b), (b, a, c), (b, c, a), (c, a, b), (c, b, a)];
        let distinct = a.0 != b.0 && b.0 != c.0 && a.0 != c.0;
        for (carrier, owner, ending) in orders.into_iter().filter(|_| distinct) {
            if let Some(place) = misplaced(network, carrier, owner, ending) {
                hand_over(surface, owners, network, carrier, owner, place);
                break;
            }
        }
    }
}

/// Where `ending` ends beside `carrier` far from the joint, and the carrier's first stations lie on
/// `owner`: the carrier's station there, counted from the joint.
fn misplaced(
    network: &mut Network,
    carrier: (usize, bool),
    owner: (usize, bool),
    ending: (usize, bool),
) -> Option<usize> {
    let mouth = network.oriented(ending.0, ending.1, |track| last_clean(track))?;
    let run = network.oriented(carrier.0, carrier.1, |track| {
        track.stations.iter().rev().cloned().collect::<Vec<Station>>()
    });
    let away = |station: &Station, point: &Point3<f64>| (station.point - point).norm();
    let place = (0..run.len()).min_by(|&i, &j| away(&run[i], &mouth).total_cmp(&away(&run[j], &mouth)))?;
    let radius = run[place].section_radius;
    let along: f64 = run[..=place].windows(2).map(|pair| (pair[1].point - pair[0].point).norm()).sum();
    if away(&run[place], &mouth) > NEAR * radius || along < FAR * radius || place + 2 > run.len() {
        return None;
    }
    let first = &run[0].point;
    let stations = &network.tracks[owner.0].stations;
    let beside = stations.iter().any(|station| away(station, first) < NEAR * radius);
    beside.then_some(place)
}

fn last_clean(track: &Track) -> Option<Point3<f64>> {
    track.stations.iter().rev().find(|s| s.sight == Sight::Clean).map(|s| s.point)
}

/// Gives the carrier's stations before `place` to the end of the owner.
fn hand_over(
    surface: &Surface,
    owners: &[u32],
    network: &mut Network,
    carrier: (usize, bool),
    owner: (usize, bool),
    place: usize,
) {
    let piece = network.oriented(carrier.0, carrier.1, |track| {
        let at = track.stations.len() - place;
        let piece: Vec<Station> = track.stations.drain(at..).collect();
        // In the mouth its sections took in the ring: it is walked to anew.
        let run = track.stations.chunk_by(|a, b| a.sight == b.sight);
        let own = run.map(|run| (run.len(), run[0].sight)).collect::<Vec<_>>();
        let firm = own.iter().rposition(|&(length, sight)| sight == Sight::Clean && length >= RUN);
        let keep: usize = own[..firm.map_or(own.len(), |last| last + 1)].iter().map(|run| run.0).sum();
        track.stations.truncate(keep);
        let wall = Wall::new(surface, owners, track.chain);
        march(wall, track, Toward::Joint);
        piece
    });
    network.oriented(owner.0, owner.1, |track| {
        // The piece runs toward the old joint, the owner away from it: turned around it continues the owner.
        let mut turned = Track { rings: Vec::new(), stations: piece, ..track.clone() };
        turned.reverse();
        let Some(first) = turned.stations.first().map(|s| s.point) else { return };
        let away = |station: &Station| (station.point - first).norm();
        let stations = &track.stations;
        let meet = (0..stations.len()).min_by(|&i, &j| away(&stations[i]).total_cmp(&away(&stations[j])));
        track.stations.truncate(meet.unwrap_or(0));
        let ring = track.rings.len().saturating_sub(1);
        let clean = turned.stations.into_iter().filter(|s| s.sight == Sight::Clean);
        track.stations.extend(clean.map(|station| Station { ring, ..station }));
    });
}
