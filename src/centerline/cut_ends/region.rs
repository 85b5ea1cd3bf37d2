//! The piece of a surface that closes a tube: all that hangs together ahead of where the tube begins.

use std::collections::VecDeque;

use nalgebra::{Point3, Vector3};
use rustc_hash::{FxHashMap, FxHashSet};

use crate::mesh::corner_table::CornerTable;
use crate::mesh::preparation::Surface;

use super::NEAR;
use super::plane::Plane;
use super::tube::{Place, Tube};
use crate::centerline::triangle_grid::TriangleGrid;
use crate::centerline::{CancelToken, ExtractError};

/// Most of the surface that may lie ahead, in squared radii: 20 radii of a tube.
const MOST: f64 = 125.0;
/// The most triangles and points that are looked at: an end of needles may have any number of them.
const MANY: usize = 1 << 18;
/// What is nearer to the axis than this share of the wall's distance is no wall.
const INNER: f64 = 0.75;

/// Triangles, and points spread over them.
pub struct Region {
    triangles: FxHashMap<u32, Place>,
    samples: Vec<Sample>,
    /// Whether part of it closes an opening that the mesh had closed itself.
    pub is_open: bool,
}

/// A point of a surface, for a small piece of it.
struct Sample {
    point: Point3<f64>,
    place: Place,
    area: f64,
}

/// How well a tube and a plane that cuts it off are what closes the tube.
pub struct Fit {
    pub explained: f64,
    pub bulge: f64,
    pub nearest: f64,
}

impl Region {
    /// What lies ahead in the tube; `None` where that is no end: more than an end has, or an opening.
    ///
    /// # Errors
    /// [`ExtractError::Cancelled`].
    pub fn ahead(
        grid: &TriangleGrid<'_>,
        tube: &Tube,
        cancel: &CancelToken,
    ) -> Result<Option<Self>, ExtractError> {
        /// Triangles that are looked at between two looks at the cancellation.
        const RUN: usize = 4096;
        let surface = grid.surface();
        let Some(first) = grid.wall_ahead(&tube.frame.origin, &tube.frame.t) else { return Ok(None) };
        let mut region = Self { triangles: FxHashMap::default(), samples: Vec::new(), is_open: false };
        let mut queue = VecDeque::from([first]);
        let mut seen = FxHashSet::from_iter([first]);
        let (mut area, most) = (0.0, MOST * tube.radius * tube.radius);
        let mut looks = 0;
        while let Some(t) = queue.pop_front() {
            looks += 1;
            if looks % RUN == 0 {
                cancel.check()?;
            }
            let corners = surface.mesh.triangles[t as usize].map(|v| surface.mesh.vertices[v as usize]);
            let middle = Point3::from((corners[0].coords + corners[1].coords + corners[2].coords) / 3.0);
            let place = tube.place(&middle);
            if place.along <= 0.0 {
                continue;
            }
            let own = 0.5 * surface.mesh.area_vector(t).norm();
            area += own;
            let opening = surface.opening_of(t);
            let is_much = area > most || looks.max(region.samples.len()) > MANY;
            if is_much || opening.is_some_and(|opening| !opening.was_closed) {
                return Ok(None);
            }
            region.is_open |= opening.is_some();
            region.triangles.insert(t, place);
            region.spread(&corners, (middle, place), own, tube);
            for h in 3 * t..3 * t + 3 {
                let other = surface.corners.opposite(h) / 3;
                if seen.insert(other) {
                    queue.push_back(other);
                }
            }
        }
        Ok((!region.samples.is_empty()).then_some(region))
    }

    /// Points over a triangle, the more the larger it is: its middle, whose place is known, where it is small.
    fn spread(
        &mut self,
        [a, b, c]: &[Point3<f64>; 3],
        (point, place): (Point3<f64>, Place),
        area: f64,
        tube: &Tube,
    ) {
        /// Longest side of a piece, in radii.
        const FINE: f64 = 0.3;
        let longest = (b - a).norm().max((c - b).norm()).max((a - c).norm());
        let count = (longest / (FINE * tube.radius)).ceil().clamp(1.0, 12.0) as usize;
        if count == 1 {
            self.samples.push(Sample { point, place, area });
            return;
        }
        let step = 1.0 / count as f64;
        let area = area * step * step;
        // The middles of the pieces that lie as the triangle does, and of those that stand on their heads.
        let rows = |turned: bool| (0..count - usize::from(turned)).map(move |i| (turned, i));
        for (turned, i) in rows(false).chain(rows(true)) {
            for j in 0..count - usize::from(turned) - i {
                let place = |k: usize| (k as f64 + if turned { 2.0 } else { 1.0 } / 3.0) * step;
                let point = a + (b - a) * place(i) + (c - a) * place(j);
                self.samples.push(Sample { point, place: tube.place(&point), area });
            }
        }
    }

    /// The plane that what is no wall lies near.
    pub fn plane(&self, tube: &Tube) -> Option<Plane> {
        /// Of the closing piece's least extent, in squared radii.
        const LEAST: f64 = 0.5;
        let inner = self.samples.iter().filter(|sample| sample.place.share < INNER);
        let inner: Vec<(Point3<f64>, f64)> = inner.map(|sample| (sample.point, sample.area)).collect();
        let area: f64 = inner.iter().map(|sample| sample.1).sum();
        if area < LEAST * tube.radius * tube.radius {
            return None;
        }
        Plane::near(&inner, 0.5 * NEAR * tube.radius)
    }

    pub fn fit(&self, tube: &Tube, plane: &Plane) -> Fit {
        let near = NEAR * tube.radius;
        let (mut all, mut explained, mut nearest) = (0.0, 0.0, f64::INFINITY);
        // Heights of the middle of the cap, and of what lies around it.
        let mut heights = [(0.0, 0.0); 2];
        for Sample { point, place, area } in &self.samples {
            let height = plane.height(point);
            let (on_plane, on_wall) = (height.abs() < near, (place.share - 1.0).abs() < NEAR);
            all += area;
            if on_plane || (on_wall && height < near) {
                explained += area;
            }
            if on_plane && place.share < 1.0 - NEAR {
                nearest = nearest.min(place.along);
            }
            if place.share < INNER {
                let part = &mut heights[usize::from(place.share > 0.6 * INNER)];
                *part = (part.0 + height * area, part.1 + area);
            }
        }
        let [middle, around] = heights.map(|(sum, area): (f64, f64)| sum / area.max(f64::MIN_POSITIVE));
        let bulge = (middle - around) / tube.radius;
        Fit { explained: explained / all.max(f64::MIN_POSITIVE), bulge, nearest: nearest / tube.radius }
    }

    /// The triangles of what closes the tube around `middle`: one disc with a rim that passes each vertex once; `None` where there is
    /// none such.
    pub fn cap(&self, surface: &Surface, plane: &Plane, middle: &Point3<f64>) -> Option<Vec<u32>> {
        /// How often a rim that touches itself is moved outward.
        const ROUNDS: usize = 8;
        /// Fewest triangles that tell a plane from what else they may be.
        const FEWEST: usize = 8;
        let lies_in = |(t, place): (&u32, &Place)| {
            let corners = surface.mesh.triangles[*t as usize].map(|v| surface.mesh.vertices[v as usize]);
            let height = corners.iter().map(|corner| plane.height(corner)).sum::<f64>() / 3.0;
            height > 0.0 || -height < (1.0 - place.share) * place.wall
        };
        let mut cap: FxHashSet<u32> =
            self.triangles.iter().filter(|entry| lies_in(*entry)).map(|(t, _)| *t).collect();
        let away = |t: &u32| {
            let [a, b, c] = surface.mesh.triangles[*t as usize].map(|v| surface.mesh.vertices[v as usize]);
            (Point3::from((a.coords + b.coords + c.coords) / 3.0) - middle).norm()
        };
        let seed = cap.iter().copied().min_by(|a, b| away(a).total_cmp(&away(b)).then(a.cmp(b)))?;
        for _ in 0..ROUNDS {
            let disc = joined(&surface.corners, vec![seed], |t| cap.contains(&t));
            let border = self.border(&surface.corners);
            if border.iter().any(|t| disc.contains(t)) {
                return None;
            }
            // What the disc parts from the wall behind belongs to it.
            let wall =
                joined(&surface.corners, border, |t| self.triangles.contains_key(&t) && !disc.contains(&t));
            cap = self.triangles.keys().copied().filter(|t| !wall.contains(t)).collect();
            let pinched = pinches(surface, &cap);
            if pinched.is_empty() {
                let mut cap: Vec<u32> = cap.into_iter().collect();
                cap.sort_unstable();
                return Some(cap).filter(|cap| cap.len() >= FEWEST && is_disc(surface, cap));
            }
            let around = pinched.iter().flat_map(|&v| surface.corners.star(v)).map(|h| h / 3);
            cap.extend(around.filter(|t| self.triangles.contains_key(t)));
        }
        None
    }

    /// Its triangles that have a neighbour outside.
    fn border(&self, corners: &CornerTable) -> Vec<u32> {
        let outside = |h: u32| !self.triangles.contains_key(&(corners.opposite(h) / 3));
        self.triangles.keys().copied().filter(|t| (3 * t..3 * t + 3).any(outside)).collect()
    }
}

/// Cosine between a direction and where the surface within `reach` of a line's last point, that lies on it, faces on the
/// mean. `None` where the line meets no wall there, or where that faces all ways.
pub fn facing(
    grid: &TriangleGrid<'_>,
    line: &[Point3<f64>],
    reach: f64,
    direction: &Vector3<f64>,
) -> Option<f64> {
    /// Least length of the mean against that of single triangles.
    const ALIKE: f64 = 0.7;
    let end = line.last()?;
    let surface = grid.surface();
    let before = line.iter().rev().find(|point| (*point - end).norm() > reach)?;
    let first = grid.wall_ahead(before, &(end - before).try_normalize(0.0)?)?;
    let near = |t: u32| {
        surface.mesh.triangles[t as usize]
            .iter()
            .any(|&v| (surface.mesh.vertices[v as usize] - end).norm() < reach)
    };
    let (mut sum, mut all) = (Vector3::zeros(), 0.0);
    // In the order of their numbers, so that the sum is always the same.
    let mut patch: Vec<u32> = joined(&surface.corners, vec![first], near).into_iter().collect();
    patch.sort_unstable();
    for area in patch.into_iter().map(|t| surface.mesh.area_vector(t)) {
        sum += area;
        all += area.norm();
    }
    (sum.norm() > ALIKE * all).then(|| sum.dot(direction) / sum.norm())
}

/// The triangles that hang together with those in `queue` and are `wanted`.
fn joined(corners: &CornerTable, mut queue: Vec<u32>, wanted: impl Fn(u32) -> bool) -> FxHashSet<u32> {
    let mut found: FxHashSet<u32> = queue.iter().copied().collect();
    while let Some(t) = queue.pop() {
        for h in 3 * t..3 * t + 3 {
            let other = corners.opposite(h) / 3;
            if wanted(other) && found.insert(other) {
                queue.push(other);
            }
        }
    }
    found
}

/// Whether triangles, a rim around them that passes each vertex once, are one disc (Euler's formula): what has two rims
/// would take a handle with it.
fn is_disc(surface: &Surface, triangles: &[u32]) -> bool {
    let held: FxHashSet<u32> = triangles.iter().copied().collect();
    let vertices: FxHashSet<u32> =
        triangles.iter().flat_map(|&t| surface.mesh.triangles[t as usize]).collect();
    let half_edges = triangles.iter().flat_map(|&t| 3 * t..3 * t + 3);
    let rim = half_edges.filter(|&h| !held.contains(&(surface.corners.opposite(h) / 3))).count();
    rim > 0 && 2 * vertices.len() == triangles.len() + rim + 2
}

/// The vertices that the rim of a set of triangles passes more than once.
fn pinches(surface: &Surface, set: &FxHashSet<u32>) -> Vec<u32> {
    let mut vertices: Vec<u32> = set.iter().flat_map(|&t| surface.mesh.triangles[t as usize]).collect();
    vertices.sort_unstable();
    vertices.dedup();
    let borders = |v: &u32| {
        let inside = |h: u32| set.contains(&(h / 3));
        surface.corners.star(*v).filter(|&h| inside(h) != inside(surface.corners.opposite(h))).count()
    };
    vertices.into_iter().filter(|v| borders(v) > 2).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::centerline::test_surfaces::{capsule, closed_surface};

    #[test]
    fn a_dome_is_a_disc_and_a_ring_of_wall_is_none() {
        let surface = closed_surface(&capsule(1.0, 4.0, 24));
        let between = |low: f64, high: f64| -> Vec<u32> {
            let height = |t: u32| {
                surface.mesh.triangles[t as usize]
                    .iter()
                    .map(|&v| surface.mesh.vertices[v as usize].z)
                    .sum::<f64>()
                    / 3.0
            };
            (0..surface.mesh.triangles.len() as u32).filter(|&t| (low..high).contains(&height(t))).collect()
        };
        assert!(is_disc(&surface, &between(4.2, 9.0)));
        assert!(!is_disc(&surface, &between(1.0, 3.0)), "it has two rims");
        assert!(!is_disc(&surface, &between(-9.0, 9.0)), "it has none");
    }
}
