//! Cross-sections: the closed polygon in which a plane cuts the wall around one branch.

use std::cell::OnceCell;
use std::f64::consts::TAU;
use std::sync::LazyLock;

use nalgebra::{Point2, Point3, Unit, Vector2, Vector3};

use crate::mesh::corner_table::next;
use crate::mesh::preparation::Surface;

/// An orthonormal frame: a plane through `origin` with normal `t`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame {
    pub origin: Point3<f64>,
    pub u: Vector3<f64>,
    pub v: Vector3<f64>,
    pub t: Vector3<f64>,
}

impl Frame {
    /// The plane through `origin` perpendicular to `t`; `u` is `like` turned into the plane as
    /// little as possible, so that neighbouring frames do not spin.
    pub fn new(origin: Point3<f64>, t: Unit<Vector3<f64>>, like: Vector3<f64>) -> Self {
        let t = t.into_inner();
        let flat = like - t * t.dot(&like);
        let u = flat.try_normalize(1e-9 * like.norm()).unwrap_or_else(|| any_perpendicular(t));
        Self { origin, u, v: t.cross(&u), t }
    }

    /// Coordinates in the plane.
    pub fn flat(&self, p: &Point3<f64>) -> Point2<f64> {
        let d = p - self.origin;
        Point2::new(d.dot(&self.u), d.dot(&self.v))
    }

    /// The point of space at plane coordinates `p`.
    pub fn lift(&self, p: &Point2<f64>) -> Point3<f64> {
        self.origin + self.u * p.x + self.v * p.y
    }
}

/// Some unit vector perpendicular to `t`.
pub fn any_perpendicular(t: Vector3<f64>) -> Vector3<f64> {
    let axis = if t.x.abs() <= t.y.abs() && t.x.abs() <= t.z.abs() {
        Vector3::x()
    } else if t.y.abs() <= t.z.abs() {
        Vector3::y()
    } else {
        Vector3::z()
    };
    (axis - t * t.dot(&axis)).normalize()
}

/// How many triangles a station keeps of its section.
pub const SEEDS: usize = 6;

/// A closed polygon on the surface in one plane.
#[derive(Debug, Clone)]
pub struct Section {
    pub frame: Frame,
    /// Corners in plane coordinates; counter-clockwise around the lumen.
    pub points: Vec<Point2<f64>>,
    /// The triangle that each side (from a corner to the next) lies in.
    pub triangles: Vec<u32>,
    /// Made when they are first asked for.
    normals: OnceCell<Vec<Vector3<f64>>>,
}

/// Area, centroid and shape of a section.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SectionMeasure {
    /// Signed; positive around the lumen.
    pub area: f64,
    /// Centroid of the area, in plane coordinates.
    pub centroid: Point2<f64>,
}

impl SectionMeasure {
    /// Radius of the circle of the same area.
    pub fn radius(&self) -> f64 {
        (self.area.max(0.0) / std::f64::consts::PI).sqrt()
    }
}

/// Cuts the surface with the plane of `frame`, around from `seed`, a triangle that the plane crosses.
///
/// O(triangles crossed). `None` when the plane misses the seed.
pub fn section(surface: &Surface, frame: Frame, seed: u32) -> Option<Section> {
    /// Sides that most sections have at most.
    const USUAL: usize = 96;
    let side = |v: u32| (surface.mesh.vertices[v as usize] - frame.origin).dot(&frame.t);
    let corners = &surface.corners;
    // Leaving each triangle over its upward half-edge runs counter-clockwise around the lumen.
    let upward = |h: &u32| side(corners.origin(*h)) < 0.0 && side(corners.target(*h)) >= 0.0;
    let start = (3 * seed..3 * seed + 3).find(upward)?;
    let mut points = Vec::with_capacity(USUAL);
    let mut triangles = Vec::with_capacity(USUAL);
    let mut h = start;
    // The ends of the half-edge at hand, below and above the plane.
    let end = |v: u32| (surface.mesh.vertices[v as usize], side(v));
    let (mut below, mut above) = (end(corners.origin(h)), end(corners.target(h)));
    loop {
        let ((pa, low), (pb, high)) = (below, above);
        points.push(frame.flat(&(pa + (pb - pa) * (low / (low - high)))));
        let beyond = corners.opposite(h);
        triangles.push(beyond / 3);
        // The apex of the triangle beyond decides through which side the plane leaves it.
        let (first, second) = (next(beyond), next(next(beyond)));
        let apex = end(corners.target(first));
        h = if apex.1 >= 0.0 { first } else { second };
        *(if apex.1 >= 0.0 { &mut above } else { &mut below }) = apex;
        if h == start {
            return Some(Section { frame, points, triangles, normals: OnceCell::new() });
        }
        if points.len() > corners.half_edges() {
            return None;
        }
    }
}

/// Walks over the surface from triangle `from` straight toward the plane of `frame`, and returns the
/// first triangle that crosses it. `None` where the surface turns away before.
pub fn walk_to_plane(surface: &Surface, frame: &Frame, from: u32) -> Option<u32> {
    const LIMIT: usize = 1000;
    let side = |v: u32| (surface.mesh.vertices[v as usize] - frame.origin).dot(&frame.t);
    let corners = &surface.corners;
    let mut t = from;
    let mut least = f64::INFINITY;
    for _ in 0..LIMIT {
        let sides = surface.mesh.triangles[t as usize].map(side);
        let (low, high) =
            (sides.iter().fold(f64::MAX, |a, &b| a.min(b)), sides.iter().fold(f64::MIN, |a, &b| a.max(b)));
        if low < 0.0 && high >= 0.0 {
            return Some(t);
        }
        // Leave over the side whose ends are nearest to the plane.
        let gap = |h: u32| side(corners.origin(h)).abs() + side(corners.target(h)).abs();
        let nearest = (3 * t..3 * t + 3).min_by(|&a, &b| gap(a).total_cmp(&gap(b)))?;
        if gap(nearest) >= least {
            return None;
        }
        least = gap(nearest);
        t = corners.opposite(nearest) / 3;
    }
    None
}

impl Section {
    /// A few of its triangles, evenly around.
    pub fn seeds(&self) -> [u32; SEEDS] {
        std::array::from_fn(|i| self.triangles[i * self.triangles.len() / SEEDS])
    }

    /// The unit normal of the triangle that each side lies in, out of the lumen; zero of one without area.
    pub fn normals(&self, surface: &Surface) -> &[Vector3<f64>] {
        let normal = |&t: &u32| {
            let [a, b, c] = surface.mesh.triangles[t as usize].map(|v| surface.mesh.vertices[v as usize]);
            (b - a).cross(&(c - a)).try_normalize(0.0).unwrap_or_else(Vector3::zeros)
        };
        self.normals.get_or_init(|| self.triangles.iter().map(normal).collect())
    }

    /// Area and centroid of the polygon (Green's theorem).
    pub fn measure(&self) -> SectionMeasure {
        let Some(&base) = self.points.first() else {
            return SectionMeasure { area: 0.0, centroid: Point2::origin() };
        };
        let (mut twice, mut moment) = (0.0, Vector2::zeros());
        for (p, q, _) in self.sides() {
            let (a, b) = (p - base, q - base);
            let cross = a.x * b.y - a.y * b.x;
            twice += cross;
            moment += (a + b) * cross;
        }
        let centroid = if twice.abs() > 0.0 { base + moment / (3.0 * twice) } else { base };
        SectionMeasure { area: 0.5 * twice, centroid }
    }

    /// The vertices of the triangles that it crosses, in the order of their numbers.
    pub fn vertices(&self, surface: &Surface) -> Vec<u32> {
        let mut all: Vec<u32> =
            self.triangles.iter().flat_map(|&t| surface.mesh.triangles[t as usize]).collect();
        all.sort_unstable();
        all.dedup();
        all
    }

    /// The sides: both corners and the triangle.
    pub fn sides(&self) -> impl Iterator<Item = (Point2<f64>, Point2<f64>, u32)> + '_ {
        let n = self.points.len();
        (0..n).map(move |i| (self.points[i], self.points[(i + 1) % n], self.triangles[i]))
    }

    /// Whether the polygon winds around the point.
    pub fn encloses(&self, point: &Point2<f64>) -> bool {
        let mut inside = false;
        for (p, q, _) in self.sides() {
            if (p.y > point.y) != (q.y > point.y) {
                let x = p.x + (point.y - p.y) / (q.y - p.y) * (q.x - p.x);
                inside ^= point.x < x;
            }
        }
        inside
    }

    /// Distance from a plane point to the nearest side.
    pub fn distance(&self, point: &Point2<f64>) -> f64 {
        let to_side = |(p, q, _): (Point2<f64>, Point2<f64>, u32)| {
            let d = q - p;
            let share = ((point - p).dot(&d) / d.norm_squared().max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
            (point - (p + d * share)).norm_squared()
        };
        self.sides().map(to_side).fold(f64::INFINITY, f64::min).sqrt()
    }
}

/// The wall of a section seen from its centre: distance by direction, in equal bins of angle.
#[derive(Debug, Clone, PartialEq)]
pub struct Profile {
    /// Distance from the centre, by angle from the frame's `u`.
    pub radii: [f64; Profile::BINS],
}

impl Profile {
    pub const BINS: usize = 32;

    pub fn circle(radius: f64) -> Self {
        Self { radii: [radius; Self::BINS] }
    }

    /// The nearest wall in each direction from `centre`, which the section must enclose.
    pub fn of(section: &Section, centre: &Point2<f64>, fallback: f64) -> Self {
        const WIDTH: f64 = TAU / Profile::BINS as f64;
        /// A corner in the very direction of a bin is on both its sides: rounding must not leave it on neither.
        const SLACK: f64 = 1e-9;
        static DIRECTIONS: LazyLock<[Vector2<f64>; Profile::BINS]> = LazyLock::new(|| {
            std::array::from_fn(|bin| Vector2::new((bin as f64 * WIDTH).cos(), (bin as f64 * WIDTH).sin()))
        });
        let mut radii = [f64::INFINITY; Self::BINS];
        let first = section.points.first().map_or(Vector2::x(), |p| p - centre);
        // Each side begins in the direction in which the one before ends.
        let mut to = first.y.atan2(first.x);
        for (p, q, _) in section.sides() {
            let (a, b) = (p - centre, q - centre);
            let from = to;
            to += signed_angle(&a, &b);
            let (low, high) = (from.min(to), from.max(to));
            let mut bin = (low / WIDTH - SLACK).ceil() as i64;
            while (bin as f64) <= high / WIDTH + SLACK {
                let place = bin.rem_euclid(Self::BINS as i64) as usize;
                let direction = DIRECTIONS[place];
                let d = b - a;
                let denominator = direction.x * d.y - direction.y * d.x;
                if denominator.abs() > 0.0 {
                    let reach = (a.x * d.y - a.y * d.x) / denominator;
                    radii[place] = radii[place].min(reach.max(0.0));
                }
                bin += 1;
            }
        }
        for radius in &mut radii {
            if !radius.is_finite() {
                *radius = fallback;
            }
        }
        Self { radii }
    }

    /// Distance in a direction of the plane, linear between the bins.
    pub fn at(&self, direction: &Vector2<f64>) -> f64 {
        let place = turn(direction) * Self::BINS as f64;
        let low = place as usize;
        let (i, share) = (low % Self::BINS, place - low as f64);
        self.radii[i] * (1.0 - share) + self.radii[(i + 1) % Self::BINS] * share
    }

    /// Mean radius.
    pub fn mean(&self) -> f64 {
        self.radii.iter().sum::<f64>() / Self::BINS as f64
    }

    /// Largest over smallest distance.
    pub fn roundness(&self) -> f64 {
        let (low, high) = self.radii.iter().fold((f64::INFINITY, 0.0f64), |(l, h), &r| (l.min(r), h.max(r)));
        high / low.max(1e-12 * high)
    }

    /// The same wall seen from the plane's other side (`u` kept, `v` turned).
    pub fn mirror(&mut self) {
        self.radii[1..].reverse();
    }

    /// The same wall, larger by `factor`.
    pub fn scaled(&self, factor: f64) -> Self {
        Self { radii: self.radii.map(|radius| radius * factor) }
    }

    /// A share `weight` of `other` mixed in.
    pub fn blend(&mut self, other: &Profile, weight: f64) {
        for (own, new) in self.radii.iter_mut().zip(&other.radii) {
            *own += weight * (new - *own);
        }
    }
}

/// Angle of a direction from the first axis, as a share of a full turn in 0..=1, to 1e-12; much faster than the library's
/// arc tangent.
fn turn(direction: &Vector2<f64>) -> f64 {
    /// Tangents of 15 and 30 degrees.
    const NARROW: f64 = 0.267_949_192_431_122_7;
    const MIDDLE: f64 = 0.577_350_269_189_625_8;
    let (x, y) = (direction.x.abs(), direction.y.abs());
    // From the diagonal the quarter reaches 45 degrees to either side; of those all but 15 go by the addition theorem.
    let tangent = (y - x) / (y + x);
    let (rest, known) = if tangent.abs() <= NARROW {
        (tangent, 0.0)
    } else {
        let rest = (tangent.abs() - MIDDLE) / (1.0 + tangent.abs() * MIDDLE);
        (rest * tangent.signum(), tangent.signum() / 12.0)
    };
    // Rounding must not leave the quarter.
    let quarter = (0.125 + known + small_angle(rest) / TAU).clamp(0.0, 0.25);
    match (direction.x >= 0.0, direction.y >= 0.0) {
        (true, true) => quarter,
        (false, true) => 0.5 - quarter,
        (false, false) => 0.5 + quarter,
        (true, false) => 1.0 - quarter,
    }
}

/// The angle of a tangent below 0.27, by the arc tangent's series, to 1e-12.
fn small_angle(tangent: f64) -> f64 {
    const TERMS: [f64; 8] =
        [1.0 / 17.0, 1.0 / 15.0, 1.0 / 13.0, 1.0 / 11.0, 1.0 / 9.0, 1.0 / 7.0, 1.0 / 5.0, 1.0 / 3.0];
    let square = tangent * tangent;
    tangent * (1.0 - TERMS.iter().fold(0.0, |sum, term| square * (term - sum)))
}

/// Angle from `a` to `b`, in -pi..pi.
pub fn signed_angle(a: &Vector2<f64>, b: &Vector2<f64>) -> f64 {
    /// Nearly all sides are that short.
    const SMALL: f64 = 0.27;
    let (cross, dot) = (a.x * b.y - a.y * b.x, a.dot(b));
    if cross.abs() < SMALL * dot {
        return small_angle(cross / dot);
    }
    cross.atan2(dot)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::centerline::shapes::open_tube;
    use crate::mesh::preparation::prepare;

    #[test]
    fn a_turn_is_that_of_the_arc_tangent() {
        for i in -720..=720 {
            let angle = f64::from(i) * TAU / 720.0;
            let found = turn(&(Vector2::new(angle.cos(), angle.sin()) * 3.0));
            let off = (found - angle / TAU).rem_euclid(1.0);
            assert!(off.min(1.0 - off) < 1e-12, "{found} turns at {angle}");
        }
        for direction in [Vector2::x(), Vector2::y(), -Vector2::x(), -Vector2::y()] {
            let found = turn(&direction);
            assert!((0.0..=1.0).contains(&found), "{found}");
        }
    }

    #[test]
    fn a_tube_cut_aslant_is_an_ellipse() {
        let prepared = prepare(&open_tube(10.0, 41, 200)).unwrap();
        let surface = &prepared.components[0];
        let tilt = 0.5f64;
        let normal = Unit::new_normalize(Vector3::new(tilt.sin(), 0.0, tilt.cos()));
        let frame = Frame::new(Point3::new(0.2, 0.1, 5.0), normal, Vector3::y());
        let seed = (0..surface.mesh.triangles.len() as u32).find(|&t| section(surface, frame, t).is_some());
        let cut = section(surface, frame, seed.unwrap()).unwrap();
        let measure = cut.measure();
        let area = std::f64::consts::PI / tilt.cos();
        assert!((measure.area / area - 1.0).abs() < 1e-3, "{} against {area}", measure.area);
        let centre = frame.lift(&measure.centroid);
        assert!(centre.x.hypot(centre.y) < 1e-6, "{centre}");
        assert!(cut.encloses(&measure.centroid) && !cut.encloses(&Point2::new(9.0, 0.0)));
        assert!((cut.distance(&measure.centroid) - 1.0).abs() < 1e-3);
        let profile = Profile::of(&cut, &measure.centroid, 0.0);
        // u lies along y here, where the ellipse has its short half axis.
        assert!((profile.at(&Vector2::x()) - 1.0).abs() < 1e-3);
        assert!((profile.at(&Vector2::y()) - 1.0 / tilt.cos()).abs() < 1e-3);
    }
}
