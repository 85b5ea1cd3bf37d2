//! Joint collapse by all the wall around a joint (IV.D, eq. 10): the lumen there is the union of its branches,
//! each swept by spheres along a curve from its last firm section to one centre (see
//! [`super::union_fit`]). No section is needed, so it works up to the centre, where no plane cuts one branch
//! alone.

use nalgebra::{Point3, Vector3};
use rustc_hash::FxHashSet;

use crate::centerline::connection::network::Network;
use crate::centerline::recentering::approach::{Approach, run_up};
use crate::centerline::recentering::joints::information;
use crate::centerline::recentering::limb::Limb;
use crate::centerline::recentering::union_fit::{Start, UnionFit};
use crate::centerline::segmentation::track::{Sight, Station};
use crate::mesh::preparation::Surface;

/// Vertices that take part in a fit; more say the same.
const MOST_VERTICES: usize = 500;
/// A branch this far (radii) from the centre hides in a wider one.
const FAR: f64 = 4.0;

/// A joint as found: its centre, and the way of each of its branches.
#[derive(Debug, Clone)]
pub struct FittedJoint {
    pub centre: Point3<f64>,
    pub limbs: Vec<FittedLimb>,
}

/// A branch's way, from the station that it starts at.
#[derive(Debug, Clone)]
pub struct FittedLimb {
    pub track: usize,
    pub at_end: bool,
    /// How many stations at its end toward the joint are replaced.
    pub replaced: usize,
    pub limb: Limb,
    /// Inscribed radius over the mean radius that the limb has, where it starts.
    pub inscribed: f64,
    /// Whether nearly all of its way lies inside the other branches: no wall says where it runs.
    pub hidden: bool,
}

/// Fits the joint of `node`; `None` where a branch has no firm section on the way or the fit runs away.
pub fn fit_joint(surface: &Surface, network: &Network, node: usize) -> Option<FittedJoint> {
    let incident = network.incident(node);
    let centre = network.anchor(node)?.point;
    if incident.len() < 3 || incident.len() > 6 {
        return None;
    }
    let (mut starts, mut places, mut balls) = (Vec::new(), Vec::new(), Vec::new());
    let mut approaches = Vec::new();
    let headings = headings(network, &incident);
    for &(track, at_end) in &incident {
        if let Some(bulge) = network.tracks[track].bulge {
            balls.push(bulge);
            approaches.extend(Approach::of(&network.tracks[track], &[]));
            continue;
        }
        let before = run_up(network, track, at_end);
        let near = influence(&headings, headings.iter().position(|h| h.track == (track, at_end))?);
        let inner = !network.is_end(network.tracks[track].from) && !network.is_end(network.tracks[track].to);
        let mut own = network.toward(track, at_end);
        let firm = firm_station(&own.stations, inner, near, &centre)?;
        places.push((track, at_end, own.stations.len() - 1 - firm));
        own.stations.truncate(firm + 1);
        let approach = Approach::of(&own, &before)?;
        starts.push(start(&own.stations[firm], &approach, &centre)?);
        approaches.push(approach);
    }
    // One branch among sacs meets nothing that it could be fitted with.
    if starts.len() < 2 {
        return None;
    }
    let wall = wall_around(surface, &starts, &centre);
    let lines = information(&approaches, &centre);
    let fit = UnionFit { starts: &starts, balls: &balls, wall: &wall, origin: centre, lines };
    let (centre, limbs) = fit.solve()?;
    let found = limbs.into_iter().zip(places).zip(&starts);
    let fitted = found.map(|((limb, (track, at_end, replaced)), start)| FittedLimb {
        track,
        at_end,
        replaced,
        limb,
        inscribed: start.inscribed,
        hidden: start.hidden,
    });
    let limbs = fitted.collect();
    Some(FittedJoint { centre, limbs })
}

/// How a branch runs into a joint.
struct Heading {
    track: (usize, bool),
    tangent: Vector3<f64>,
    radius: f64,
}

fn headings(network: &Network, incident: &[(usize, bool)]) -> Vec<Heading> {
    let one = |&(track, at_end): &(usize, bool)| {
        let own = &network.tracks[track];
        let mut clean = own.stations.iter().filter(|s| s.sight == Sight::Clean);
        let last = if at_end { clean.next_back() } else { clean.next() }?;
        let bulge = own.bulge.map(|bulge| bulge.radius);
        let radius = bulge.unwrap_or(last.section_radius);
        let tangent = if at_end { *last.tangent } else { -*last.tangent };
        Some(Heading { track: (track, at_end), tangent, radius })
    };
    incident.iter().filter_map(one).collect()
}

/// How far a joint reaches into one of its branches: a radius, or where the branch goes straight on into
/// another, as far as the others' mouths.
fn influence(headings: &[Heading], own: usize) -> f64 {
    /// Cosine of the largest bend, and the largest ratio of radii, of one vessel.
    const STRAIGHT: f64 = 0.8;
    const ALIKE: f64 = 1.35;
    /// A mouth's reach in its branch's radii, and the least in the vessel's.
    const MOUTH: f64 = 2.5;
    const LEAST: f64 = 0.3;
    let one = &headings[own];
    let onward = |other: &Heading| {
        let ratio = other.radius / one.radius;
        -other.tangent.dot(&one.tangent) > STRAIGHT && (1.0 / ALIKE..ALIKE).contains(&ratio)
    };
    let others = || headings.iter().enumerate().filter(|&(i, _)| i != own).map(|(_, other)| other);
    if !others().any(onward) {
        return one.radius;
    }
    let mouths =
        others().filter(|other| !onward(other)).map(|other| MOUTH * other.radius).fold(0.0, f64::max);
    mouths.clamp(LEAST * one.radius, one.radius)
}

/// The last clean station that lies before the joint's reach and not in its mouth. Of a
/// track between two joints the half before the middle is the other's.
///
/// `near`: how far the joint reaches, in the input's unit.
fn firm_station(stations: &[Station], inner: bool, near: f64, centre: &Point3<f64>) -> Option<usize> {
    let before = |s: &Station| (centre - s.point).dot(&s.tangent) > near;
    let first = if inner { stations.len() / 2 } else { 0 };
    let clean: Vec<usize> = (first..stations.len())
        .filter(|&i| stations[i].sight == Sight::Clean && before(&stations[i]))
        .collect();
    let &last = clean.last()?;
    let far = (centre - stations[last].point).norm() > FAR * stations[last].section_radius;
    // The last one feels the mouth; from far off every section counts.
    if far { Some(last) } else { clean.iter().rev().nth(1).copied().or(Some(last)) }
}

fn start(station: &Station, approach: &Approach, centre: &Point3<f64>) -> Option<Start> {
    let radius = station.shape.mean;
    let point = station.point;
    let length = (centre - point).norm();
    let ((_, departure), (_, arrival)) = (approach.line.at(0.0), approach.line.at(length));
    let control = [point, point + departure * (length / 3.0), centre - arrival * (length / 3.0), *centre];
    let seeds = station.seeds?.to_vec();
    let doubt = approach.doubt(2.0 * length / 3.0);
    let positive = radius > 0.0 && length > 0.0;
    let limb = Limb { control, radii: [radius, radius] };
    let hidden = length > FAR * radius;
    let inscribed = station.radius / radius;
    positive.then_some(Start { limb, line: approach.line, doubt, seeds, inscribed, hidden })
}

/// The vertices of the wall between the limbs' first sections.
fn wall_around(surface: &Surface, starts: &[Start], centre: &Point3<f64>) -> Vec<Point3<f64>> {
    /// Reach of a first section's plane, in its radii.
    const ACROSS: f64 = 2.2;
    let reach = starts
        .iter()
        .map(|start| (start.limb.control[0] - centre).norm() + 2.0 * start.limb.radii[0])
        .fold(0.0, f64::max);
    let inside = |p: &Point3<f64>| {
        (p - centre).norm() < reach
            && starts.iter().all(|start| {
                let away = p - start.limb.control[0];
                away.norm() > ACROSS * start.limb.radii[0] || away.dot(&start.tangent()) >= 0.0
            })
    };
    let mut found: Vec<u32> = starts
        .iter()
        .flat_map(|start| &start.seeds)
        .flat_map(|&t| surface.mesh.triangles[t as usize])
        .filter(|&v| inside(&surface.mesh.vertices[v as usize]))
        .collect();
    found.sort_unstable();
    found.dedup();
    let mut seen: FxHashSet<u32> = found.iter().copied().collect();
    let mut next = 0;
    while let Some(&v) = found.get(next) {
        next += 1;
        for u in surface.corners.neighbours(v) {
            if inside(&surface.mesh.vertices[u as usize]) && seen.insert(u) {
                found.push(u);
            }
        }
    }
    // Each is chosen by its own number: one vertex more or less at the border must not change the choice.
    let one_of = found.len().div_ceil(MOST_VERTICES).next_power_of_two() as u32;
    let chosen = |v: &u32| (v.wrapping_mul(0x9E37_79B1) >> 16).is_multiple_of(one_of);
    found.sort_unstable();
    found.into_iter().filter(chosen).map(|v| surface.mesh.vertices[v as usize]).collect()
}

/// Carries the stations past the first `firm` along with a joint that moved: they hide in a wider branch, where no wall
/// says how the vessel runs. Its radius goes on as it changes before.
pub fn carry_hidden(stations: &mut [Station], firm: usize, moved: &Vector3<f64>) {
    /// As far as a vessel may widen or narrow unseen.
    const CHANGE: std::ops::RangeInclusive<f64> = 0.5..=1.6;
    let (seen, hidden) = stations.split_at_mut(firm);
    let Some(last) = seen.last() else { return };
    let (taper, radius) = (taper(seen), last.radius.max(0.0));
    let (mut before, mut along) = (last.point, 0.0);
    let count = hidden.len() + 1;
    for (i, station) in hidden.iter_mut().enumerate() {
        along += (station.point - std::mem::replace(&mut before, station.point)).norm();
        station.radius = (radius + taper * along).clamp(CHANGE.start() * radius, CHANGE.end() * radius);
        station.point += moved * ((i + 1) as f64 / count as f64).powi(2);
    }
}

/// Change of the radius along the line at the end of a run of stations.
fn taper(stations: &[Station]) -> f64 {
    /// Length of line that shows it, in radii: about as much as may follow unseen.
    const RUN: f64 = 10.0;
    let Some(last) = stations.last() else { return 0.0 };
    let far = |s: &&Station| (s.point - last.point).norm() > RUN * last.radius;
    let before = stations.iter().rev().find(far).or(stations.first());
    before.map_or(0.0, |s| (last.radius - s.radius) / (last.point - s.point).norm().max(f64::MIN_POSITIVE))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hidden_way_goes_on_tapering_and_follows_its_joint() {
        let station = |i: u32| {
            let z = 0.5 * f64::from(i);
            let mut station = Station::rough(Point3::new(0.0, 0.0, z), Vector3::z_axis(), 1.0, 0);
            station.radius = if i < 30 { 1.0 + 0.01 * z } else { 5.0 };
            station
        };
        let mut stations: Vec<Station> = (0..40).map(station).collect();
        carry_hidden(&mut stations, 30, &Vector3::x());
        for (i, station) in stations.iter().enumerate() {
            let expected = 1.0 + 0.01 * station.point.z;
            assert!((station.radius - expected).abs() < 1e-9, "{} at station {i}", station.radius);
        }
        assert_eq!((stations[29].point.x, stations[39].point.x), (0.0, (10.0_f64 / 11.0).powi(2)));
    }
}
