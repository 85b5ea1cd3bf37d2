//! The triangles of a surface sorted into cubes: what a line meets, and whether a point is inside.

mod vertices;
mod wall;

use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

use crate::mesh::preparation::Surface;

/// How far beside a triangle a ray still meets it, in the triangle's sides: one through a corner must not pass between
/// the triangles around it because of rounding.
const ROUNDING: f64 = 1e-9;

/// Triangles by the cubes that their bounding boxes touch.
///
/// Building takes O(triangles), a query looks into the cubes along its line.
#[derive(Debug, Clone)]
pub struct TriangleGrid<'a> {
    surface: &'a Surface,
    low: Point3<f64>,
    high: Point3<f64>,
    cell: f64,
    /// Cubes along each axis.
    size: [usize; 3],
    /// Where each cube's triangles start; x runs fastest.
    start: Vec<u32>,
    triangles: Vec<u32>,
}

impl<'a> TriangleGrid<'a> {
    /// Sorts the triangles of `surface`.
    pub fn new(surface: &'a Surface) -> Self {
        /// Cubes a triangle: most of them are empty.
        const CUBES: usize = 4;
        /// The most cubes along one axis: a flat box has no volume to tell their size from.
        const MOST: f64 = 256.0;
        /// The most entries a triangle, on average: needles across the whole box make more, then cubes grow.
        const ENTRIES: usize = 16;
        let mut low = Point3::from(Vector3::repeat(f64::INFINITY));
        let mut high = Point3::from(Vector3::repeat(f64::NEG_INFINITY));
        for vertex in &surface.mesh.vertices {
            (low, high) = (low.inf(vertex), high.sup(vertex));
        }
        let count = surface.mesh.triangles.len();
        let sides = high - low;
        let volume: f64 = sides.iter().product();
        let mut cell = (volume / (CUBES * count.max(1)) as f64).cbrt().max(sides.max() / MOST);
        loop {
            let size = [0, 1, 2].map(|axis| cells_of(sides[axis], cell));
            let mut grid = Self { surface, low, high, cell, size, start: Vec::new(), triangles: Vec::new() };
            let boxes: Vec<[[u16; 3]; 2]> =
                surface.mesh.triangles.par_iter().map(|corners| grid.cells_under(corners)).collect();
            let touched =
                |[a, b]: &[[u16; 3]; 2]| (0..3).map(|k| usize::from(b[k] - a[k]) + 1).product::<usize>();
            if boxes.iter().map(touched).sum::<usize>() > ENTRIES * count && size != [1; 3] {
                cell *= 2.0;
                continue;
            }
            grid.fill(&boxes);
            return grid;
        }
    }

    /// Sorts the triangles into the cubes, by counting.
    fn fill(&mut self, boxes: &[[[u16; 3]; 2]]) {
        let mut start = vec![0_u32; self.size.iter().product::<usize>() + 1];
        for range in boxes {
            self.for_each_cell(range, |cell| start[cell + 1] += 1);
        }
        for cell in 1..start.len() {
            start[cell] += start[cell - 1];
        }
        let mut triangles = vec![0_u32; start.last().map_or(0, |&total| total as usize)];
        let mut next = start.clone();
        for (triangle, range) in boxes.iter().enumerate() {
            self.for_each_cell(range, |cell| {
                triangles[next[cell] as usize] = triangle as u32;
                next[cell] += 1;
            });
        }
        (self.start, self.triangles) = (start, triangles);
    }

    fn for_each_cell(&self, [a, b]: &[[u16; 3]; 2], mut visit: impl FnMut(usize)) {
        for z in a[2]..=b[2] {
            for y in a[1]..=b[1] {
                let row = (usize::from(z) * self.size[1] + usize::from(y)) * self.size[0];
                for x in a[0]..=b[0] {
                    visit(row + usize::from(x));
                }
            }
        }
    }

    /// The cubes that a triangle's bounding box touches, first and last along each axis.
    fn cells_under(&self, corners: &[u32; 3]) -> [[u16; 3]; 2] {
        let [a, b, c] = corners.map(|v| self.surface.mesh.vertices[v as usize]);
        let cell = |point: Point3<f64>| [0, 1, 2].map(|axis| self.cell_at(point[axis], axis));
        [cell(a.inf(&b).inf(&c)), cell(a.sup(&b).sup(&c))]
    }

    /// Number of the cube along an axis; that at the border for what lies outside.
    fn cell_at(&self, coordinate: f64, axis: usize) -> u16 {
        // A cast saturates below, the minimum above: MOST holds the sizes within 16 bits.
        (((coordinate - self.low[axis]) / self.cell) as u16).min(self.size[axis] as u16 - 1)
    }

    fn in_cell(&self, [x, y, z]: [usize; 3]) -> &[u32] {
        self.of_cell((z * self.size[1] + y) * self.size[0] + x)
    }

    fn of_cell(&self, cell: usize) -> &[u32] {
        &self.triangles[self.start[cell] as usize..self.start[cell + 1] as usize]
    }

    pub fn surface(&self) -> &'a Surface {
        self.surface
    }

    /// Of the box around the surface, without a look at it.
    pub fn diagonal(&self) -> f64 {
        (self.high - self.low).norm()
    }

    /// Whether the surface winds around a point: a ray from it along x leaves more often than it enters.
    ///
    /// Exact for a point in general position, and consistent where the ray meets edges and vertices: an edge
    /// that the ray touches counts for one of its two triangles, as if the point were moved by less than
    /// any number toward +y and +z. Where the surface passes through itself, inside is inside of any part.
    pub fn encloses(&self, point: &Point3<f64>) -> bool {
        let outside = |axis: usize| !(self.low[axis]..=self.high[axis]).contains(&point[axis]);
        if (0..3).any(outside) {
            return false;
        }
        let [x, y, z] = [0, 1, 2].map(|axis| self.cell_at(point[axis], axis));
        let mut winding = 0;
        for column in x..self.size[0] as u16 {
            for &t in self.in_cell([column.into(), y.into(), z.into()]) {
                let corners =
                    self.surface.mesh.triangles[t as usize].map(|v| self.surface.mesh.vertices[v as usize]);
                let crossed = crossed_along_x(&corners, point);
                // A triangle lies in several cubes of the row and counts in the first.
                if crossed != 0 {
                    let least = corners.iter().map(|corner| corner.x).fold(f64::INFINITY, f64::min);
                    if self.cell_at(least, 0).max(x) == column {
                        winding += crossed;
                    }
                }
            }
        }
        winding > 0
    }

    /// Where the segment from `a` to `b` meets the surface, as shares of its way, ascending; a hit on an edge
    /// may come twice, and hits just beyond its ends or beside an edge are told as well: none is missed.
    pub fn crossings(&self, a: &Point3<f64>, b: &Point3<f64>) -> Vec<f64> {
        /// In units of the segment and of the triangle's sides.
        const SLACK: f64 = 1e-7;
        let way = b - a;
        let mut found = Vec::new();
        self.walk(a, &way, 1.0, |triangles, _| {
            let hit = |t: &u32| self.hit(*t, a, &way, SLACK).map(|(share, _)| share);
            found.extend(
                triangles.iter().filter_map(hit).filter(|share| (-SLACK..=1.0 + SLACK).contains(share)),
            );
            false
        });
        found.sort_by(f64::total_cmp);
        found
    }

    /// The first triangle through which a ray leaves the lumen. `None` where it meets the surface from outside
    /// first, or never.
    pub fn wall_ahead(&self, origin: &Point3<f64>, direction: &Vector3<f64>) -> Option<u32> {
        let mut first: Option<(f64, u32, bool)> = None;
        self.walk(origin, direction, f64::INFINITY, |triangles, until| {
            for &t in triangles {
                if let Some((share, leaves)) = self.hit(t, origin, direction, ROUNDING)
                    && share > 0.0
                    && first.is_none_or(|(least, other, _)| (share, t) < (least, other))
                {
                    first = Some((share, t, leaves));
                }
            }
            first.is_some_and(|(share, ..)| share <= until)
        });
        first.filter(|&(_, _, leaves)| leaves).map(|(_, t, _)| t)
    }

    /// Distance to the nearest triangle through which a ray from inside leaves the lumen, in units of
    /// `direction`'s length; what it enters on the way is passed over.
    pub fn way_out(&self, origin: &Point3<f64>, direction: &Vector3<f64>) -> Option<f64> {
        let mut nearest: Option<f64> = None;
        self.walk(origin, direction, f64::INFINITY, |triangles, until| {
            for &t in triangles {
                if let Some((distance, true)) = self.hit(t, origin, direction, ROUNDING)
                    && distance > 0.0
                {
                    nearest = Some(nearest.map_or(distance, |least| least.min(distance)));
                }
            }
            nearest.is_some_and(|least| least <= until)
        });
        nearest
    }

    /// Where a line meets a triangle (Moller and Trumbore 1997), and whether it leaves the lumen there.
    fn hit(&self, t: u32, origin: &Point3<f64>, way: &Vector3<f64>, slack: f64) -> Option<(f64, bool)> {
        let [a, b, c] =
            self.surface.mesh.triangles[t as usize].map(|v| self.surface.mesh.vertices[v as usize]);
        let (e1, e2) = (b - a, c - a);
        let p = way.cross(&e2);
        let determinant = e1.dot(&p);
        if determinant == 0.0 {
            return None;
        }
        let s = origin - a;
        let u = s.dot(&p) / determinant;
        if !(-slack..=1.0 + slack).contains(&u) {
            return None;
        }
        let q = s.cross(&e1);
        let v = way.dot(&q) / determinant;
        let within = v >= -slack && u + v <= 1.0 + slack;
        within.then(|| (e2.dot(&q) / determinant, determinant < 0.0))
    }

    /// Calls `visit` with the triangles of each cube along the line from `origin`, and the share of `way` at which
    /// the line leaves it, up to the share `most`, until it answers that this is enough.
    fn walk(
        &self,
        origin: &Point3<f64>,
        way: &Vector3<f64>,
        most: f64,
        mut visit: impl FnMut(&[u32], f64) -> bool,
    ) {
        let (mut enter, mut leave) = (0.0_f64, most);
        for axis in 0..3 {
            if way[axis] == 0.0 {
                if !(self.low[axis]..=self.high[axis]).contains(&origin[axis]) {
                    return;
                }
                continue;
            }
            let [near, far] =
                [self.low[axis], self.high[axis]].map(|border| (border - origin[axis]) / way[axis]);
            (enter, leave) = (enter.max(near.min(far)), leave.min(near.max(far)));
        }
        if enter > leave {
            return;
        }
        let at = origin + way * enter;
        let mut cell = [0, 1, 2].map(|axis| usize::from(self.cell_at(at[axis], axis)));
        // The share of the way at which the next cube along an axis begins.
        let border = |cell: usize, axis: usize| {
            let number = if way[axis] > 0.0 { cell + 1 } else { cell };
            let place = self.low[axis] + self.cell * number as f64;
            if way[axis] == 0.0 { f64::INFINITY } else { (place - origin[axis]) / way[axis] }
        };
        let mut next = [0, 1, 2].map(|axis| border(cell[axis], axis));
        loop {
            let axis = (0..3).min_by(|&a, &b| next[a].total_cmp(&next[b])).unwrap_or(0);
            if visit(self.in_cell(cell), next[axis]) || next[axis] > leave {
                return;
            }
            let onward = if way[axis] > 0.0 { cell[axis] + 1 } else { cell[axis].wrapping_sub(1) };
            if onward >= self.size[axis] {
                return;
            }
            cell[axis] = onward;
            next[axis] = border(onward, axis);
        }
    }
}

fn cells_of(side: f64, cell: f64) -> usize {
    if cell > 0.0 { ((side / cell).floor() as usize + 1).min(usize::from(u16::MAX)) } else { 1 }
}

/// How a ray from `point` along +x passes a triangle: 1 out of the lumen, -1 into it, 0 beside or behind.
fn crossed_along_x(corners: &[Point3<f64>; 3], point: &Point3<f64>) -> i32 {
    let arms = corners.map(|corner| corner - point);
    let (mut turns, mut twice, mut depth) = (0, 0.0, 0.0);
    for k in 0..3 {
        let (p, q, apex) = (arms[k], arms[(k + 1) % 3], arms[(k + 2) % 3]);
        // Swapping p and q turns the sign and nothing else: both triangles at an edge see the same.
        let cross = p.y * q.z - p.z * q.y;
        if p.z <= 0.0 && q.z > 0.0 && cross > 0.0 {
            turns += 1;
        } else if q.z <= 0.0 && p.z > 0.0 && cross < 0.0 {
            turns -= 1;
        }
        twice += cross;
        depth += cross * apex.x;
    }
    let ahead = depth * twice > 0.0;
    if ahead { turns } else { 0 }
}

#[cfg(test)]
mod tests {
    use nalgebra::center;
    use proptest::prelude::*;

    use super::*;
    use crate::centerline::shapes::{open_tube, torus};
    use crate::centerline::test_surfaces::{closed_surface, voxels};

    /// A ring of voxels: edges and vertices in line with every point on its lattice.
    fn ring() -> Surface {
        let inside = |p: Vector3<f64>| (p.x.hypot(p.y) - 6.0).hypot(p.z) < 2.1;
        closed_surface(&voxels([-9, -9, -3], [9, 9, 3], inside))
    }

    #[test]
    fn points_in_line_with_edges_and_vertices_are_inside_where_their_voxel_is() {
        let surface = ring();
        let grid = TriangleGrid::new(&surface);
        let mut inside = 0;
        for (x, y, z) in (-10..10).flat_map(|x| (-10..10).flat_map(move |y| (-4..4).map(move |z| (x, y, z))))
        {
            let point = Point3::new(x, y, z).map(|c| f64::from(c) + 0.5);
            let filled = (point.x.hypot(point.y) - 6.0).hypot(point.z) < 2.1;
            assert_eq!(grid.encloses(&point), filled, "{point}");
            inside += usize::from(filled);
        }
        assert!(inside > 300, "{inside}");
    }

    #[test]
    fn a_sheet_and_needles_are_sorted_too() {
        let mut surface = closed_surface(&torus(10.0, 1.5, 40, 12));
        surface.mesh.vertices.iter_mut().for_each(|p| p.z = 0.0);
        assert!(!TriangleGrid::new(&surface).encloses(&Point3::new(10.0, 0.0, 0.1)));
        let long = |k: u32| Point3::new(f64::from(k), f64::from(k * 7 % 100), f64::from(k * 31 % 97));
        surface.mesh.vertices = (0..300).map(long).collect();
        surface.mesh.triangles = (0..100).map(|k| [k, 299 - k, 150 + k % 7]).collect();
        let grid = TriangleGrid::new(&surface);
        assert!(grid.triangles.len() <= 1600, "{}", grid.triangles.len());
    }

    #[test]
    fn a_ray_along_the_axis_leaves_through_the_middle_of_a_cap() {
        let tube = closed_surface(&open_tube(10.0, 11, 48));
        let grid = TriangleGrid::new(&tube);
        for aside in [0.0, 1e-16, -3e-16, 1e-13] {
            let (from, way) = (Point3::new(aside, -aside, 5.3), Vector3::new(-aside, aside, 1.0));
            let out = grid.way_out(&from, &way).unwrap();
            assert!((out - 4.7).abs() < 1e-9, "{aside:e}: {out}");
            assert!(grid.wall_ahead(&from, &way).is_some(), "{aside:e}");
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

        #[test]
        fn what_a_line_meets_is_what_a_full_scan_finds(
            from in prop::array::uniform3(-14.0..14.0_f64),
            to in prop::array::uniform3(-14.0..14.0_f64),
        ) {
            let surface = closed_surface(&torus(10.0, 1.5, 40, 12));
            let grid = TriangleGrid::new(&surface);
            let (a, b) = (Point3::from(from) * 0.4, Point3::from(to));
            let all = 0..surface.mesh.triangles.len() as u32;
            let mut scanned: Vec<f64> = all
                .filter_map(|t| grid.hit(t, &a, &(b - a), 0.0).map(|(share, _)| share))
                .filter(|share| (0.0..=1.0).contains(share))
                .collect();
            scanned.sort_by(f64::total_cmp);
            let mut found = grid.crossings(&a, &b);
            found.dedup();
            prop_assert_eq!(&found, &scanned);
            // Between two hits the line is inside or outside as a whole, and each hit changes it.
            let bounds: Vec<f64> = [0.0].into_iter().chain(found.iter().copied()).chain([1.0]).collect();
            let states: Vec<bool> =
                bounds.windows(2).map(|w| grid.encloses(&(a + (b - a) * (0.5 * (w[0] + w[1]))))).collect();
            prop_assert!(states.windows(2).all(|pair| pair[0] != pair[1]), "{:?}", states);
            // A ray from inside leaves where the line does first.
            if let ([true, ..], [first, ..]) = (&states[..], &found[..]) {
                let wall = grid.wall_ahead(&a, &(b - a)).and_then(|t| grid.hit(t, &a, &(b - a), 0.0));
                prop_assert_eq!(wall, Some((*first, true)));
            }
            prop_assert_eq!(grid.encloses(&center(&a, &a)), states[0]);
            let all = 0..surface.mesh.triangles.len() as u32;
            let ways_out = all.filter_map(|t| grid.hit(t, &a, &(b - a), ROUNDING));
            let ways_out = ways_out.filter(|&(share, leaves)| leaves && share > 0.0).map(|(share, _)| share);
            prop_assert_eq!(grid.way_out(&a, &(b - a)), ways_out.min_by(f64::total_cmp));
        }
    }
}
