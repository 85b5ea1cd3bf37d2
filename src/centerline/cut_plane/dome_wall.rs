//! The wall of a dome: what of the surface lies on its sphere, and the neck that it opens into.

use std::f64::consts::PI;

use nalgebra::{Point3, Vector3};
use rustc_hash::{FxHashMap, FxHashSet};

use crate::mesh::preparation::Surface;

/// The wall near a sphere, in one piece around a tip.
pub struct DomeWall {
    triangles: Vec<u32>,
}

/// What lies past the border of a wall.
pub struct Border {
    /// Triangles that close its holes: of blebs, of a cap, of noise.
    patches: Vec<u32>,
    /// Area vectors of its openings, out of the dome: one for each piece of the surface that goes on.
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
        let mut seen: FxHashSet<u32> = seeds.iter().copied().filter(|&t| on(t)).collect();
        let mut triangles: Vec<u32> = seen.iter().copied().collect();
        let mut next = 0;
        while let Some(&t) = triangles.get(next) {
            next += 1;
            for beside in around(surface, t) {
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
    /// O(triangles of the wall x pieces past it).
    pub fn of(wall: &DomeWall, surface: &Surface) -> Self {
        let inside: FxHashSet<u32> = wall.triangles.iter().copied().collect();
        let area = |&t: &u32| surface.mesh.area_vector(t).norm();
        let limit = wall.triangles.iter().map(area).sum();
        let half_edges = wall.triangles.iter().flat_map(|&t| 3 * t..3 * t + 3);
        let edges: Vec<u32> =
            half_edges.filter(|&h| !inside.contains(&(surface.corners.opposite(h) / 3))).collect();
        let mut beyond =
            Beyond { surface, wall: inside, limit, pieces: Vec::new(), piece_of: FxHashMap::default() };
        edges.iter().for_each(|&h| beyond.flood(surface.corners.opposite(h) / 3));
        let mut openings = vec![Vector3::zeros(); beyond.pieces.len()];
        if let Some(&first) = edges.first() {
            let place = |v: u32| surface.mesh.vertices[v as usize];
            let origin = place(surface.corners.origin(first));
            for &h in &edges {
                let [from, to] =
                    [surface.corners.origin(h), surface.corners.target(h)].map(|v| place(v) - origin);
                // The wall's own half-edges run the other way around what closes it.
                openings[beyond.past(h)] -= from.cross(&to);
            }
        }
        let (mut patches, mut open) = (Vec::new(), Vec::new());
        for (number, (piece, opening)) in beyond.pieces.iter().zip(openings).enumerate() {
            if beyond.goes_on(number) {
                open.push(opening);
            } else if piece.part_of.is_none() {
                patches.extend(&piece.triangles);
            }
        }
        Self { patches, openings: open }
    }

    /// Whether a triangle is one of those that close a hole.
    pub fn closes(&self, triangle: u32) -> bool {
        self.patches.contains(&triangle)
    }

    /// Unit direction through the neck: the opening that faces the `joint` most, which lies there from the sphere's middle;
    /// `None` where there is none, and where a joint `within` the sphere does not tell which of several it is.
    pub fn neck(&self, joint: &Vector3<f64>, within: bool) -> Option<Vector3<f64>> {
        /// Least area of an opening against the largest.
        const LEAST: f64 = 0.2;
        let largest = self.openings.iter().map(Vector3::norm).fold(0.0, f64::max);
        let wide = || self.openings.iter().filter(|opening| opening.norm() >= LEAST * largest);
        if within && wide().count() > 1 {
            return None;
        }
        let directions = wide().filter_map(|opening| opening.try_normalize(0.0));
        directions.max_by(|a, b| a.dot(joint).total_cmp(&b.dot(joint)))
    }
}

/// The three triangles beside one.
fn around(surface: &Surface, t: u32) -> [u32; 3] {
    [3 * t, 3 * t + 1, 3 * t + 2].map(|h| surface.corners.opposite(h) / 3)
}

/// The surface past the border of a wall, in pieces.
struct Beyond<'a> {
    surface: &'a Surface,
    /// Area of the wall: a piece that is larger goes on.
    limit: f64,
    /// The wall, and the piece that each triangle past it is of.
    wall: FxHashSet<u32>,
    piece_of: FxHashMap<u32, usize>,
    pieces: Vec<Piece>,
}

#[derive(Debug, Clone, Default)]
struct Piece {
    triangles: Vec<u32>,
    area: f64,
    /// The piece that it turned out to be a part of.
    part_of: Option<usize>,
}

impl Beyond<'_> {
    /// Floods the piece of a triangle until it ends, goes on too far or comes to another.
    fn flood(&mut self, first: u32) {
        if self.piece_of.contains_key(&first) {
            return;
        }
        let number = self.pieces.len();
        let mut piece = Piece { triangles: vec![first], ..Piece::default() };
        self.piece_of.insert(first, number);
        let mut next = 0;
        while let Some(&t) = piece.triangles.get(next).filter(|_| piece.area <= self.limit) {
            next += 1;
            piece.area += self.surface.mesh.area_vector(t).norm();
            for beside in around(self.surface, t) {
                match self.piece_of.get(&beside) {
                    Some(&other) if other != number => piece.part_of = Some(other),
                    None if !self.wall.contains(&beside) => {
                        self.piece_of.insert(beside, number);
                        piece.triangles.push(beside);
                    }
                    _ => {}
                }
            }
            if piece.part_of.is_some() {
                break;
            }
        }
        self.pieces.push(piece);
    }

    /// Number of the whole piece past a half-edge of the wall.
    fn past(&self, h: u32) -> usize {
        let mut number = self.piece_of[&(self.surface.corners.opposite(h) / 3)];
        while let Some(whole) = self.pieces[number].part_of {
            number = whole;
        }
        number
    }

    /// Whether a piece goes on past its dome: one that is larger than the wall, and the largest of all, as the rest of a
    /// small vessel may be.
    fn goes_on(&self, number: usize) -> bool {
        let is_whole = |piece: &Piece| piece.part_of.is_none();
        let largest =
            self.pieces.iter().filter(|piece| is_whole(piece)).map(|piece| piece.area).fold(0.0, f64::max);
        let piece = &self.pieces[number];
        is_whole(piece) && (piece.area > self.limit || piece.area == largest)
    }
}
