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
use crate::centerline::laplacian_smoothing::curve_fit::CurveEnd;
use crate::centerline::segmentation::level_sets::LevelSet;
use crate::centerline::segmentation::track::{
    Bulge, SPACING, Sight, Station, Track, section_from_rings, update_tangents,
};

/// How far back (radii) the bend of a branch is measured.
const BEND_REACH: f64 = 3.0;
/// How far a bend is continued, in radii: farther on nothing is known of it.
const BENT: f64 = 3.0;
/// Uncertainty of a continued line: at its start, and per length continued (radii).
const DOUBT: (f64, f64) = (0.1, 0.2);

/// A branch's line where it runs toward a joint.
#[derive(Debug, Clone, Copy)]
pub struct Approach {
    end: CurveEnd,
    /// Radius of its last section.
    radius: f64,
    /// A bulge says where along the vessel it sits, not where the axis is.
    bulge: bool,
}

impl Approach {
    /// The line at the end of a track, from the stations that see their wall.
    pub fn of(track: &Track) -> Option<Self> {
        if let Some(Bulge { centre, radius }) = track.bulge {
            let end = CurveEnd { point: centre, tangent: Vector3::zeros(), curvature: Vector3::zeros() };
            return Some(Self { end, radius, bulge: true });
        }
        let last = track.stations.iter().rposition(seen_well)?;
        let station = &track.stations[last];
        let points: Vec<Point3<f64>> = track.stations[..=last].iter().map(best_guess).collect();
        let radius = station.section_radius;
        let mut end = CurveEnd::of(&points, BEND_REACH * radius).unwrap_or(CurveEnd {
            point: station.point,
            tangent: *station.tangent,
            curvature: Vector3::zeros(),
        });
        // A bend tighter than this is noise of a short run.
        let bend = end.curvature.norm() * radius;
        end.curvature *= 0.8 * (0.2 / bend.max(0.2));
        Some(Self { end, radius, bulge: false })
    }

    /// The continued line at distance `s` past its start: the branch's bend for a short way, then straight.
    fn at(&self, s: f64) -> (Point3<f64>, Vector3<f64>) {
        let bent = s.clamp(-BENT * self.radius, BENT * self.radius);
        let (point, direction) = self.end.at(bent);
        (point + direction * (s - bent), direction)
    }

    /// Parameter of the point on the continued line nearest to `centre`, not behind its start.
    fn nearest(&self, centre: &Point3<f64>) -> f64 {
        let mut s: f64 = 0.0;
        for _ in 0..4 {
            let (point, direction) = self.at(s);
            s = (s + (centre - point).dot(&direction)).clamp(-3.0 * self.radius, 12.0 * self.radius);
        }
        s
    }
}

/// The smoothed point of a clean section; of a partial one its own target, which no joint has pulled at yet.
fn best_guess(station: &Station) -> Point3<f64> {
    if station.sight == Sight::Clean { station.point } else { station.target }
}

fn seen_well(station: &Station) -> bool {
    station.sight == Sight::Clean || (station.sight == Sight::Partial && station.weight.trace() > 0.8)
}

/// The point nearest to all the approaches; `prior` holds what they leave open.
pub fn joint_centre(approaches: &[Approach], prior: &Point3<f64>) -> Point3<f64> {
    let Some(largest) = approaches.iter().map(|a| a.radius).max_by(f64::total_cmp) else { return *prior };
    let mut centre = *prior;
    let through = through_direction(approaches);
    for _ in 0..12 {
        let hold = 1.0 / (2.0 * largest).powi(2);
        let mut normal = Matrix3::identity() * hold;
        let mut right = prior.coords * hold;
        for approach in approaches {
            if approach.bulge {
                let level = through * through.transpose() / (approach.radius * approach.radius);
                normal += level;
                right += level * approach.end.point.coords;
                continue;
            }
            let s = approach.nearest(&centre);
            let (point, direction) = approach.at(s);
            let doubt = DOUBT.0 * approach.radius + DOUBT.1 * s.max(0.0);
            let across = (Matrix3::identity() - direction * direction.transpose()) / (doubt * doubt);
            normal += across;
            right += across * point.coords;
        }
        let Some(inverse) = normal.try_inverse() else { return centre };
        centre = Point3::from(inverse * right);
    }
    centre
}

/// Direction of the vessel that passes through a joint: that of the two most opposite approaches.
fn through_direction(approaches: &[Approach]) -> Vector3<f64> {
    let lines: Vec<&Approach> = approaches.iter().filter(|a| !a.bulge).collect();
    let mut best = (f64::INFINITY, Vector3::zeros());
    for (i, a) in lines.iter().enumerate() {
        for b in &lines[i + 1..] {
            let cosine = a.end.tangent.dot(&b.end.tangent);
            if cosine < best.0 {
                best = (
                    cosine,
                    (a.end.tangent - b.end.tangent).try_normalize(0.0).unwrap_or_else(Vector3::zeros),
                );
            }
        }
    }
    best.1
}

/// Replaces what follows the last clean station by a run to `centre`, and judges it by the walls of
/// all `rings` around the joint.
pub fn run_to_centre(
    surface: &Surface,
    owners: &[u32],
    track: &mut Track,
    centre: &Point3<f64>,
    rings: &[&LevelSet],
) {
    come_near(Wall::new(surface, owners, track.chain), track, centre);
    let Some(last_seen) = track.stations.iter().rposition(seen_well) else { return };
    track.stations.truncate(last_seen + 1);
    drop_passed(&mut track.stations, centre);
    rejudge_partial(surface, track, rings);
    let Some(approach) = Approach::of(track) else { return };
    let Some(last) = track.stations.last() else { return };
    let (mut like, expected, radius) = (last.frame.u, last.profile.clone(), last.section_radius);
    let start = best_guess(last);
    let distance = (centre - start).norm();
    let count = ((distance / (SPACING * radius)).round() as usize).clamp(1, 64);
    let (_, arrival) = approach.at(distance);
    let handles = [start + approach.end.tangent * (distance / 3.0), centre - arrival * (distance / 3.0)];
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
fn rejudge_partial(surface: &Surface, track: &mut Track, rings: &[&LevelSet]) {
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
fn judge_partial(surface: &Surface, station: &mut Station, expected: &Profile, rings: &[&LevelSet]) {
    const NEAREST: usize = 12;
    let point = station.point;
    let mut near: Vec<&LevelSet> = rings.to_vec();
    near.sort_by(|a, b| (a.centroid - point).norm().total_cmp(&(b.centroid - point).norm()));
    near.truncate(NEAREST);
    station.sight = Sight::Lost;
    station.weight = Matrix3::zeros();
    if let Some(cut) = section_from_rings(surface, station.frame, near.into_iter()) {
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
    fn lines_through_a_point_meet_there() {
        let meeting = Point3::new(1.0, 2.0, 3.0);
        let approach = |direction: Vector3<f64>| Approach {
            end: CurveEnd {
                point: meeting - direction.normalize() * 4.0,
                tangent: direction.normalize(),
                curvature: Vector3::zeros(),
            },
            radius: 1.0,
            bulge: false,
        };
        let all = [Vector3::new(0.0, 0.0, 1.0), Vector3::new(1.0, 0.2, -0.4), Vector3::new(-1.0, 0.3, -0.6)];
        let centre = joint_centre(&all.map(approach), &Point3::new(1.5, 2.0, 2.5));
        assert!((centre - meeting).norm() < 0.1, "{centre}");
    }
}
