//! The wall's vertices beside a tube, each heard by the station next to it.

use nalgebra::{Complex, Point3, Vector3};
use rustc_hash::FxHashSet;

use crate::mesh::preparation::Surface;

use crate::centerline::recentering::swept_tube::SweptTube;
use crate::centerline::segmentation::track::Station;

/// Distances from the line, in mean radii, at which there may be wall, and how far off the tube, in the same.
const NEAR: std::ops::Range<f64> = 0.3..2.2;
const OFF: f64 = 0.5;
/// Wall that leans less (sine) out of the line's direction is the vessel's, more a cap's.
const LEAN: (f64, f64) = (0.6, 0.75);
/// Cosine between normal and direction from the line, above which a vertex counts fully.
const FACING: f64 = 0.5;
/// Deviation at which a vertex counts a quarter, in usual deviations.
const UNUSUAL: f64 = 2.0;

/// A vertex beside the tube.
#[derive(Debug, Clone, Copy)]
pub struct WallVertex {
    point: Point3<f64>,
    /// Unit normal of the wall.
    normal: Vector3<f64>,
    /// A piece of the line close by.
    piece: usize,
}

/// A vertex as the station next to it hears it.
#[derive(Debug, Clone, Copy)]
pub struct Heard {
    pub station: usize,
    /// Way from the station along the line.
    along: f64,
    /// Unit direction from the line.
    pub direction: Vector3<f64>,
    /// Distance from the line.
    distance: f64,
    /// The shape's terms in that direction: 1, cos 2, sin 2.
    pub terms: Vector3<f64>,
    pub weight: f64,
}

impl Heard {
    /// The harmonic of an order in its direction: cos and sin of so many times its angle from the frame's `u`.
    pub fn harmonic(&self, tube: &SweptTube, order: i32) -> [f64; 2] {
        let frame = &tube.frames[self.station];
        let flat = Complex::new(self.direction.dot(&frame.u), self.direction.dot(&frame.v));
        let turned = (flat / flat.norm().max(f64::MIN_POSITIVE)).powi(order);
        [turned.re, turned.im]
    }

    /// Distance from the line where its station stands, in mean radii.
    pub fn ratio(&self, tube: &SweptTube) -> f64 {
        (self.distance - tube.slope(self.station) * self.along) / tube.shapes[self.station].x
    }

    /// The terms 1, cos 4, sin 4 in its direction.
    pub fn fourth(&self) -> Vector3<f64> {
        let (cos, sin) = (self.terms.y, self.terms.z);
        Vector3::new(1.0, cos * cos - sin * sin, 2.0 * sin * cos)
    }
}

/// The vertices beside the tube that hang together with its stations' sections. O(vertices).
pub fn wall_beside(surface: &Surface, stations: &[Station], tube: &SweptTube) -> Vec<WallVertex> {
    let mut found: Vec<(u32, usize)> = Vec::new();
    let mut seen: FxHashSet<u32> = FxHashSet::default();
    for (number, station) in stations.iter().enumerate() {
        let cut = station.seeds.into_iter().flatten().flat_map(|t| surface.mesh.triangles[t as usize]);
        for v in cut {
            if let Some(piece) = piece_beside(surface, tube, v, number)
                && seen.insert(v)
            {
                found.push((v, piece));
            }
        }
    }
    let mut next = 0;
    while let Some(&(v, near)) = found.get(next) {
        next += 1;
        for u in surface.corners.neighbours(v) {
            if !seen.contains(&u)
                && let Some(piece) = piece_beside(surface, tube, u, near)
            {
                seen.insert(u);
                found.push((u, piece));
            }
        }
    }
    let vertex = |(v, piece): (u32, usize)| {
        let point = surface.mesh.vertices[v as usize];
        normal(surface, v).map(|normal| WallVertex { point, normal, piece })
    };
    let mut wall = Vec::with_capacity(found.len());
    wall.extend(found.into_iter().filter_map(vertex));
    wall
}

/// The piece of the tube that a vertex lies beside, if it is near its wall.
fn piece_beside(surface: &Surface, tube: &SweptTube, v: u32, near: usize) -> Option<usize> {
    let point = &surface.mesh.vertices[v as usize];
    let (piece, t) = tube.beside(point, near);
    let (low, high) = tube.reach(piece);
    let ratio = (point - tube.at(piece, t).point).norm() / tube.shapes[piece].x;
    ((low..=high).contains(&t) && NEAR.contains(&ratio)).then_some(piece)
}

/// Unit normal of the wall at a vertex, of its triangles by their area; none at the middle of a cap.
fn normal(surface: &Surface, v: u32) -> Option<Vector3<f64>> {
    let wall = surface.corners.star(v).map(|h| h / 3).filter(|&t| !surface.is_cap(t));
    wall.map(|t| surface.mesh.area_vector(t)).sum::<Vector3<f64>>().try_normalize(0.0)
}

/// What the stations hear of the wall; nothing of a vertex past the tube's ends, on a cap, or far off.
///
/// Every weight fades to nothing where it ends, so that rounding moves no vertex in or out.
pub fn hear(tube: &SweptTube, wall: &[WallVertex]) -> Vec<Heard> {
    let mut heard = Vec::with_capacity(wall.len());
    heard.extend(wall.iter().filter_map(|vertex| hear_one(tube, vertex)));
    heard
}

fn hear_one(tube: &SweptTube, vertex: &WallVertex) -> Option<Heard> {
    let (piece, share) = tube.beside(&vertex.point, vertex.piece);
    let (t, place) = tube.foot(&vertex.point, piece, share);
    let arm = vertex.point - place.point;
    let direction = arm.try_normalize(0.0)?;
    let distance = arm.norm();
    let (station, past) = if t < 0.5 { (piece, t) } else { (piece + 1, t - 1.0) };
    let (low, high) = tube.reach(piece);
    let from_start = if piece == 0 { 2.0 * (t - low) } else { 1.0 };
    let from_end = if piece + 2 == tube.points.len() { 2.0 * (high - t) } else { 1.0 };
    let lean = vertex.normal.dot(&place.first.try_normalize(0.0)?).abs();
    let wall = (LEAN.1 - lean) / (LEAN.1 - LEAN.0);
    let frame = &tube.frames[station];
    let (x, y) = (direction.dot(&frame.u), direction.dot(&frame.v));
    let flat = (x * x + y * y).max(f64::MIN_POSITIVE);
    let terms = Vector3::new(1.0, (x * x - y * y) / flat, 2.0 * x * y / flat);
    let along = past * tube.chord(piece);
    let mut heard = Heard { station, along, direction, distance, terms, weight: 1.0 };
    let off = outside(tube, &heard) / (OFF * tube.shapes[station].x);
    let near = (1.0 - off * off).max(0.0).powi(2);
    let inside = from_start.min(from_end);
    // The wall of a neighbour looks the other way.
    let facing = vertex.normal.dot(&direction) / FACING;
    heard.weight =
        [inside, wall, facing, place.room(&arm)].map(|share| share.clamp(0.0, 1.0)).iter().product();
    heard.weight *= near;
    (heard.weight > 0.0).then_some(heard)
}

/// Distance of a vertex from the tube, positive outside.
pub fn outside(tube: &SweptTube, heard: &Heard) -> f64 {
    let radius = tube.shapes[heard.station].dot(&heard.terms);
    heard.distance - radius - tube.slope(heard.station) * heard.along
}

/// The same for a tube without its ellipses.
pub fn outside_circle(tube: &SweptTube, heard: &Heard) -> f64 {
    heard.distance - tube.shapes[heard.station].x - tube.slope(heard.station) * heard.along
}

/// Makes unusual vertices count less (Geman and McClure 1987). What is usual is the median of the run: so a wall
/// of which most lies right and the rest inside, as marching cubes over coarse voxels makes it, is taken where
/// most of it lies.
pub fn doubt_unusual(tube: &SweptTube, heard: &mut [Heard]) {
    /// A normal deviation over the median of its absolute values.
    const NORMAL: f64 = 1.4826;
    /// Deviation that is never unusual, in radii.
    const LEAST: f64 = 1e-4;
    let off: Vec<f64> = heard.iter().map(|h| outside(tube, h) / tube.shapes[h.station].x).collect();
    let mut sizes: Vec<f64> = off.iter().map(|off| off.abs()).collect();
    if sizes.is_empty() {
        return;
    }
    let middle = sizes.len() / 2;
    let (_, &mut median, _) = sizes.select_nth_unstable_by(middle, f64::total_cmp);
    let usual = (NORMAL * median).max(LEAST);
    for (heard, off) in heard.iter_mut().zip(off) {
        heard.weight *= (1.0 + (off / (UNUSUAL * usual)).powi(2)).powi(-2);
    }
}
