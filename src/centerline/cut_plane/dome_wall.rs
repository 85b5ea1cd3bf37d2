//! The wall of a dome: what of the surface lies on its sphere, and the neck that it opens into.

use std::f64::consts::PI;

use nalgebra::{Point3, Vector3};
use rustc_hash::{FxHashMap, FxHashSet};

use crate::mesh::preparation::Surface;

/// How far from its middle what is on a dome may reach, in radii: a bleb of half its radius, and no vessel.
const REACH: f64 = 1.6;

/// The wall near a sphere, in one piece around a tip.
pub struct DomeWall {
    triangles: Vec<u32>,
}

/// What lies past the border of a wall.
pub struct Border {
    /// Triangles that close its holes: of blebs and of noise.
    patches: Vec<u32>,
    /// Twice the area vectors of its openings, out of the dome: one for each piece of the surface that goes on.
    openings: Vec<Vector3<f64>>,
}

impl DomeWall {
    /// Floods the wall from some triangles as far as it is on the sphere. O(its triangles).
    pub fn around(surface: &Surface, seeds: &[u32], (centre, radius): &(Point3<f64>, f64)) -> Self {
        /// How far off the sphere its wall may be, in radii.
        const SHELL: f64 = 0.08;
        let on = |t: u32| {
            let corners = surface.mesh.triangles[t as usize].map(|v| surface.mesh.vertices[v as usize]);
            corners.iter().all(|p| ((p - centre).norm() / radius - 1.0).abs() < SHELL)
        };
        let mut triangles: Vec<u32> = seeds.iter().copied().filter(|&t| on(t)).collect();
        triangles.sort_unstable();
        triangles.dedup();
        let mut seen: FxHashSet<u32> = triangles.iter().copied().collect();
        let mut next = 0;
        while let Some(&t) = triangles.get(next) {
            next += 1;
            for beside in beside(surface, t) {
                if !seen.contains(&beside) && on(beside) {
                    seen.insert(beside);
                    triangles.push(beside);
                }
            }
        }
        triangles.sort_unstable();
        Self { triangles }
    }

    pub fn holds(&self, triangle: u32) -> bool {
        self.triangles.binary_search(&triangle).is_ok()
    }

    /// Its half-edges along its border.
    fn edges(&self, surface: &Surface) -> Vec<u32> {
        let all = self.triangles.iter().flat_map(|&t| 3 * t..3 * t + 3);
        all.filter(|&h| !self.holds(surface.corners.opposite(h) / 3)).collect()
    }

    pub fn is_same(&self, other: &Self) -> bool {
        self.triangles == other.triangles
    }

    pub fn points(&self, surface: &Surface) -> Vec<Point3<f64>> {
        let mut all: Vec<u32> =
            self.triangles.iter().flat_map(|&t| surface.mesh.triangles[t as usize]).collect();
        all.sort_unstable();
        all.dedup();
        all.into_iter().map(|v| surface.mesh.vertices[v as usize]).collect()
    }

    /// Share of the solid angle around `centre` that it fills with the patches of its border (van Oosterom and Strackee
    /// 1983).
    pub fn share(&self, surface: &Surface, border: &Border, centre: &Point3<f64>) -> f64 {
        let angle = |&t: &u32| {
            let [a, b, c] =
                surface.mesh.triangles[t as usize].map(|v| surface.mesh.vertices[v as usize] - centre);
            let (x, y, z) = (a.norm(), b.norm(), c.norm());
            let below = x * y * z + a.dot(&b) * z + b.dot(&c) * x + c.dot(&a) * y;
            2.0 * a.dot(&b.cross(&c)).atan2(below)
        };
        self.triangles.iter().chain(&border.patches).map(angle).sum::<f64>() / (4.0 * PI)
    }
}

impl Border {
    /// A piece past the wall goes on where it leaves the dome's surroundings or ends in an opening; if none does, as on a
    /// small vessel, the largest is its rest. O(triangles within [`REACH`]).
    pub fn of(wall: &DomeWall, surface: &Surface, sphere: &(Point3<f64>, f64)) -> Self {
        let edges = wall.edges(surface);
        let outside = |h: u32| surface.corners.opposite(h) / 3;
        let mut beyond = Beyond { surface, wall, sphere, pieces: Vec::new(), piece_of: FxHashMap::default() };
        edges.iter().for_each(|&h| beyond.flood(outside(h)));
        let pieces = &beyond.pieces;
        let none = pieces.iter().all(|piece| !piece.goes_on);
        let largest = (0..pieces.len()).max_by(|&a, &b| pieces[a].area.total_cmp(&pieces[b].area));
        let mut holes = vec![Vector3::zeros(); pieces.len()];
        let place = |v: u32| surface.mesh.vertices[v as usize] - sphere.0;
        for &h in &edges {
            // The wall's own half-edges run the other way around what closes it. Each was flooded from.
            holes[beyond.piece_of[&outside(h)]] -=
                place(surface.corners.origin(h)).cross(&place(surface.corners.target(h)));
        }
        let mut border = Self { patches: Vec::new(), openings: Vec::new() };
        for (number, (piece, hole)) in pieces.iter().zip(holes).enumerate() {
            if piece.goes_on || (none && Some(number) == largest) {
                border.openings.push(hole);
            } else {
                border.patches.extend(&piece.triangles);
            }
        }
        border.patches.sort_unstable();
        border
    }

    /// Whether a triangle is one of those that close a hole.
    pub fn closes(&self, triangle: u32) -> bool {
        self.patches.binary_search(&triangle).is_ok()
    }

    /// Unit direction through the neck and its radius: the opening that faces the `joint` most, which lies there from the
    /// sphere's middle; `None` where there is none, and where a joint `within` the sphere does not tell which of several it
    /// is.
    pub fn neck(&self, joint: &Vector3<f64>, within: bool) -> Option<(Vector3<f64>, f64)> {
        /// Least area of an opening against the largest.
        const LEAST: f64 = 0.2;
        let largest = self.openings.iter().map(Vector3::norm).fold(0.0, f64::max);
        let wide = || self.openings.iter().filter(|opening| opening.norm() >= LEAST * largest);
        if within && wide().count() > 1 {
            return None;
        }
        let necks = wide()
            .filter_map(|opening| Some((opening.try_normalize(0.0)?, (0.5 * opening.norm() / PI).sqrt())));
        necks.max_by(|a, b| a.0.dot(joint).total_cmp(&b.0.dot(joint)))
    }
}

/// The three triangles beside one.
fn beside(surface: &Surface, t: u32) -> [u32; 3] {
    [3 * t, 3 * t + 1, 3 * t + 2].map(|h| surface.corners.opposite(h) / 3)
}

/// The surface past the border of a wall, in pieces.
struct Beyond<'a> {
    surface: &'a Surface,
    wall: &'a DomeWall,
    sphere: &'a (Point3<f64>, f64),
    pieces: Vec<Piece>,
    /// The piece that each triangle past the wall is of.
    piece_of: FxHashMap<u32, usize>,
}

#[derive(Debug, Clone, Default)]
struct Piece {
    triangles: Vec<u32>,
    area: f64,
    goes_on: bool,
}

impl Beyond<'_> {
    /// Floods the piece of a triangle as far as it lies around the dome.
    fn flood(&mut self, first: u32) {
        if self.piece_of.contains_key(&first) {
            return;
        }
        let number = self.pieces.len();
        let mut piece = Piece { triangles: vec![first], ..Piece::default() };
        self.piece_of.insert(first, number);
        let mut next = 0;
        while let Some(&t) = piece.triangles.get(next) {
            next += 1;
            piece.area += self.surface.mesh.area_vector(t).norm();
            if self.is_far(t) || self.surface.is_cap(t) {
                piece.goes_on = true;
                continue;
            }
            for beside in beside(self.surface, t) {
                if !self.wall.holds(beside) && !self.piece_of.contains_key(&beside) {
                    self.piece_of.insert(beside, number);
                    piece.triangles.push(beside);
                }
            }
        }
        self.pieces.push(piece);
    }

    /// Whether a triangle lies farther from the dome than a bleb.
    fn is_far(&self, t: u32) -> bool {
        let (centre, radius) = self.sphere;
        let corners = self.surface.mesh.triangles[t as usize].map(|v| self.surface.mesh.vertices[v as usize]);
        corners.iter().any(|corner| (corner - centre).norm() > REACH * radius)
    }
}
