//! Centerline points gathered into cells far smaller than the neighbourhoods that are asked of them.
//!
//! Every vertex around a vessel has nearly the same centerline point, so a neighbourhood of one radius holds
//! thousands of them where a dozen cells say the same. Cells keep counts, sums and second moments, so that
//! means and covariances over them are exact; only the rim of a neighbourhood is rounded to whole cells.

use nalgebra::{Point3, Vector3};

use crate::centerline::point_grid::PointGrid;
use crate::centerline::thinning::covariance::Moments;

/// Cells a neighbourhood's radius, at least.
const CELLS_IN_RADIUS: f64 = 8.0;
/// The largest neighbourhood is this many times (2 to that power) the smallest that is served exactly.
const MOST_LEVELS: usize = 9;

/// The points of one cell.
#[derive(Debug, Clone)]
pub struct Cell {
    /// Count, mean and covariance.
    pub moments: Moments,
    /// The points in it, ascending.
    pub members: Vec<u32>,
}

/// Names a cell of a [`PointCloud`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CellId {
    pub level: usize,
    pub index: usize,
}

/// Points in cells of several sizes, each twice the one before.
#[derive(Debug, Clone, Default)]
pub struct PointCloud {
    levels: Vec<Level>,
}

#[derive(Debug, Clone)]
struct Level {
    size: f64,
    cells: Vec<Cell>,
    grid: PointGrid,
}

impl PointCloud {
    /// Serves neighbourhoods of radii about `radii` (one a point, in the points' unit). `O(n log n)`.
    pub fn new(points: &[Point3<f64>], radii: &[f64]) -> Self {
        let usable = || radii.iter().copied().filter(|radius| radius.is_finite() && *radius > 0.0);
        let largest = usable().fold(0.0, f64::max);
        if points.is_empty() || largest <= 0.0 {
            return Self::default();
        }
        let smallest = usable().fold(largest, f64::min).max(largest / f64::powi(2.0, MOST_LEVELS as i32 - 1));
        let count = (largest / smallest).log2().floor() as usize + 1;
        let size = |level: usize| smallest / CELLS_IN_RADIUS * f64::powi(2.0, level as i32);
        Self { levels: (0..count).map(|level| Level::new(points, size(level))).collect() }
    }

    pub fn cell(&self, id: CellId) -> &Cell {
        &self.levels[id.level].cells[id.index]
    }

    /// Calls `visit(cell, distance)` for every cell whose mean is closer to `centre` than `radius`, in cells
    /// an eighth of that or smaller where the cloud has them.
    pub fn for_each_within(&self, centre: &Point3<f64>, radius: f64, mut visit: impl FnMut(CellId, f64)) {
        let fits = |level: &&Level| level.size * CELLS_IN_RADIUS <= radius * (1.0 + 1e-9);
        let level = self.levels.iter().take_while(fits).count().saturating_sub(1);
        if let Some(found) = self.levels.get(level) {
            found
                .grid
                .for_each_within(centre, radius, |index, distance| visit(CellId { level, index }, distance));
        }
    }

    /// One value a cell, from its members' values; by level, then by cell.
    pub fn gather<T: Clone + Default>(&self, add: impl Fn(&mut T, usize)) -> Vec<Vec<T>> {
        let one = |cell: &Cell| {
            let mut value = T::default();
            cell.members.iter().for_each(|&member| add(&mut value, member as usize));
            value
        };
        self.levels.iter().map(|level| level.cells.iter().map(one).collect()).collect()
    }
}

impl Level {
    fn new(points: &[Point3<f64>], size: f64) -> Self {
        // Cells lie with the points, not with the frame; a share that no even spacing hits keeps points off borders.
        let base = points[0] - Vector3::repeat(0.381_966 * size);
        let key = |point: &Point3<f64>| {
            let offset = (point - base) / size;
            [offset.x, offset.y, offset.z].map(|c| c.floor() as i64)
        };
        let mut keyed: Vec<([i64; 3], u32)> =
            points.iter().enumerate().map(|(i, p)| (key(p), i as u32)).collect();
        keyed.sort_unstable();
        let cell = |group: &[([i64; 3], u32)]| Cell {
            moments: Moments::of(group.iter().map(|&(_, i)| points[i as usize].coords)),
            members: group.iter().map(|&(_, i)| i).collect(),
        };
        let cells: Vec<Cell> = keyed.chunk_by(|a, b| a.0 == b.0).map(cell).collect();
        let means = cells.iter().map(|cell| Point3::from(cell.moments.mean())).collect();
        Self { size, cells, grid: PointGrid::new(means, size * CELLS_IN_RADIUS) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spiral(count: u32) -> Vec<Point3<f64>> {
        let at = |k: u32| f64::from(k) * 0.01;
        (0..count).map(|k| Point3::new(at(k).cos() * 3.0, at(k).sin() * 3.0, at(k) * 0.4)).collect()
    }

    #[test]
    fn every_point_is_in_one_cell_of_each_level() {
        let points = spiral(1500);
        let radii: Vec<f64> = (0..1500).map(|k| 0.2 + f64::from(k) * 0.002).collect();
        let cloud = PointCloud::new(&points, &radii);
        assert!(cloud.levels.len() >= 4);
        for counts in cloud.gather(|count: &mut usize, _| *count += 1) {
            assert_eq!(counts.iter().sum::<usize>(), 1500);
        }
    }

    #[test]
    fn a_neighbourhood_holds_the_points_in_it_up_to_a_cell_at_its_rim() {
        let points = spiral(1500);
        let cloud = PointCloud::new(&points, &[0.3, 2.0]);
        for radius in [0.3, 0.9, 2.0, 4.0] {
            for centre in points.iter().step_by(100) {
                let mut found = 0.0;
                cloud.for_each_within(centre, radius, |id, _| found += cloud.cell(id).moments.count());
                let within = |r: f64| points.iter().filter(|p| (*p - centre).norm() < r).count() as f64;
                let margin = 0.25 * radius;
                assert!(
                    within(radius - margin) <= found && found <= within(radius + margin),
                    "{found} at {radius}"
                );
            }
        }
    }

    #[test]
    fn no_points_and_no_radii_are_empty() {
        PointCloud::new(&[], &[]).for_each_within(&Point3::origin(), 1.0, |_, _| panic!("there is no cell"));
        PointCloud::new(&[Point3::origin()], &[0.0])
            .for_each_within(&Point3::origin(), 1.0, |_, _| panic!("there is no scale"));
    }
}
