//! A branch's line where it runs toward a joint, continued past its last section.

use nalgebra::Point3;

use crate::centerline::connection::network::Network;
use crate::centerline::laplacian_smoothing::continuation::{Continuation, Seen};
use crate::centerline::segmentation::track::{Bulge, SPACING, Sight, Station, Track};

/// What is doubted of a continued line beside its noise, in radii: at its start, and per radius continued.
const DOUBT: (f64, f64) = (0.03, 0.06);
/// What is doubted of a section that shows only a part of the wall, in radii.
const PARTIAL: f64 = 0.08;
/// How far back a line is followed, in radii.
const REACH: f64 = 12.0;

/// A branch's line where it runs toward a joint.
#[derive(Debug, Clone, Copy)]
pub struct Approach {
    pub line: Continuation,
    /// Radius of its last section.
    pub radius: f64,
    /// A bulge: its line is the axis through its neck, where it shows one.
    pub bulge: bool,
}

impl Approach {
    /// The line at the end of a track, from the stations that see their wall; `before` are those of the
    /// vessel that the track continues.
    pub fn of(track: &Track, before: &[Seen]) -> Option<Self> {
        if let Some(bulge) = &track.bulge {
            return Some(Self::of_bulge(bulge));
        }
        let last = track.stations.iter().rposition(seen_well)?;
        let station = &track.stations[last];
        let well: Vec<&Station> = track.stations[..=last].iter().filter(|s| seen_well(s)).collect();
        let points: Vec<Seen> = before.iter().copied().chain(seen(&well)).collect();
        let radius = station.section_radius;
        let straight = Continuation::straight(station.point, *station.tangent, radius);
        let line = Continuation::of(&points, radius, track.process).unwrap_or(straight);
        Some(Self { line, radius, bulge: false })
    }

    /// The axis through the neck of a sac; a place alone where it shows none.
    pub fn of_bulge(bulge: &Bulge) -> Self {
        let direction = bulge.neck.map(|neck| neck.direction).unwrap_or_default();
        let line = Continuation::straight(bulge.level, direction, bulge.radius);
        Self { line, radius: bulge.radius, bulge: true }
    }

    /// A line of which no more is known than a place and a direction.
    #[cfg(test)]
    pub fn straight(point: Point3<f64>, direction: nalgebra::Vector3<f64>, radius: f64) -> Self {
        Self { line: Continuation::straight(point, direction, radius), radius, bulge: false }
    }

    /// Standard deviation of the line at distance `s` past its start, in the input's unit.
    pub fn doubt(&self, s: f64) -> f64 {
        self.line.doubt(s).hypot(DOUBT.0 * self.radius + DOUBT.1 * s.max(0.0))
    }

    /// Parameter of the point on the continued line nearest to `centre`, not far behind its start.
    pub fn nearest(&self, centre: &Point3<f64>) -> f64 {
        let mut s: f64 = 0.0;
        for _ in 0..4 {
            let (point, direction) = self.line.at(s);
            s = (s + (centre - point).dot(&direction)).clamp(-3.0 * self.radius, 12.0 * self.radius);
        }
        s
    }
}

/// The smoothed point of a clean section; of a partial one its own target, which no joint has pulled at yet.
pub fn best_guess(station: &Station) -> Point3<f64> {
    if station.sight == Sight::Clean { station.point } else { station.target }
}

pub fn seen_well(station: &Station) -> bool {
    station.sight == Sight::Clean || (station.sight == Sight::Partial && station.weight.trace() > 0.8)
}

/// What the sections of a run of stations say. Toward a mouth they widen on one side: what they are wider
/// than the branch before is doubted of their centres.
fn seen(run: &[&Station]) -> Vec<Seen> {
    /// Length before the end, in radii, that may belong to the mouth, and length before that which shows
    /// how the branch itself tapers.
    const MOUTH: f64 = 2.0;
    const TAPER: f64 = 4.0;
    let away: Vec<f64> = run.iter().map(|s| distance(s, run[run.len() - 1])).collect();
    let firm: Vec<usize> =
        (0..run.len()).filter(|&i| (MOUTH..MOUTH + TAPER).contains(&away[i]) && clean(run[i])).collect();
    let wide = |i: usize| -> f64 {
        let (Some(&first), Some(&last)) = (firm.first(), firm.last()) else { return 0.0 };
        if i <= last {
            return 0.0;
        }
        let logarithm = |j: usize| run[j].section_radius.ln();
        let slope = if last > first {
            (logarithm(last) - logarithm(first)) / (away[first] - away[last])
        } else {
            0.0
        };
        logarithm(i) - logarithm(last) - slope * (away[last] - away[i])
    };
    let one = |i: usize| Seen {
        point: run[i].target,
        doubt: if clean(run[i]) { 2.0 * wide(i).abs() } else { PARTIAL },
    };
    (0..run.len()).map(one).collect()
}

fn clean(station: &Station) -> bool {
    station.sight == Sight::Clean
}

fn distance(station: &Station, last: &Station) -> f64 {
    (station.point - last.point).norm() / last.section_radius
}

/// The sections of the vessel that a track continues past its other end, in order toward that end: where
/// joints follow closely, a track alone is too short to say how the vessel runs.
pub fn run_up(network: &Network, track: usize, at_end: bool) -> Vec<Seen> {
    /// Cosine of the largest bend, and the largest ratio of radii, of one vessel.
    const STRAIGHT: f64 = 0.8;
    const ALIKE: f64 = 1.35;
    let far = if at_end { network.tracks[track].from } else { network.tracks[track].to };
    if network.tracks[track].bulge.is_some() {
        return Vec::new();
    }
    let own = network.toward(track, at_end);
    let Some(first) = own.stations.iter().find(|s| clean(s)) else { return Vec::new() };
    if own.stations.last().is_some_and(|last| distance(first, last) > REACH) {
        return Vec::new();
    }
    let mut best: Option<(f64, Vec<Seen>)> = None;
    for (other, other_end) in network.incident(far) {
        if other == track || network.tracks[other].bulge.is_some() {
            continue;
        }
        let other = network.toward(other, other_end);
        let behind = |s: &&Station| {
            clean(s) && (first.point - s.point).dot(&first.tangent) > 0.5 * SPACING * first.section_radius
        };
        let run: Vec<&Station> = other.stations.iter().filter(behind).collect();
        let Some(last) = run.last() else { continue };
        let cosine = last.tangent.dot(&first.tangent);
        let ratio = last.section_radius / first.section_radius;
        if cosine > STRAIGHT
            && (1.0 / ALIKE..ALIKE).contains(&ratio)
            && best.as_ref().is_none_or(|b| b.0 < cosine)
        {
            let points = run.iter().map(|s| Seen { point: s.target, doubt: 0.0 }).collect();
            best = Some((cosine, points));
        }
    }
    best.map_or(Vec::new(), |(_, points)| points)
}
