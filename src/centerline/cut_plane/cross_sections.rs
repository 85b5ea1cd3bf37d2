//! Optimal cut planes and centerline points of the preset `default` (section IV.B).
//!
//! The plane is perpendicular to the line itself and the point is the centroid of the closed section,
//! in turns until both agree: far less noisy than one plane a vertex, and exact for any tube of
//! symmetric section.

use nalgebra::{Matrix3, Point3, Unit, Vector2};

use crate::mesh::preparation::Surface;

use crate::centerline::cut_plane::ownership::Wall;
use crate::centerline::cut_plane::section::{Frame, Profile, Section, SectionMeasure};
use crate::centerline::cut_plane::wall_fit::{accept_clean, judge, judge_end, wall_axis};
use crate::centerline::cut_plane::wall_shape::WallShape;
use crate::centerline::laplacian_smoothing::curve_fit::fit_curve;
use crate::centerline::segmentation::level_sets::LevelSet;
use crate::centerline::segmentation::track::{
    Sight, Station, Track, section_from_rings, section_from_seeds, update_tangents,
};

/// Rounds of cutting and moving before sections are judged.
const SETTLING: usize = 3;
/// Light smoothing between the rounds.
const LIGHT: f64 = 1.0;
/// Widest section against the level set beside it: that goes around the same wall, aslant or not, so a section much
/// wider takes in more.
const WIDE: f64 = 1.3;
/// Narrowest section against it, by its area: a fold of slivers has sections of none, as long as they may be around.
const THIN: f64 = 0.05;
/// A section rounder than this (largest over smallest distance) may be the first to be trusted.
const ROUND: f64 = 1.6;

/// Share of a section's length that must be wall far from all ends.
pub const MOSTLY_WALL: f64 = 0.7;

/// The rings nearest to the one of number `hint`, itself first.
pub fn rings_near(rings: &[LevelSet], hint: usize) -> impl Iterator<Item = &LevelSet> {
    const SPREAD: usize = 4;
    let n = rings.len();
    let below = move |k: usize| hint.checked_sub(k).filter(|&i| i < n);
    let above = move |k: usize| Some(hint + k).filter(|&i| i < n);
    (0..=SPREAD)
        .flat_map(move |k| [below(k), if k == 0 { None } else { above(k) }])
        .flatten()
        .map(|i| &rings[i])
}

/// Number of the ring whose centre is nearest to a point.
pub fn nearest_ring(rings: &[LevelSet], point: &Point3<f64>) -> usize {
    let distance = |ring: &LevelSet| (ring.centroid - point).norm_squared();
    (0..rings.len()).min_by(|&a, &b| distance(&rings[a]).total_cmp(&distance(&rings[b]))).unwrap_or(0)
}

/// Moves the stations to the centroids of their sections, a few rounds, and notes radii and profiles.
pub fn settle(surface: &Surface, track: &mut Track) {
    let Track { rings, stations, .. } = track;
    for round in 1..=SETTLING {
        for station in stations.iter_mut() {
            let frame = Frame::new(station.point, station.tangent, station.frame.u);
            let Some(cut) = section_from_rings(surface, frame, rings_near(rings, station.ring)) else {
                continue;
            };
            let measure = cut.measure();
            station.sight = Sight::Lost;
            let usual = [THIN, WIDE].map(|times| times * rings[station.ring].radius());
            if !(cut.encloses(&measure.centroid) && (usual[0]..usual[1]).contains(&measure.radius())) {
                continue;
            }
            if round < SETTLING {
                // The next round cuts anew.
                pass(surface, station, &cut, &measure);
            } else {
                accept_clean(surface, station, &cut, measure.centroid, measure.radius());
            }
        }
        let targets: Vec<_> = stations.iter().map(|s| s.target).collect();
        let weights: Vec<_> = stations
            .iter()
            .map(|s| if s.sight == Sight::Clean { Matrix3::identity() } else { Matrix3::identity() * 0.1 })
            .collect();
        let even: Vec<f64> = (0..stations.len()).map(|i| i as f64).collect();
        for (station, point) in stations.iter_mut().zip(fit_curve(&targets, &weights, &even, |_| LIGHT, 0.02))
        {
            station.point = point;
        }
        update_tangents(stations);
    }
}

/// Moves a station to the middle of its section; its profile is not noted.
fn pass(surface: &Surface, station: &mut Station, cut: &Section, measure: &SectionMeasure) {
    /// Even facets, as many as that around, cut away less than a hundredth of the radius: the middle is the centroid.
    const FINE: usize = 48;
    let coarse = || WallShape::of(surface, cut, &measure.centroid, measure.radius()).offset;
    let [x, y] = if cut.points.len() < FINE { coarse() } else { [0.0; 2] };
    station.target = cut.frame.lift(&(measure.centroid + Vector2::new(x, y)));
    station.frame = cut.frame;
    station.sight = Sight::Clean;
}

/// The station whose section is most surely this branch alone, and whether it is round enough to trust.
fn reference(rings: &[LevelSet], stations: &[Station]) -> Option<(usize, bool)> {
    let n = stations.len();
    let roundness = |s: &Station| s.profile.roundness();
    let clean = || stations.iter().filter(|s| s.sight == Sight::Clean);
    let usual = lower_quartile(clean().map(|s| s.section_radius))?;
    let usual_ring = lower_quartile(clean().map(|s| rings[s.ring].radius()))?;
    let score = |i: usize| {
        let station = &stations[i];
        let neighbours = [i.saturating_sub(1), (i + 1).min(n - 1)];
        let jump = neighbours.map(|j| (stations[j].section_radius / station.section_radius).ln().abs());
        let off_middle = (i as f64 + 0.5 - 0.5 * n as f64).abs() / n as f64;
        // Sections and level sets that take in another branch or a sac are wide.
        let wide = (station.section_radius / usual).ln().max(0.0)
            + (rings[station.ring].radius() / usual_ring).ln().max(0.0);
        roundness(station) + 2.0 * jump[0].max(jump[1]) + off_middle + wide
    };
    let candidates = (0..n).filter(|&i| stations[i].sight == Sight::Clean);
    let best = candidates.min_by(|&a, &b| score(a).total_cmp(&score(b)))?;
    Some((best, roundness(&stations[best]) < ROUND))
}

fn lower_quartile(values: impl Iterator<Item = f64>) -> Option<f64> {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 4).copied()
}

/// Judges every station outward from the surest one and drops what lies beyond the last clean ones.
///
/// Returns whether any section was surely this branch alone.
pub fn judge_outward(wall: Wall<'_>, track: &mut Track) -> bool {
    let Some((middle, trusted)) = reference(&track.rings, &track.stations) else {
        keep_ring_centres(&mut track.stations);
        return false;
    };
    let Track { rings, stations, .. } = track;
    for station in stations.iter_mut().enumerate().filter(|(i, _)| *i != middle).map(|(_, s)| s) {
        station.sight = Sight::Lost;
        station.weight = Matrix3::zeros();
    }
    let n = stations.len();
    let inner = inner_stations(stations, stations[middle].section_radius);
    let outward: [Vec<usize>; 2] = [(middle + 1..n).collect(), (0..middle).rev().collect()];
    for way in outward {
        judge_way(wall, rings, stations, middle, &way, &inner);
    }
    let last = last_own(stations[middle..].iter()) + middle;
    let first = middle - last_own(stations[..=middle].iter().rev());
    stations.truncate(last + 1);
    stations.drain(..first);
    for station in stations.iter_mut() {
        if station.sight != Sight::Lost {
            station.point = station.target;
        }
    }
    drop_turning(rings, stations);
    update_tangents(stations);
    if let [alone] = &mut stations[..] {
        straighten(wall.surface, rings, alone);
    }
    trusted
}

/// Drops stations that lie behind the one before, as the level sets run: in a wide stump their centres jump, and
/// a line that turns about would march back through the whole vessel.
fn drop_turning(rings: &[LevelSet], stations: &mut Vec<Station>) {
    let along = |station: &Station| {
        let (before, after) = (station.ring.saturating_sub(1), (station.ring + 1).min(rings.len() - 1));
        rings[after].centroid - rings[before].centroid
    };
    let mut last: Option<Point3<f64>> = None;
    stations.retain(|station| {
        let ahead = last.is_none_or(|last| (station.point - last).dot(&along(station)) > 0.0);
        if ahead {
            last = Some(station.point);
        }
        ahead
    });
    if let [alone] = &mut stations[..]
        && alone.tangent.dot(&along(alone)) < 0.0
    {
        alone.tangent = -alone.tangent;
    }
}

/// Turns the section of a station without neighbours square to its wall: the paper's optimal cut plane.
fn straighten(surface: &Surface, rings: &[LevelSet], station: &mut Station) {
    const ROUNDS: usize = 4;
    for _ in 0..ROUNDS {
        let frame = Frame::new(station.point, station.tangent, station.frame.u);
        let Some(cut) = section_from_rings(surface, frame, rings_near(rings, station.ring)) else { return };
        let measure = cut.measure();
        if !cut.encloses(&measure.centroid) {
            return;
        }
        let Some(axis) = Unit::try_new(wall_axis(surface, &cut), 0.0) else { return };
        accept_clean(surface, station, &cut, measure.centroid, measure.radius());
        station.point = station.target;
        station.tangent = axis;
    }
}

/// Judges the stations of one way outward from `middle`, each by the wall of those before it.
fn judge_way(
    wall: Wall<'_>,
    rings: &[LevelSet],
    stations: &mut [Station],
    middle: usize,
    way: &[usize],
    inner: &[bool],
) {
    /// After so many sections in a row that disagree, the vessel itself has changed.
    const PATIENCE: usize = 3;
    let mut before = middle;
    let mut expected = stations[middle].profile.clone();
    let mut misses = 0;
    for &i in way {
        let like = stations[before].frame.u;
        let frame = Frame::new(stations[i].point, stations[i].tangent, like);
        before = i;
        stations[i].frame = frame;
        let Some(cut) = section_from_rings(wall.surface, frame, rings_near(rings, stations[i].ring)) else {
            continue;
        };
        judge(wall.surface, &mut stations[i], &cut, &expected);
        let own = Profile::circle(cut.measure().radius());
        if stations[i].sight != Sight::Clean && inner[i] && is_own(wall, &cut) {
            judge_end(wall.surface, &mut stations[i], &cut, &own, MOSTLY_WALL);
        } else if stations[i].sight != Sight::Clean && inner[i] && is_one_vessel(&cut, &expected) {
            let expected = if misses < PATIENCE { &expected } else { &own };
            judge_end(wall.surface, &mut stations[i], &cut, expected, MOSTLY_WALL);
        }
        if stations[i].sight == Sight::Clean {
            expected.blend(&stations[i].profile, if misses < PATIENCE { 0.5 } else { 1.0 });
            misses = 0;
        } else {
            misses += 1;
        }
    }
}

/// Whether a section is the branch's own whatever its size: on its own wall, and not as long as a figure
/// of two vessels.
pub fn is_own(wall: Wall<'_>, cut: &Section) -> bool {
    const LONG: f64 = 2.2;
    let measure = cut.measure();
    let round = || Profile::of(cut, &measure.centroid, measure.radius()).roundness() < LONG;
    measure.area > 0.0 && wall.owns(cut) && round()
}

/// Whether a section is no figure of two vessels side by side: those are larger than what was expected,
/// and long.
pub fn is_one_vessel(cut: &Section, expected: &Profile) -> bool {
    const GROWTH: f64 = 1.12;
    let measure = cut.measure();
    let round = || Profile::of(cut, &measure.centroid, measure.radius()).roundness() < ROUND;
    measure.radius() < GROWTH * expected.mean() || round()
}

/// The stations so far from both ends that no joint reaches them: their sections are the branch's own,
/// however the vessel changes there.
fn inner_stations(stations: &[Station], radius: f64) -> Vec<bool> {
    /// Reach of a joint, in radii of the surest section: a bulb on the way is wider.
    const JOINT: f64 = 3.0;
    let mut along = vec![0.0];
    for pair in stations.windows(2) {
        along.push(along[along.len() - 1] + (pair[1].point - pair[0].point).norm());
    }
    let total = along[along.len() - 1];
    along.iter().map(|s| s.min(total - s) > JOINT * radius).collect()
}

/// How far outward, from a clean first station, the stations are the branch's own. After a gap a run of
/// clean sections counts only if it is long: a short one belongs to the vessel beyond the joint.
fn last_own<'a>(outward: impl Iterator<Item = &'a Station>) -> usize {
    const LONG: usize = 6;
    let (mut last, mut run) = (0, 0);
    for (i, station) in outward.enumerate() {
        run = if station.sight == Sight::Clean { run + 1 } else { 0 };
        if run >= LONG || (run > 0 && last + 1 == i) || i == 0 {
            last = i;
        }
    }
    last
}

/// Without any section of their own, stations keep their rings' centres, loosely.
fn keep_ring_centres(stations: &mut [Station]) {
    for station in stations {
        station.sight = Sight::Partial;
        station.target = station.point;
        station.weight = Matrix3::identity() * 0.2;
    }
}

/// Whether a station is still where it was cut last, so that its section would say the same again.
fn stands(station: &Station) -> bool {
    /// The most that it may have moved, in radii, or turned (sine).
    const STILL: f64 = 1e-3;
    let Frame { origin, t, .. } = station.frame;
    (station.point - origin).norm() < STILL * station.section_radius
        && station.tangent.dot(&t) > 0.0
        && station.tangent.cross(&t).norm() < STILL
}

/// Cuts the clean stations anew that the line moved, each expecting its own wall.
pub fn recut(surface: &Surface, track: &mut Track) {
    let Track { rings, stations, .. } = track;
    for station in stations.iter_mut().filter(|s| s.sight == Sight::Clean && !stands(s)) {
        let frame = Frame::new(station.point, station.tangent, station.frame.u);
        let near = station.seeds.and_then(|seeds| section_from_seeds(surface, frame, &seeds));
        let from_rings = || section_from_rings(surface, frame, rings_near(rings, station.ring));
        let Some(cut) = near.or_else(from_rings) else { continue };
        let before = station.clone();
        let expected = station.profile.clone();
        judge(surface, station, &cut, &expected);
        if station.sight != Sight::Clean {
            *station = before;
        }
    }
}

impl Track {
    /// The same branch, told from its other end.
    pub fn reverse(&mut self) {
        std::mem::swap(&mut self.from, &mut self.to);
        self.rings.reverse();
        self.stations.reverse();
        for station in &mut self.stations {
            station.tangent = -station.tangent;
            // Keep the frame right-handed about the new direction: u stays, v turns with t.
            station.frame.t = -station.frame.t;
            station.frame.v = -station.frame.v;
            station.profile.mirror();
            station.shape.mirror();
            station.ring = self.rings.len().saturating_sub(1 + station.ring);
        }
    }
}
