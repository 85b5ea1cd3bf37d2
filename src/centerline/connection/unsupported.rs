//! Stretches of the line that no section supports: bridged between sections far apart.

use nalgebra::Point3;

use crate::centerline::graph::Warning;
use crate::centerline::segmentation::track::Sight;

use super::network::Network;

/// Longest stretch without a clean section, in radii of its wider end; into a joint also the joint's.
const LONGEST: f64 = 5.0;

/// A stretch of a branch between two firm places.
struct Stretch {
    length: f64,
    middle: Point3<f64>,
}

/// A warning of what was bridged. O(points of the line).
pub fn check(network: &Network) -> Option<Warning> {
    let stretches = stretches(network);
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
            if length > LONGEST * first.1.max(last.1) {
                found.push(Stretch { length, middle: run[run.len() / 2].0 });
            }
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::centerline::connection::network::NetworkNode;
    use crate::centerline::connection::subsampling::Anchor;
    use crate::centerline::laplacian_smoothing::continuation::Process;
    use crate::centerline::segmentation::track::{Station, Track};

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
    fn long_gaps_are_told() {
        assert_eq!(check(&network(9.0)), None);
        let warning = check(&network(12.0)).unwrap();
        assert_eq!(warning.code, "bridged");
        assert!(warning.detail.starts_with("1 stretches"), "{}", warning.detail);
    }
}
