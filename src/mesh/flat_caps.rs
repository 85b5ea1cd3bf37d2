//! Flat caps: where a vessel was cut aslant and the mesh closes the cut itself by a plane.
//!
//! Such a cut is taken for what it is, an opening: its triangles go, and a fan around the middle of its rim, which is
//! the same surface, comes instead. A cut aslant would else look like wall, and its far corner like the tip.

use std::collections::VecDeque;

use nalgebra::{Point3, Vector3};
use rustc_hash::FxHashSet;

use super::TriangleMesh;
use super::corner_table::{NONE, next, previous};

/// Cosine of the most that a triangle of a cap leans against its first: a rim need not be plane.
const FLAT: f64 = 0.978;
/// Fewest edges of a rim: the side of a box is no cap.
const EDGES: usize = 6;
/// Area over that of the circle with the same circumference, of the longest ellipse that is a cut.
const ROUND: f64 = 0.4;
/// How often a jagged rim is cut back.
const ROUNDS: usize = 8;
/// Least and most of the section half a radius behind it over its own area, and edges of its rim, in radii, up to which
/// it may lack one all around: marching cubes rounds the rim.
const SECTION: std::ops::Range<f64> = 0.65..1.15;
const SHORT: f64 = 0.5;
/// Cosine between cap and vessel above which the cut is square enough to be seen for what it is.
const SQUARE: f64 = 0.9;
/// The same of the section a radius behind it over that one: a vessel that widens or narrows toward its cut does so
/// by less than 20 degrees, a facet of a wall or dome is the top of much more.
const VESSEL: std::ops::Range<f64> = 0.65..1.35;
/// Most of the surface that may lie before a section, in the area that the section should have.
const AROUND: f64 = 12.0;
/// Least mean sine of the angle at a rim: a smooth wall's facets have less.
const CREASE: f64 = 0.3;
/// How often a triangle may be looked at on average: a surface of nothing but flat pieces has no caps.
const LOOKS: usize = 64;
/// Twice the area over the square of the longest edge of a triangle whose normal is rounding.
const SLIVER: f64 = 1e-4;

/// Takes the triangles of all flat caps out of a soup whose half-edges are matched; returns the vertices of their rims.
/// O(triangles).
pub(super) fn open(mesh: &mut TriangleMesh, opposite: &mut Vec<u32>) -> FxHashSet<u32> {
    let mut rims = FxHashSet::default();
    let mut out: Vec<u32> = Vec::new();
    let mut region = Region::new(mesh, opposite);
    for seed in 0..mesh.triangles.len() as u32 {
        if let Some(rim) = region.grow(seed)
            && region.is_cap(&rim)
            && rim.iter().all(|&h| !rims.contains(&region.origin(h)))
        {
            rims.extend(rim.iter().map(|&h| region.origin(h)));
            out.extend_from_slice(&region.triangles);
        }
    }
    drop(region);
    if !out.is_empty() {
        take_out(mesh, opposite, &out);
    }
    rims
}

/// Drops triangles; where they were, the surface is open.
fn take_out(mesh: &mut TriangleMesh, opposite: &mut Vec<u32>, out: &[u32]) {
    let mut name: Vec<u32> = vec![0; mesh.triangles.len()];
    out.iter().for_each(|&t| name[t as usize] = NONE);
    let kept = || name.iter().enumerate().filter(|(_, name)| **name != NONE).map(|(t, _)| t);
    let kept: Vec<usize> = kept().collect();
    kept.iter().enumerate().for_each(|(number, &t)| name[t] = number as u32);
    mesh.triangles = kept.iter().map(|&t| mesh.triangles[t]).collect();
    let renamed = |h: u32| match h {
        NONE => NONE,
        h if name[(h / 3) as usize] == NONE => NONE,
        h => 3 * name[(h / 3) as usize] + h % 3,
    };
    *opposite =
        kept.iter().flat_map(|&t| [3 * t, 3 * t + 1, 3 * t + 2]).map(|h| renamed(opposite[h])).collect();
}

/// A flat piece of a surface, grown from a triangle.
struct Region<'a> {
    mesh: &'a TriangleMesh,
    opposite: &'a [u32],
    /// The name of the region that took each triangle last; two to a seed.
    owner: Vec<u32>,
    name: u32,
    /// The number of the section that each triangle was looked at for last.
    seen: Vec<u32>,
    sections: u32,
    /// Triangles looked at for sections so far.
    looks: usize,
    triangles: Vec<u32>,
    /// Sum of its triangles' area vectors, each twice the area long.
    area: Vector3<f64>,
}

impl<'a> Region<'a> {
    fn new(mesh: &'a TriangleMesh, opposite: &'a [u32]) -> Self {
        let count = mesh.triangles.len();
        let (owner, seen) = (vec![NONE; count], vec![0; count]);
        Self {
            mesh,
            opposite,
            owner,
            name: 0,
            seen,
            sections: 0,
            looks: 0,
            triangles: Vec::new(),
            area: Vector3::zeros(),
        }
    }

    fn origin(&self, h: u32) -> u32 {
        self.mesh.triangles[(h / 3) as usize][(h % 3) as usize]
    }

    fn at(&self, h: u32) -> Point3<f64> {
        self.mesh.vertices[self.origin(h) as usize]
    }

    /// A triangle's area vector, twice as long as its area.
    fn area_of(&self, t: u32) -> Vector3<f64> {
        let [a, b, c] = [3 * t, 3 * t + 1, 3 * t + 2].map(|h| self.at(h));
        (b - a).cross(&(c - a))
    }

    fn is_sliver(&self, t: u32, area: f64) -> bool {
        let edge = |h: u32| (self.at(next(h)) - self.at(h)).norm_squared();
        area < SLIVER * edge(3 * t).max(edge(3 * t + 1)).max(edge(3 * t + 2))
    }

    fn holds(&self, t: u32) -> bool {
        self.owner[t as usize] == self.name
    }

    /// Grows over what lies flat with triangle `seed`, if no earlier one has it; its rim's half-edges in order where it
    /// is a disc with neighbours all around.
    fn grow(&mut self, seed: u32) -> Option<Vec<u32>> {
        if self.owner[seed as usize] != NONE {
            return None;
        }
        let normal = self.area_of(seed);
        if self.is_sliver(seed, normal.norm()) {
            return None;
        }
        let closed = self.flood(seed, normal, 2 * seed);
        if !closed || self.triangles.len() + 2 < EDGES || self.fall().abs() < CREASE {
            return None;
        }
        // The seed may lie at the edge, and lean: what was found tells better what is flat.
        let mean = self.area;
        let along = |t: &u32| self.area_of(*t).dot(&mean);
        let best = self.triangles.iter().copied().max_by(|a, b| along(a).total_cmp(&along(b)))?;
        let closed = self.flood(best, mean, 2 * seed + 1);
        if !closed {
            return None;
        }
        (0..ROUNDS).find_map(|_| self.rim_or_cut_back())?
    }

    /// Takes what lies flat with a plane of that normal and hangs together with `first`, under the number `name`;
    /// whether it has neighbours all around.
    fn flood(&mut self, first: u32, normal: Vector3<f64>, name: u32) -> bool {
        let free = |owner: u32| owner == NONE || owner + 1 == name;
        let size = normal.norm();
        (self.name, self.area) = (name, Vector3::zeros());
        self.triangles.clear();
        self.triangles.push(first);
        self.owner[first as usize] = name;
        let (mut at, mut closed) = (0, true);
        while let Some(&t) = self.triangles.get(at) {
            at += 1;
            self.area += self.area_of(t);
            for h in 3 * t..3 * t + 3 {
                let o = self.opposite[h as usize];
                closed &= o != NONE;
                if o == NONE || !free(self.owner[(o / 3) as usize]) {
                    continue;
                }
                let other = o / 3;
                let area = self.area_of(other);
                if area.dot(&normal) > FLAT * size * area.norm() || self.is_sliver(other, area.norm()) {
                    self.owner[other as usize] = name;
                    self.triangles.push(other);
                }
            }
        }
        closed
    }

    /// The rim, if every part of it is seen from its middle; else what hides a part is given up.
    fn rim_or_cut_back(&mut self) -> Option<Option<Vec<u32>>> {
        let Some(rim) = self.rim() else { return Some(None) };
        let Some(normal) = self.area.try_normalize(0.0) else { return Some(None) };
        let centre = self.middle(&rim);
        let seen = |h: u32| (self.at(h) - centre).cross(&(self.at(next(h)) - centre)).dot(&normal) > 0.0;
        let hiding: FxHashSet<u32> = rim.iter().filter(|&&h| !seen(h)).map(|h| h / 3).collect();
        if hiding.is_empty() {
            return Some(Some(rim));
        }
        for &t in &hiding {
            self.owner[t as usize] = NONE - 1;
            self.area -= self.area_of(t);
        }
        self.triangles.retain(|t| !hiding.contains(t));
        None
    }

    /// The half-edges of the rim in order; `None` where they are few, or more than one loop.
    fn rim(&self) -> Option<Vec<u32>> {
        if self.triangles.len() + 2 < EDGES {
            return None;
        }
        let half_edges = self.triangles.iter().flat_map(|&t| 3 * t..3 * t + 3);
        let (mut first, mut edges) = (NONE, 0);
        for h in half_edges.filter(|&h| !self.holds(self.opposite[h as usize] / 3)) {
            (first, edges) = (h, edges + 1);
        }
        if edges < EDGES {
            return None;
        }
        let mut rim = vec![first];
        let mut seen = FxHashSet::default();
        loop {
            let last = rim[rim.len() - 1];
            if !seen.insert(self.origin(last)) {
                return None;
            }
            let mut h = next(last);
            while self.holds(self.opposite[h as usize] / 3) {
                h = next(self.opposite[h as usize]);
            }
            if h == first {
                return (rim.len() == edges).then_some(rim);
            }
            rim.push(h);
        }
    }

    /// Length of a rim.
    fn around(&self, rim: &[u32]) -> f64 {
        rim.iter().map(|&h| (self.at(next(h)) - self.at(h)).norm()).sum()
    }

    /// The middle of a rim, weighted by its edges' lengths.
    fn middle(&self, rim: &[u32]) -> Point3<f64> {
        let (mut sum, mut all) = (Vector3::zeros(), 0.0);
        for &h in rim {
            let (p, q) = (self.at(h), self.at(next(h)));
            let length = (q - p).norm();
            sum += (p.coords + q.coords) * (0.5 * length);
            all += length;
        }
        Point3::from(sum / all)
    }

    /// Whether it closes a cut: round, with an edge all around, and a vessel as wide behind it.
    fn is_cap(&mut self, rim: &[u32]) -> bool {
        let Some(normal) = self.area.try_normalize(0.0) else { return false };
        let around = self.around(rim);
        let area = 0.5 * self.area.norm();
        if area < ROUND * around * around / (4.0 * std::f64::consts::PI) {
            return false;
        }
        self.ends_vessel(rim, &normal, area)
    }

    /// Whether what comes right behind it is a vessel as wide: by the sections there, parallel to it.
    fn ends_vessel(&mut self, rim: &[u32], normal: &Vector3<f64>, area: f64) -> bool {
        let centre = self.middle(rim);
        // The surface may be inside out.
        let outward = if self.fall() < 0.0 { *normal } else { -normal };
        let edge = self.around(rim) / rim.len() as f64 / (area / std::f64::consts::PI).sqrt();
        let rounded = if edge < SHORT { (1.0 + edge).powi(2) } else { 1.0 };
        let mut section = |area: f64, radii: f64| {
            let depth = radii * (area / std::f64::consts::PI).sqrt();
            self.section_behind(rim, &(centre - outward * depth), &outward, AROUND * area)
        };
        let alike =
            |near: &(f64, Point3<f64>)| (SECTION.start..SECTION.end * rounded).contains(&(near.0 / area));
        let Some(near) = section(area, 0.5).filter(alike) else { return false };
        let Some((far, middle)) = section(near.0, 1.0) else { return false };
        let along = centre - middle;
        VESSEL.contains(&(far / near.0)) && along.dot(&outward) < SQUARE * along.norm()
    }

    /// How steeply the surface rises beyond it, the mean sine; 0 for what has no neighbours.
    fn fall(&self) -> f64 {
        let (mut rise, mut way) = (0.0, 0.0);
        for h in self.triangles.iter().flat_map(|&t| 3 * t..3 * t + 3) {
            let o = self.opposite[h as usize];
            if self.holds(o / 3) {
                continue;
            }
            let (from, to) = (self.at(h), self.at(next(h)));
            let (arm, edge) = (self.at(previous(o)) - from, to - from);
            rise += arm.dot(&self.area) * edge.norm();
            way += arm.cross(&edge).norm();
        }
        rise / (way * self.area.norm()).max(f64::MIN_POSITIVE)
    }

    /// Area within the section through `point` of what hangs together with the rim, and its centroid; `None` where there
    /// is none, or more than `most` of the surface before it.
    fn section_behind(
        &mut self,
        rim: &[u32],
        point: &Point3<f64>,
        normal: &Vector3<f64>,
        most: f64,
    ) -> Option<(f64, Point3<f64>)> {
        self.sections += 1;
        let mut queue: VecDeque<u32> = rim.iter().map(|&h| self.opposite[h as usize] / 3).collect();
        let (mut before, mut section, mut moment) = (0.0, 0.0, Vector3::zeros());
        while let Some(t) = queue.pop_front() {
            if self.holds(t) || self.seen[t as usize] == self.sections {
                continue;
            }
            self.seen[t as usize] = self.sections;
            self.looks += 1;
            if self.looks > LOOKS * self.seen.len() {
                return None;
            }
            let corners = [3 * t, 3 * t + 1, 3 * t + 2].map(|h| {
                let arm = self.at(h) - point;
                (arm, arm.dot(normal))
            });
            if corners.iter().all(|corner| corner.1 > 0.0) {
                before += 0.5 * self.area_of(t).norm();
            }
            if before > most {
                return None;
            }
            if let Some((area, arm)) = crossing(&corners, normal) {
                section += area;
                moment += arm * area;
            }
            let over = |h: u32| corners[(h % 3) as usize].1 > 0.0;
            let onward = (3 * t..3 * t + 3).filter(|&h| over(h) || over(next(h)));
            queue.extend(onward.map(|h| self.opposite[h as usize]).filter(|&o| o != NONE).map(|o| o / 3));
        }
        let centroid = point + moment / section;
        centroid.iter().all(|c| c.is_finite()).then_some((section.abs(), centroid))
    }
}

/// What a triangle adds to the area within the section through its surface, seen from the origin of the arms, which lies
/// in the section, and the middle of that: the triangle between the origin and its piece of the section. Around a lumen
/// the pieces sum to its section.
fn crossing(corners: &[(Vector3<f64>, f64); 3], normal: &Vector3<f64>) -> Option<(f64, Vector3<f64>)> {
    let mut ends = [None; 2];
    for i in 0..3 {
        let ((a, from), (b, to)) = (corners[i], corners[(i + 1) % 3]);
        if (from > 0.0) != (to > 0.0) {
            ends[usize::from(from > 0.0)] = Some(a + (b - a) * (from / (from - to)));
        }
    }
    let [Some(up), Some(down)] = ends else { return None };
    Some((0.5 * down.cross(&up).dot(normal), (up + down) / 3.0))
}
