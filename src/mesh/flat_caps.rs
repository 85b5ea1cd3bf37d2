//! Flat caps: where a vessel was cut aslant and the mesh closes the cut itself by a plane.
//!
//! Such a cut is taken for what it is, an opening: its triangles go, and a fan around the middle of its rim comes
//! instead, nearly the same surface. A cut aslant would else look like wall, and its far corner like the tip.

use std::collections::VecDeque;
use std::f64::consts::PI;

use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use rustc_hash::FxHashSet;

use super::TriangleMesh;
use super::corner_table::{NONE, next, previous};
use super::openings::rim_centre;

/// Cosine of the most that a triangle of a cap leans against it: a rim need not be plane.
const FLAT: f64 = 0.978;
/// Fewest edges of a rim: the side of a box is no cap. A disc of so many triangles less two has no more.
const EDGES: usize = 6;
/// Area over that of the circle with the same circumference, of the longest ellipse that is a cut.
const ROUND: f64 = 0.4;
/// How often a jagged rim is cut back.
const ROUNDS: usize = 8;
/// Least mean sine of the angle at a rim: a smooth wall's facets have less.
const CREASE: f64 = 0.3;
/// Least and most of the section half a radius behind a cap over its own area.
const SECTION: std::ops::Range<f64> = 0.65..1.15;
/// Marching cubes rounds a rim: a cap may lack an edge all around, where its edges are shorter than this, in radii.
const SHORT: f64 = 0.5;
/// Least and most of the section one radius behind a cap over the one half a radius behind it: a vessel that widens or
/// narrows toward its cut does so slowly; a facet of a wall or dome is the top of much more.
const VESSEL: std::ops::Range<f64> = 0.65..1.35;
/// The same one and a half radii behind it: a bend widens the section, a dome has ended there.
const ONWARD: std::ops::Range<f64> = 0.5..1.8;
/// Cosine between cap and vessel above which the cut is square enough to be seen for what it is.
const SQUARE: f64 = 0.9;
/// Most of the surface that may lie before a section, in the area that it should have, a radius of its depth.
const AROUND: f64 = 16.0;
/// How often a triangle may be looked at on average: a surface of nothing but flat pieces has no caps.
const LOOKS: usize = 64;
/// Twice the area over the square of the longest edge of a triangle whose normal is rounding.
const SLIVER: f64 = 1e-4;
/// Owner of what was cut back.
const GIVEN_UP: u32 = NONE - 1;

/// The flat caps of a surface.
#[derive(Default)]
pub(super) struct FlatCaps {
    pub(super) triangles: Vec<u32>,
    /// The vertices of their rims, or more.
    rims: FxHashSet<u32>,
}

/// Looks for the flat caps of a soup whose half-edges are matched. O(triangles).
pub(super) fn find(mesh: &TriangleMesh, opposite: &[u32]) -> FlatCaps {
    let mut found = FlatCaps::default();
    let mut region = Region::new(mesh, opposite);
    for seed in 0..mesh.triangles.len() as u32 {
        if let Some(rim) = region.grow(seed)
            && region.is_cap(&rim)
            && rim.iter().all(|&h| !found.rims.contains(&region.origin(h)))
        {
            found.rims.extend(rim.iter().map(|&h| region.origin(h)));
            found.triangles.extend_from_slice(&region.triangles);
        }
    }
    found
}

impl FlatCaps {
    /// Triangles that close cuts, by whatever they are known.
    pub(super) fn of(triangles: Vec<u32>) -> Self {
        Self { triangles, rims: FxHashSet::default() }
    }

    /// Drops their triangles; where they were, the surface is open. Returns the vertices of their rims.
    pub(super) fn take_out(self, mesh: &mut TriangleMesh, opposite: &mut Vec<u32>) -> FxHashSet<u32> {
        if self.triangles.is_empty() {
            return self.rims;
        }
        let mut name: Vec<u32> = vec![0; mesh.triangles.len()];
        self.triangles.iter().for_each(|&t| name[t as usize] = NONE);
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
        self.rims
    }
}

/// A flat piece of a surface, grown from a triangle.
struct Region<'a> {
    mesh: &'a TriangleMesh,
    opposite: &'a [u32],
    /// The triangles' area vectors, each twice the area long.
    areas: Vec<Vector3<f64>>,
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
        let areas = (0..count as u32).into_par_iter().map(|t| mesh.area_vector(t)).collect();
        Self {
            mesh,
            opposite,
            areas,
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

    fn is_sliver(&self, t: u32, area: f64) -> bool {
        let edge = |h: u32| (self.at(next(h)) - self.at(h)).norm_squared();
        area < SLIVER * edge(3 * t).max(edge(3 * t + 1)).max(edge(3 * t + 2))
    }

    fn holds(&self, t: u32) -> bool {
        self.owner[t as usize] == self.name
    }

    /// Grows over what lies flat with triangle `seed`, if no earlier one has it; its rim's half-edges in order where it
    /// is a disc with neighbours all around, and every part of the rim is seen from its middle.
    fn grow(&mut self, seed: u32) -> Option<Vec<u32>> {
        if self.owner[seed as usize] != NONE {
            return None;
        }
        let normal = self.areas[seed as usize];
        if self.is_sliver(seed, normal.norm()) {
            return None;
        }
        self.flood(seed, normal, 2 * seed);
        if self.triangles.len() + 2 < EDGES {
            return None;
        }
        // The seed may lie at the edge, and lean: what was found tells better what is flat.
        let mean = self.area;
        let along = |t: &u32| self.areas[*t as usize].dot(&mean);
        let best = self.triangles.iter().copied().max_by(|a, b| along(a).total_cmp(&along(b)))?;
        let closed = self.flood(best, mean, 2 * seed + 1);
        if !closed || self.fall().abs() < CREASE {
            return None;
        }
        for _ in 0..ROUNDS {
            let rim = self.rim()?;
            if !self.cut_back(&rim) {
                return Some(rim);
            }
        }
        None
    }

    /// Takes what lies flat with a plane of that normal and hangs together with `first`, under the number `name`;
    /// whether it has neighbours all around.
    fn flood(&mut self, first: u32, normal: Vector3<f64>, name: u32) -> bool {
        // The second flood of a seed may take what the first took.
        let free = |owner: u32| owner == NONE || (name % 2 == 1 && owner + 1 == name);
        let size = normal.norm_squared();
        (self.name, self.area) = (name, Vector3::zeros());
        self.triangles.clear();
        self.triangles.push(first);
        self.owner[first as usize] = name;
        let (mut at, mut closed) = (0, true);
        while let Some(&t) = self.triangles.get(at) {
            at += 1;
            self.area += self.areas[t as usize];
            for h in 3 * t..3 * t + 3 {
                let o = self.opposite[h as usize];
                closed &= o != NONE;
                if o == NONE || !free(self.owner[(o / 3) as usize]) {
                    continue;
                }
                let other = o / 3;
                let area = self.areas[other as usize];
                let (along, square) = (area.dot(&normal), area.norm_squared());
                let flat = along > 0.0 && along * along > FLAT * FLAT * size * square;
                if flat || self.is_sliver(other, square.sqrt()) {
                    self.owner[other as usize] = name;
                    self.triangles.push(other);
                }
            }
        }
        closed
    }

    /// Gives up the triangles at a rim whose edges are not seen from its middle; whether there were any.
    fn cut_back(&mut self, rim: &[u32]) -> bool {
        let (centre, _) = self.rim_centre(rim);
        let seen = |h: u32| (self.at(h) - centre).cross(&(self.at(next(h)) - centre)).dot(&self.area) > 0.0;
        let hiding: FxHashSet<u32> = rim.iter().filter(|&&h| !seen(h)).map(|h| h / 3).collect();
        for &t in &hiding {
            self.owner[t as usize] = GIVEN_UP;
        }
        self.triangles.retain(|t| !hiding.contains(t));
        self.area = self.triangles.iter().map(|&t| self.areas[t as usize]).sum();
        !hiding.is_empty()
    }

    /// The half-edges of the rim in order; `None` where they are few, more than one loop, or touch an open edge.
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
            if !seen.insert(self.origin(last)) || self.meets_open_edge(last) {
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

    /// Whether the surface outside is open at the vertex that a half-edge of the rim starts at.
    fn meets_open_edge(&self, h: u32) -> bool {
        let mut o = self.opposite[h as usize];
        while o != NONE && !self.holds(o / 3) {
            o = self.opposite[next(o) as usize];
        }
        o == NONE
    }

    /// The middle of a rim, and its length.
    fn rim_centre(&self, rim: &[u32]) -> (Point3<f64>, f64) {
        let vertices: Vec<u32> = rim.iter().map(|&h| self.origin(h)).collect();
        rim_centre(self.mesh, &vertices)
    }

    /// Whether it closes a cut: round, with an edge around it, and a vessel as wide behind it.
    fn is_cap(&mut self, rim: &[u32]) -> bool {
        let Some(normal) = self.area.try_normalize(0.0) else { return false };
        let (centre, around) = self.rim_centre(rim);
        let area = 0.5 * self.area.norm();
        let fall = self.fall();
        if area < ROUND * around * around / (4.0 * PI) || fall.abs() < CREASE {
            return false;
        }
        // The surface may be inside out.
        let outward = if fall < 0.0 { normal } else { -normal };
        let edge = around / rim.len() as f64 / (area / PI).sqrt();
        // Fades toward edges that are too long to be those of marching cubes.
        let lacking = edge.min(5.0 * (SHORT - edge)).max(0.0);
        self.ends_vessel(rim, (centre, outward), area, SECTION.end * (1.0 + lacking).powi(2))
    }

    /// Whether what comes right behind it is a vessel as wide: by the sections there, parallel to it, the first at most
    /// `most` times its area.
    fn ends_vessel(
        &mut self,
        rim: &[u32],
        (centre, outward): (Point3<f64>, Vector3<f64>),
        area: f64,
        most: f64,
    ) -> bool {
        let mut section = |area: f64, radii: f64| {
            let depth = radii * (area / PI).sqrt();
            self.section_behind(rim, &(centre - outward * depth), &outward, AROUND * radii * area)
        };
        let Some((near, _)) = section(area, 0.5) else { return false };
        if !(SECTION.start..most).contains(&(near / area)) {
            return false;
        }
        let Some((far, middle)) = section(near, 1.0) else { return false };
        let along = centre - middle;
        if !VESSEL.contains(&(far / near)) || along.dot(&outward) > SQUARE * along.norm() {
            return false;
        }
        section(near, 1.5).is_some_and(|(farther, _)| ONWARD.contains(&(farther / near)))
    }

    /// How steeply the surface rises beyond it, the mean sine; 0 for what has no neighbours.
    /// It must have neighbours all around.
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

    /// Area within the section through `point` of what hangs together with the rim, and its centroid; `None` where
    /// there is none, or more than `most` of the surface before it.
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
                before += 0.5 * self.areas[t as usize].norm();
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
