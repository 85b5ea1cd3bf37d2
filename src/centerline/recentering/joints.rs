//! Joint collapse (section IV.D): one centre where branches meet, and the line of each branch from its
//! last clean section to that centre.
//!
//! Each branch is continued by its own bend; the centre is the point nearest to all of them (the
//! least squares of eq. 10, over the branches' lines instead of the wall's normals), so no branch
//! is favoured. On the way the part of the wall that still belongs to the branch is used.

use nalgebra::{Matrix3, Point3, Unit, Vector3};

use crate::mesh::preparation::Surface;

use crate::centerline::cut_plane::march::{Toward, march};
use crate::centerline::cut_plane::ownership::Wall;
use crate::centerline::cut_plane::section::{Frame, Profile};
use crate::centerline::cut_plane::wall_fit::judge;
use crate::centerline::recentering::approach::{Approach, best_guess, seen_well};
use crate::centerline::segmentation::level_sets::LevelSet;
use crate::centerline::segmentation::track::{
    SPACING, Sight, Station, Track, section_from_rings, update_tangents,
};

/// The point nearest to all the approaches; `prior` holds what they leave open, and stands where they lead far away
/// together, as tangled short branches may.
pub fn joint_centre(approaches: &[Approach], prior: &Point3<f64>) -> Point3<f64> {
    /// How far past the farthest approach's start the centre may lie from the prior, in the largest radius.
    const ASTRAY: f64 = 4.0;
    let Some(largest) = approaches.iter().map(|a| a.radius).max_by(f64::total_cmp) else { return *prior };
    let hold = 1.0 / (2.0 * largest).powi(2);
    let mut centre = *prior;
    for _ in 0..12 {
        let (normal, right) = information(approaches, &centre);
        let held = normal + Matrix3::identity() * hold;
        let Some(inverse) = held.try_inverse() else { break };
        centre = Point3::from(inverse * (right + prior.coords * hold));
    }
    let starts = approaches.iter().map(|approach| (approach.line.at(0.0).0 - prior).norm());
    let reach = starts.fold(0.0, f64::max) + ASTRAY * largest;
    if (centre - prior).norm() < reach { centre } else { *prior }
}

/// What the approaches say of a centre near `centre`: the matrix and the right side of its normal equations.
pub fn information(approaches: &[Approach], centre: &Point3<f64>) -> (Matrix3<f64>, Vector3<f64>) {
    let places: Vec<f64> = approaches.iter().map(|approach| approach.nearest(centre)).collect();
    // A bulge goes on into no vessel.
    let direction = |(approach, &s): (&Approach, &f64)| {
        if approach.bulge { Vector3::zeros() } else { approach.line.at(s).1 }
    };
    let directions: Vec<Vector3<f64>> = approaches.iter().zip(&places).map(direction).collect();
    let through = through_direction(approaches, centre);
    let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
    for (number, (approach, &s)) in approaches.iter().zip(&places).enumerate() {
        if approach.bulge {
            let (own, of_middle) = of_bulge(approach, &through, centre);
            normal += own;
            right += own * of_middle;
            continue;
        }
        let (point, _) = approach.line.at(s);
        let direction = agreed(&directions, number);
        let doubt = approach.doubt(s);
        let across = (Matrix3::identity() - direction * direction.transpose()) / (doubt * doubt);
        normal += across;
        right += across * point.coords;
    }
    (normal, right)
}

/// What a bulge says of a centre near `centre`, and the place that it says it of: the axis through its neck leads there, and
/// one that stands on the side of a vessel stands square to it.
fn of_bulge(
    approach: &Approach,
    through: &Vector3<f64>,
    centre: &Point3<f64>,
) -> (Matrix3<f64>, Vector3<f64>) {
    /// How well its middle says where along a vessel it sits, in its radii.
    const LEVEL: f64 = 0.07;
    /// Cosine between its neck and the vessel at which that counts a third.
    const LEAN: f64 = 0.12;
    /// Deviation of its neck's direction (radians).
    const AXIS: f64 = 0.035;
    let (middle, neck) = approach.line.at(0.0);
    let lean = neck.dot(through) / LEAN;
    let square = (-lean * lean).exp() / (LEVEL * approach.radius).powi(2);
    let level = through * through.transpose() * square;
    if neck == Vector3::zeros() {
        return (level, middle.coords);
    }
    let doubt = AXIS * (centre - middle).norm().max(approach.radius);
    let across = (Matrix3::identity() - neck * neck.transpose()) / (doubt * doubt);
    (level + across, middle.coords)
}

/// The direction of one of the lines, agreed upon with the line that continues it: where two cross at a
/// small angle says nothing of the joint.
fn agreed(directions: &[Vector3<f64>], number: usize) -> Vector3<f64> {
    /// Angle (radians) that is half a bend of one vessel, half a meeting of two.
    const SMALL: f64 = 0.4;
    let own = directions[number];
    let others = directions.iter().enumerate().filter(|&(other, _)| other != number).map(|(_, other)| -other);
    let Some(onward) = others.min_by(|a, b| own.dot(b).total_cmp(&own.dot(a))) else { return own };
    let angle = own.angle(&onward);
    let share = 0.5 * (-(angle / SMALL).powi(2)).exp();
    (own * (1.0 - share) + onward * share).try_normalize(0.0).unwrap_or(own)
}

/// Direction at `centre` of the vessel that passes through a joint: of the cubic curve that joins the two most
/// opposite approaches.
fn through_direction(approaches: &[Approach], centre: &Point3<f64>) -> Vector3<f64> {
    let ends: Vec<(Point3<f64>, Vector3<f64>)> =
        approaches.iter().filter(|a| !a.bulge).map(|a| a.line.at(0.0)).collect();
    let pairs = ends.iter().enumerate().flat_map(|(i, a)| ends[i + 1..].iter().map(move |b| (a, b)));
    let most_opposite = pairs.min_by(|(a, b), (c, d)| a.1.dot(&b.1).total_cmp(&c.1.dot(&d.1)));
    let Some((from, to)) = most_opposite else { return Vector3::zeros() };
    let chord = to.0 - from.0;
    let length = chord.norm();
    let ahead = chord.dot(&(from.1 - to.1)) > length;
    let direction = if ahead {
        let t = ((centre - from.0).dot(&chord) / chord.norm_squared()).clamp(0.0, 1.0);
        let (start, end) = (1.0 - 4.0 * t + 3.0 * t * t, 3.0 * t * t - 2.0 * t);
        chord * (6.0 * t * (1.0 - t)) + (from.1 * start - to.1 * end) * length
    } else {
        from.1 - to.1
    };
    direction.try_normalize(0.0).unwrap_or_else(Vector3::zeros)
}

/// Replaces what follows the last clean station by a run to `centre`, and judges it by the walls of
/// all `rings` around the joint.
pub fn run_to_centre(
    surface: &Surface,
    owners: &[u32],
    track: &mut Track,
    centre: &Point3<f64>,
    rings: &[LevelSet],
) {
    come_near(Wall::new(surface, owners, track.chain), track, centre);
    let Some(last_seen) = track.stations.iter().rposition(seen_well) else { return };
    track.stations.truncate(last_seen + 1);
    drop_passed(&mut track.stations, centre);
    rejudge_partial(surface, track, rings);
    let Some(approach) = Approach::of(track, &[]) else { return };
    let Some(last) = track.stations.last() else { return };
    let (mut like, expected, radius) = (last.frame.u, last.profile.clone(), last.section_radius);
    let start = best_guess(last);
    let distance = (centre - start).norm();
    let count = ((distance / (SPACING * radius)).round() as usize).clamp(1, 64);
    let (_, departure) = approach.line.at(0.0);
    let (_, arrival) = approach.line.at(distance);
    let handles = [start + departure * (distance / 3.0), centre - arrival * (distance / 3.0)];
    for i in 1..count {
        let (point, direction) = bezier(&[start, handles[0], handles[1], *centre], i as f64 / count as f64);
        let Some(tangent) = Unit::try_new(direction, 0.0) else { continue };
        let mut station = Station::rough(point, tangent, radius, track.rings.len() - 1);
        station.frame = Frame::new(point, tangent, like);
        like = station.frame.u;
        judge_partial(surface, &mut station, &expected, rings);
        track.stations.push(station);
    }
}

/// Walks on by clean sections where the last one lies far from the centre: where fronts met, a branch's
/// level sets end before its joint.
fn come_near(wall: Wall<'_>, track: &mut Track, centre: &Point3<f64>) {
    /// Distance that a joint itself may take, in radii.
    const FAR: f64 = 4.0;
    /// Fewer sections are no way.
    const LEAST: usize = 3;
    let Some(clean) = track.stations.iter().rposition(|s| s.sight == Sight::Clean) else { return };
    let last = &track.stations[clean];
    if (centre - last.point).norm() < FAR * last.section_radius {
        return;
    }
    let beyond = track.stations.split_off(clean + 1);
    march(wall, track, Toward::Centre(*centre));
    if track.stations.len() < clean + 1 + LEAST {
        // In the mouth of a wider vessel: the parts of the wall that were seen there say more.
        track.stations.truncate(clean + 1);
        track.stations.extend(beyond);
        update_tangents(&mut track.stations);
    }
}

/// Judges the partial stations at the end of a track again, where they have moved to.
fn rejudge_partial(surface: &Surface, track: &mut Track, rings: &[LevelSet]) {
    let Some(clean) = track.stations.iter().rposition(|s| s.sight == Sight::Clean) else { return };
    let expected = track.stations[clean].profile.clone();
    update_tangents(&mut track.stations);
    for i in clean + 1..track.stations.len() {
        let like = track.stations[i - 1].frame.u;
        let station = &mut track.stations[i];
        station.frame = Frame::new(station.point, station.tangent, like);
        judge_partial(surface, station, &expected, rings);
    }
}

/// Past the last clean section nothing is firm: whatever agrees counts as a part of the wall.
fn judge_partial(surface: &Surface, station: &mut Station, expected: &Profile, rings: &[LevelSet]) {
    const NEAREST: usize = 12;
    let point = station.point;
    let away = |ring: &LevelSet| (ring.centroid - point).norm_squared();
    let mut near: Vec<(f64, usize)> = rings.iter().enumerate().map(|(i, ring)| (away(ring), i)).collect();
    let nearer = |a: &(f64, usize), b: &(f64, usize)| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1));
    if near.len() > NEAREST {
        near.select_nth_unstable_by(NEAREST, nearer);
        near.truncate(NEAREST);
    }
    near.sort_unstable_by(nearer);
    station.sight = Sight::Lost;
    station.weight = Matrix3::zeros();
    if let Some(cut) = section_from_rings(surface, station.frame, near.iter().map(|&(_, i)| &rings[i])) {
        judge(surface, station, &cut, expected);
    }
    if station.sight == Sight::Clean {
        station.sight = Sight::Partial;
    }
}

/// Removes stations that lie beyond the centre.
fn drop_passed(stations: &mut Vec<Station>, centre: &Point3<f64>) {
    while stations.len() > 2 {
        let last = &stations[stations.len() - 1];
        let ahead = (centre - last.point).dot(&last.tangent);
        if ahead > 0.25 * SPACING * last.section_radius {
            break;
        }
        stations.pop();
    }
}

/// Point and derivative of a cubic Bezier curve.
fn bezier(p: &[Point3<f64>; 4], t: f64) -> (Point3<f64>, Vector3<f64>) {
    let u = 1.0 - t;
    let c = p.map(|point| point.coords);
    let point = c[0] * (u * u * u) + c[1] * (3.0 * u * u * t) + c[2] * (3.0 * u * t * t) + c[3] * (t * t * t);
    let slope = (c[1] - c[0]) * (3.0 * u * u) + (c[2] - c[1]) * (6.0 * u * t) + (c[3] - c[2]) * (3.0 * t * t);
    (Point3::from(point), slope)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sac_stands_square_to_its_vessel_unless_its_neck_leans() {
        let vessel =
            |side: f64| Approach::straight(Point3::new(3.0 * side, 0.0, 0.0), -Vector3::x() * side, 1.0);
        let sac = |neck: Vector3<f64>| Approach {
            bulge: true,
            ..Approach::straight(Point3::new(0.0, 0.0, 3.0), neck, 1.5)
        };
        let centre = |neck: Vector3<f64>| {
            joint_centre(&[vessel(1.0), vessel(-1.0), sac(neck)], &Point3::new(0.5, 0.0, 0.0))
        };
        let hardly = Vector3::new(0.02, 0.0, -1.0).normalize();
        for (neck, most) in [(-Vector3::z(), 0.03), (Vector3::zeros(), 0.03), (hardly, 0.04)] {
            assert!(centre(neck).coords.norm() < most, "{neck:?} {}", centre(neck));
        }
        // To where its axis meets the vessel's.
        let leaning = centre(Vector3::new(1.0, 0.0, -1.5).normalize());
        assert!((leaning - Point3::new(2.0, 0.0, 0.0)).norm() < 0.15, "{leaning}");
    }

    #[test]
    fn lines_through_a_point_meet_there() {
        let meeting = Point3::new(1.0, 2.0, 3.0);
        let approach = |direction: Vector3<f64>| {
            Approach::straight(meeting - direction.normalize(), direction.normalize(), 1.0)
        };
        let all = [Vector3::new(0.0, 0.0, 1.0), Vector3::new(1.0, 0.2, -0.4), Vector3::new(-1.0, 0.3, -0.6)];
        let centre = joint_centre(&all.map(approach), &Point3::new(1.5, 2.0, 2.5));
        assert!((centre - meeting).norm() < 0.1, "{centre}");
    }
}
