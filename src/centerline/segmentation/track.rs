//! A branch under construction: its rings on the surface and the stations along its line.

use nalgebra::{Matrix3, Point3, Unit, Vector3};

use crate::mesh::preparation::Surface;

use crate::centerline::cut_plane::section::{Frame, Profile, SEEDS, Section, section, walk_to_plane};
use crate::centerline::cut_plane::wall_shape::WallShape;
use crate::centerline::laplacian_smoothing::continuation::Process;
use crate::centerline::segmentation::level_sets::{LevelSet, level_set};
use crate::centerline::tips::Chain;
use crate::centerline::tips::reeb::ReebGraph;

/// Distance between rings and between stations, in local radii.
pub const SPACING: f64 = 0.4;

/// How well the wall around a station is seen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sight {
    /// A closed section of this branch alone.
    Clean,
    /// A section that takes in more than this branch, or less: a part of the wall was used.
    Partial,
    /// No wall of this branch; the neighbours decide.
    Lost,
}

/// A centerline point with what the wall says of it.
#[derive(Debug, Clone)]
pub struct Station {
    pub point: Point3<f64>,
    /// Unit direction of the line.
    pub tangent: Unit<Vector3<f64>>,
    /// Where the section's wall puts the point, and how firmly (identity: a full clean section).
    pub target: Point3<f64>,
    pub weight: Matrix3<f64>,
    /// Radius of the circle with the section's area.
    pub section_radius: f64,
    /// Radius of the largest inscribed sphere.
    pub radius: f64,
    pub sight: Sight,
    pub shape: WallShape,
    /// The wall seen from `target`, in `frame`.
    pub profile: Profile,
    /// Number of a ring of its track close by.
    pub ring: usize,
    /// Triangles of its last clean section: the next section lies a short walk from them.
    pub seeds: Option<[u32; SEEDS]>,
    pub frame: Frame,
}

impl Station {
    /// A station that nothing is known of but its place and a rough radius.
    pub fn rough(point: Point3<f64>, tangent: Unit<Vector3<f64>>, radius: f64, ring: usize) -> Self {
        Self {
            point,
            tangent,
            target: point,
            weight: Matrix3::zeros(),
            section_radius: radius,
            radius,
            shape: WallShape::circle(radius),
            sight: Sight::Lost,
            profile: Profile::circle(radius),
            ring,
            seeds: None,
            frame: Frame::new(point, tangent, Vector3::x()),
        }
    }
}

/// A sac that shows no section of its own: the sphere through its wall.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bulge {
    pub centre: Point3<f64>,
    pub radius: f64,
    /// Where its wall shows one that leads to its joint.
    pub neck: Option<Neck>,
    /// What says where along a vessel it sits: its middle, or the mouth of a stalk that bends.
    pub level: Point3<f64>,
}

/// The neck of a sac.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Neck {
    /// Unit direction out of its dome.
    pub direction: Vector3<f64>,
    /// Radius of it and of the straight stalk that leads on from it to the joint; zero where there is none.
    pub stalk: f64,
    /// Where the level sets of the sac begin, if that is not in it.
    pub mouth: Option<Point3<f64>>,
}

impl Bulge {
    /// A ball that shows no neck.
    pub fn ball(centre: Point3<f64>, radius: f64) -> Self {
        Self { centre, radius, neck: None, level: centre }
    }

    /// The same without the axis through its neck: it sits where its stalk's mouth is.
    pub fn on_a_bent_stalk(self) -> Self {
        let mouth = self.neck.and_then(|neck| neck.mouth);
        Self { neck: None, level: mouth.unwrap_or(self.level), ..self }
    }
}

/// One branch: stations in order from `from` to `to`.
#[derive(Debug, Clone)]
pub struct Track {
    /// Number of the chain that it came from.
    pub chain: usize,
    /// Node numbers of the component's graph.
    pub from: usize,
    pub to: usize,
    /// Level sets along it, in the same direction.
    pub rings: Vec<LevelSet>,
    pub stations: Vec<Station>,
    /// Set for a sac: the sphere through its wall.
    pub bulge: Option<Bulge>,
    /// How stiffly its line is smoothed (see [`crate::centerline::laplacian_smoothing::branch`]).
    pub stiffness: f64,
    /// How its line bends, and how noisy its sections are.
    pub process: Process,
}

impl Track {
    /// Whether it is a line of stations, and no bulge.
    pub fn is_line(&self) -> bool {
        self.bulge.is_none()
    }

    /// Way from its first to its last station.
    pub fn way(&self) -> f64 {
        self.stations.windows(2).map(|pair| (pair[1].point - pair[0].point).norm()).sum()
    }

    /// Lets `work` see the track from the side of its end, or turned around.
    pub fn oriented<T>(&mut self, at_end: bool, work: impl FnOnce(&mut Self) -> T) -> T {
        if at_end {
            return work(self);
        }
        self.reverse();
        let result = work(self);
        self.reverse();
        result
    }
}

/// The level sets of a chain, one every [`SPACING`] radii. O(edges crossed).
pub fn rings(surface: &Surface, graph: &ReebGraph, chain: &Chain) -> Vec<LevelSet> {
    let level = |node: u32| graph.nodes[node as usize].level;
    let ring =
        |arc: u32, at: f64| level_set(&surface.mesh.vertices, &surface.corners, graph, arc as usize, at);
    let mut all = Vec::new();
    // How far into the next arc the next ring is due.
    let mut due = 0.0;
    for &(arc, upward) in &chain.arcs {
        let (low, high) = (level(graph.arcs[arc as usize].lower), level(graph.arcs[arc as usize].upper));
        let span = high - low;
        while due < span {
            let cut = ring(arc, if upward { low + due } else { high - due });
            due += (SPACING * cut.radius()).max(1e-3 * span);
            all.push(cut);
        }
        due -= span;
    }
    if all.len() < 3 {
        let span = |arc: u32| level(graph.arcs[arc as usize].upper) - level(graph.arcs[arc as usize].lower);
        let longest = chain.arcs.iter().max_by(|a, b| span(a.0).total_cmp(&span(b.0)));
        if let Some(&(arc, upward)) = longest {
            let low = level(graph.arcs[arc as usize].lower);
            let share = |i: f64| low + span(arc) * if upward { i } else { 1.0 - i };
            all = [0.25, 0.5, 0.75].iter().map(|&i| ring(arc, share(i))).collect();
        }
    }
    all
}

/// Stations at the rings' centres, and between rings that lie far apart: where fronts meet, they run
/// aslant and their centres jump.
pub fn stations_of(rings: &[LevelSet]) -> Vec<Station> {
    /// Distance between stations that is too far, in radii.
    const FAR: f64 = 2.0 * SPACING;
    let mut places: Vec<(Point3<f64>, usize)> = Vec::with_capacity(rings.len());
    for (i, ring) in rings.iter().enumerate() {
        if let Some(before) = i.checked_sub(1).map(|i| &rings[i]) {
            let step = ring.centroid - before.centroid;
            let count = (step.norm() / (FAR * before.radius().min(ring.radius()))).floor().min(16.0) as usize;
            for k in 1..=count {
                let share = k as f64 / (count + 1) as f64;
                places.push((before.centroid + step * share, if share < 0.5 { i - 1 } else { i }));
            }
        }
        places.push((ring.centroid, i));
    }
    let points: Vec<Point3<f64>> = places.iter().map(|place| place.0).collect();
    let tangents = tangents(&points);
    let rough = |(&(point, number), &tangent): (&(Point3<f64>, usize), &Unit<Vector3<f64>>)| {
        let ring = &rings[number];
        let station = Station::rough(point, tangent, ring.radius(), number);
        // A profile's bins start at the frame's `u`: it must turn with the surface, not stay with the axes.
        let like = ring.points.first().map_or(station.frame.u, |p| p - point);
        Station { frame: Frame::new(point, tangent, like), ..station }
    };
    places.iter().zip(&tangents).map(rough).collect()
}

/// Unit tangents of a polyline by central differences.
pub fn tangents(points: &[Point3<f64>]) -> Vec<Unit<Vector3<f64>>> {
    (0..points.len()).map(|i| tangent(points, i).unwrap_or_else(Vector3::z_axis)).collect()
}

/// `None` where the neighbours are one place.
fn tangent(points: &[Point3<f64>], i: usize) -> Option<Unit<Vector3<f64>>> {
    Unit::try_new(points[(i + 1).min(points.len() - 1)] - points[i.saturating_sub(1)], 0.0)
}

/// Recomputes the tangents after the points moved; a station alone (a sac's) keeps its own.
pub fn update_tangents(stations: &mut [Station]) {
    let points: Vec<Point3<f64>> = stations.iter().map(|station| station.point).collect();
    for (i, station) in stations.iter_mut().enumerate() {
        station.tangent = tangent(&points, i).unwrap_or(station.tangent);
    }
}

/// The section around `frame.origin` a short walk from a neighbour's; `None` where none encloses it.
pub fn section_from_seeds(surface: &Surface, frame: Frame, seeds: &[u32]) -> Option<Section> {
    let origin = nalgebra::Point2::origin();
    for &seed in seeds {
        let cut = walk_to_plane(surface, &frame, seed).and_then(|t| section(surface, frame, t));
        if let Some(cut) = cut
            && cut.encloses(&origin)
            && cut.measure().area > 0.0
        {
            return Some(cut);
        }
    }
    None
}

/// The section around `frame.origin` that one of `rings` leads to: rings are closed curves around
/// the branch, so where the plane crosses one, it crosses the branch's wall.
///
/// Of the polygons found, the smallest that encloses the origin; failing that, the nearest.
pub fn section_from_rings<'a>(
    surface: &Surface,
    frame: Frame,
    rings: impl Iterator<Item = &'a LevelSet>,
) -> Option<Section> {
    let mut nearest: Option<(f64, Section)> = None;
    let origin = nalgebra::Point2::origin();
    let mut seen: Vec<u32> = Vec::new();
    for (number, ring) in rings.enumerate() {
        let mut seeds: Vec<u32> = crossings(ring, &frame).collect();
        if number == 0 && seeds.is_empty() {
            // A ring that lies in the plane, or beside it, does not cross it.
            let n = ring.triangles.len();
            let around = (0..SEEDS.min(n)).map(|i| ring.triangles[i * n / SEEDS.min(n)]);
            seeds.extend(around.filter_map(|t| walk_to_plane(surface, &frame, t)));
        }
        for seed in seeds {
            if seen.binary_search(&seed).is_ok() {
                continue;
            }
            let Some(cut) = section(surface, frame, seed) else { continue };
            seen.extend_from_slice(&cut.triangles);
            seen.sort_unstable();
            if cut.encloses(&origin) && cut.measure().area > 0.0 {
                return Some(cut);
            }
            let distance = cut.distance(&origin);
            if nearest.as_ref().is_none_or(|(best, _)| distance < *best) {
                nearest = Some((distance, cut));
            }
        }
    }
    nearest.map(|(_, cut)| cut)
}

/// Triangles of the ring that the plane crosses.
fn crossings<'a>(ring: &'a LevelSet, frame: &'a Frame) -> impl Iterator<Item = u32> + 'a {
    let n = ring.points.len();
    let above = move |i: usize| (ring.points[i % n] - frame.origin).dot(&frame.t) >= 0.0;
    (0..n).filter(move |&i| above(i) != above(i + 1)).map(move |i| ring.triangles[i])
}
