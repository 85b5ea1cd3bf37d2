//! Stretches of the line that no section supports: bridged between sections far apart.

use nalgebra::{Point3, Vector3};

use crate::mesh::preparation::Surface;

use crate::centerline::graph::Warning;
use crate::centerline::ray::crossing;
use crate::centerline::segmentation::track::Sight;

use super::network::Network;

/// Longest stretch without a clean section, in radii of its wider end; into a joint also the joint's.
const LONGEST: f64 = 5.0;

/// A stretch of a branch between two firm places.
struct Stretch {
    length: f64,
    middle: Point3<f64>,
    points: Vec<Point3<f64>>,
}

/// Warnings of what was bridged, and of what of it lies outside the wall. O(bridged points x triangles).
pub fn check(surface: &Surface, network: &Network) -> Vec<Warning> {
    let stretches = stretches(network);
    let Some(longest) = stretches.iter().max_by(|a, b| a.length.total_cmp(&b.length)) else {
        return Vec::new();
    };
    let at = longest.middle;
    let mut warnings = vec![Warning {
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
    }];
    let bridged = stretches.iter().flat_map(|stretch| &stretch.points);
    let outside = bridged.filter(|point| !inside(surface, point)).count();
    if outside > 0 {
        let detail =
            format!("{outside} points of bridged stretches lie outside the wall: the line is wrong there");
        warnings.push(Warning { code: "outside", detail });
    }
    warnings
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
                let points = run.iter().map(|place| place.0).collect();
                found.push(Stretch { length, middle: run[run.len() / 2].0, points });
            }
        }
    }
    found
}

/// Whether a point lies inside the surface: a ray from it leaves an odd number of times.
fn inside(surface: &Surface, point: &Point3<f64>) -> bool {
    // No edge of a mesh made by a program runs along it.
    let direction = Vector3::new(0.5377, 0.3185, 0.7806);
    let crosses = |corners: &&[u32; 3]| crossing(surface, corners, point, &direction, |d| d != 0.0).is_some();
    surface.mesh.triangles.iter().filter(crosses).count() % 2 == 1
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::centerline::connection::network::NetworkNode;
    use crate::centerline::connection::subsampling::Anchor;
    use crate::centerline::segmentation::track::{Station, Track};
    use crate::centerline::shapes::open_tube;
    use crate::mesh::preparation::prepare;

    /// A line along z in a tube of length 20, clean everywhere but between 5 and `until`, `aside` from it there.
    fn network(until: f64, aside: f64) -> Network {
        let station = |i: i32| {
            let z = 0.5 * f64::from(i);
            let lost = z > 5.0 && z < until;
            let place = Point3::new(if lost { aside } else { 0.0 }, 0.0, z);
            let mut station = Station::rough(place, Vector3::z_axis(), 1.0, 0);
            station.sight = if lost { Sight::Lost } else { Sight::Clean };
            station
        };
        let stations = (1..40).map(station).collect();
        let rings = Vec::new();
        let track = Track { chain: 0, from: 0, to: 1, rings, stations, bulge: None, stiffness: 1.0 };
        let node = |z: f64| NetworkNode {
            vertex: 0,
            anchor: Some(Anchor { point: Point3::new(0.0, 0.0, z), radius: 1.0 }),
        };
        Network { nodes: vec![node(0.0), node(20.0)], tracks: vec![track] }
    }

    #[test]
    fn long_gaps_are_told_and_lines_outside() {
        let tube = &prepare(&open_tube(20.0, 60, 12)).unwrap().components[0];
        assert!(check(tube, &network(9.0, 0.0)).is_empty());
        let codes = |network: &Network| check(tube, network).iter().map(|w| w.code).collect::<Vec<_>>();
        assert_eq!(codes(&network(12.0, 0.0)), ["bridged"]);
        assert_eq!(codes(&network(12.0, 1.5)), ["bridged", "outside"]);
    }
}
