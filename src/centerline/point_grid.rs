//! Neighbours within a radius, by a sorted uniform grid.

use std::ops::Range;

use nalgebra::{Point3, Vector3};

type Cell = [i64; 3];

/// Points sorted into cubes of one size; a query looks into the cubes that its ball can touch.
///
/// Building takes `O(n log n)`; a query of radius up to the cube's size looks into 27 cubes, one of any radius at no
/// more rows of cubes than there are cubes with points. The order of
/// the answer depends on the points alone.
#[derive(Debug, Clone)]
pub struct PointGrid {
    points: Vec<Point3<f64>>,
    cell_size: f64,
    /// Distinct cells, ascending, each with the start of its points in `order`.
    cells: Vec<(Cell, u32)>,
    order: Vec<u32>,
}

impl PointGrid {
    /// `cell_size` in the points' unit, positive; best near the radius of the queries.
    pub fn new(points: Vec<Point3<f64>>, cell_size: f64) -> Self {
        // A size of zero or below comes of points that all coincide: any size serves those.
        let cell_size = if cell_size > 0.0 { cell_size } else { 1.0 };
        let mut keyed: Vec<(Cell, u32)> = points
            .iter()
            .enumerate()
            .map(|(index, point)| (cell_of(point, cell_size), index as u32))
            .collect();
        keyed.sort_unstable();
        let mut cells: Vec<(Cell, u32)> = Vec::new();
        for (position, (cell, _)) in keyed.iter().enumerate() {
            if cells.last().is_none_or(|(last, _)| last != cell) {
                cells.push((*cell, position as u32));
            }
        }
        Self { points, cell_size, cells, order: keyed.into_iter().map(|(_, index)| index).collect() }
    }

    pub fn point(&self, index: usize) -> Point3<f64> {
        self.points[index]
    }

    /// Calls `visit(index, distance)` for every point closer to `centre` than `radius`.
    pub fn for_each_within(&self, centre: &Point3<f64>, radius: f64, mut visit: impl FnMut(usize, f64)) {
        let mut look_at = |index: u32| {
            let distance = (self.points[index as usize] - centre).norm();
            if distance < radius {
                visit(index as usize, distance);
            }
        };
        let corner = Vector3::repeat(radius);
        let (low, high) =
            (cell_of(&(centre - corner), self.cell_size), cell_of(&(centre + corner), self.cell_size));
        let rows = |axis: usize| (high[axis].saturating_sub(low[axis]) as usize).saturating_add(1);
        if rows(0).saturating_mul(rows(1)) > self.cells.len() {
            // A ball of so many cubes' size: most of its rows are empty.
            for (number, (cell, _)) in self.cells.iter().enumerate() {
                if (0..3).all(|axis| (low[axis]..=high[axis]).contains(&cell[axis])) {
                    self.points_of(number..number + 1).iter().for_each(|&index| look_at(index));
                }
            }
            return;
        }
        for x in low[0]..=high[0] {
            for y in low[1]..=high[1] {
                let first = self.cells.partition_point(|(cell, _)| *cell < [x, y, low[2]]);
                let row = self.cells[first..].iter().take_while(|(cell, _)| *cell <= [x, y, high[2]]).count();
                self.points_of(first..first + row).iter().for_each(|&index| look_at(index));
            }
        }
    }

    /// The points of a run of cubes.
    fn points_of(&self, cells: Range<usize>) -> &[u32] {
        let start = |cell: usize| self.cells.get(cell).map_or(self.order.len(), |(_, start)| *start as usize);
        &self.order[start(cells.start)..start(cells.end)]
    }
}

fn cell_of(point: &Point3<f64>, size: f64) -> Cell {
    [point.x, point.y, point.z].map(|coordinate| (coordinate / size).floor() as i64)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cloud(count: u32) -> Vec<Point3<f64>> {
        // A low-discrepancy cloud: fractions of multiples of irrationals.
        (0..count)
            .map(|k| {
                let k = f64::from(k);
                Point3::new(
                    (k * 0.754_877_666).fract(),
                    (k * 0.569_840_291).fract() - 0.5,
                    (k * 0.343).fract() * 3.0,
                )
            })
            .collect()
    }

    #[test]
    fn finds_what_a_full_scan_finds() {
        let points = cloud(500);
        for cell_size in [0.05, 0.2, 5.0] {
            let grid = PointGrid::new(points.clone(), cell_size);
            for centre in points.iter().step_by(37) {
                let mut found = Vec::new();
                grid.for_each_within(centre, 0.3, |index, _| found.push(index));
                found.sort_unstable();
                let expected: Vec<usize> =
                    (0..points.len()).filter(|&k| (points[k] - centre).norm() < 0.3).collect();
                assert_eq!(found, expected);
            }
        }
    }

    #[test]
    fn a_ball_of_any_size_is_looked_through_at_once() {
        let grid = PointGrid::new(cloud(500), 1e-12);
        let mut count = 0;
        grid.for_each_within(&Point3::origin(), 1e12, |_, _| count += 1);
        assert_eq!(count, 500);
    }

    #[test]
    fn coinciding_points_and_no_points_are_fine() {
        let points = vec![Point3::new(1.0, 1.0, 1.0); 100];
        let mut count = 0;
        PointGrid::new(points.clone(), 0.0).for_each_within(&points[0], 0.5, |_, _| count += 1);
        assert_eq!(count, 100);
        PointGrid::new(Vec::new(), 1.0)
            .for_each_within(&Point3::origin(), 1.0, |_, _| panic!("there is no point"));
    }
}
