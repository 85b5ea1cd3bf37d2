//! The lumen as a field on a sparse grid: negative inside, near the wall the distance to it.

use nalgebra::Point3;

use super::PhantomError;
use super::skeleton::{Cut, Skeleton, Vessel};

/// Nodes along the side of a brick.
pub(super) const SIDE: usize = 8;

/// The field of nodes that no sphere reaches.
pub(super) const OUTSIDE: f64 = f64::INFINITY;

/// How far past a sphere the field is known, in voxels: every corner of a cell that the wall cuts.
const BAND: f64 = 1.8;

/// Bricks in the box around the lumen.
const MOST_BRICKS: f64 = 6.4e7;

/// A cut acts on the spheres this many radii from it along the vessel.
const CUT_REACH: f64 = 2.0;

/// The field at the nodes `origin + voxel * [i, j, k]`.
#[derive(Debug, Clone)]
pub(super) struct Grid {
    pub voxel: f64,
    origin: Point3<f64>,
    bricks: [usize; 3],
    /// Place of a brick in `values`, plus one; 0 for none.
    table: Vec<u32>,
    values: Vec<[f64; SIDE * SIDE * SIDE]>,
}

#[derive(Debug, Clone, Copy)]
struct Ball {
    centre: Point3<f64>,
    radius: f64,
    cut: Option<Cut>,
}

impl Grid {
    /// The field of a skeleton. `shift`, in voxels, moves the grid under it.
    pub fn of(skeleton: &Skeleton, voxel: f64, shift: f64) -> Result<Self, PhantomError> {
        let balls = balls(skeleton, voxel);
        let mut low = Point3::from([f64::INFINITY; 3]);
        let mut high = Point3::from([f64::NEG_INFINITY; 3]);
        for ball in &balls {
            let reach = nalgebra::Vector3::repeat(ball.radius + (BAND + 1.0) * voxel);
            low = low.inf(&(ball.centre - reach));
            high = high.sup(&(ball.centre + reach));
        }
        let origin = low - nalgebra::Vector3::new(shift, 0.7 * shift, 0.4 * shift) * voxel;
        let side = SIDE as f64 * voxel;
        let extent = (high - origin).map(|length| (length / side).ceil() + 1.0);
        let count = extent.product();
        if count.is_nan() || count > MOST_BRICKS {
            return Err(PhantomError::TooFine { voxel });
        }
        let bricks: [usize; 3] = extent.map(|length| length as usize).into();
        let table = vec![0; bricks.iter().product()];
        let mut grid = Self { voxel, origin, bricks, table, values: Vec::new() };
        for ball in &balls {
            grid.add(ball);
        }
        Ok(grid)
    }

    /// Makes the field that of voxels: -1 inside, 1 outside.
    pub fn binarise(&mut self) {
        for value in self.values.iter_mut().flatten() {
            *value = if *value < 0.0 { -1.0 } else { 1.0 };
        }
    }

    /// Where the node `[i, j, k]` is.
    pub fn point(&self, node: [usize; 3]) -> Point3<f64> {
        self.origin + nalgebra::Vector3::from(node.map(|place| place as f64)) * self.voxel
    }

    /// The first nodes of the bricks that hold values, in the order of the grid.
    pub fn filled(&self) -> impl Iterator<Item = [usize; 3]> + '_ {
        let [wide, deep, _] = self.bricks;
        let used = self.table.iter().enumerate().filter(|&(_, &slot)| slot > 0);
        used.map(move |(brick, _)| {
            [brick % wide * SIDE, brick / wide % deep * SIDE, brick / wide / deep * SIDE]
        })
    }

    pub fn value(&self, node: [usize; 3]) -> f64 {
        let brick = node.map(|place| place / SIDE);
        if (0..3).any(|axis| brick[axis] >= self.bricks[axis]) {
            return OUTSIDE;
        }
        match self.table[self.brick_index(brick)] {
            0 => OUTSIDE,
            slot => self.values[slot as usize - 1][offset(node)],
        }
    }

    fn brick_index(&self, [i, j, k]: [usize; 3]) -> usize {
        i + self.bricks[0] * (j + self.bricks[1] * k)
    }

    /// Lowers the field to that of one ball.
    fn add(&mut self, ball: &Ball) {
        let reach = ball.radius + BAND * self.voxel;
        let centre = (ball.centre - self.origin) / self.voxel;
        let reach = reach / self.voxel;
        // The grid starts below every ball by more than its reach.
        let first = |axis: usize| (centre[axis] - reach).ceil().max(0.0) as usize;
        let last = |axis: usize| (centre[axis] + reach).floor().max(0.0) as usize;
        for k in first(2)..=last(2) {
            for j in first(1)..=last(1) {
                let across = (j as f64 - centre[1]).powi(2) + (k as f64 - centre[2]).powi(2);
                let left = reach * reach - across;
                if left < 0.0 {
                    continue;
                }
                let (from, to) = (centre[0] - left.sqrt(), centre[0] + left.sqrt());
                for i in from.ceil().max(0.0) as usize..=to.floor().max(0.0) as usize {
                    self.lower([i, j, k], ball);
                }
            }
        }
    }

    fn lower(&mut self, node: [usize; 3], ball: &Ball) {
        let point = self.point(node);
        let mut field = (point - ball.centre).norm() - ball.radius;
        if let Some(cut) = ball.cut {
            field = field.max(cut.normal.dot(&(point - cut.point)));
        }
        let brick = self.brick_index(node.map(|place| place / SIDE));
        if self.table[brick] == 0 {
            self.values.push([OUTSIDE; SIDE * SIDE * SIDE]);
            // At most MOST_BRICKS of them, which a u32 holds.
            self.table[brick] = self.values.len() as u32;
        }
        let value = &mut self.values[self.table[brick] as usize - 1][offset(node)];
        *value = value.min(field);
    }
}

fn offset([i, j, k]: [usize; 3]) -> usize {
    i % SIDE + SIDE * (j % SIDE + SIDE * (k % SIDE))
}

/// The spheres of every vessel, as few as leave dents of less than a hundredth of a voxel.
fn balls(skeleton: &Skeleton, voxel: f64) -> Vec<Ball> {
    let mut balls = Vec::new();
    for (index, vessel) in skeleton.vessels.iter().enumerate() {
        let cuts = skeleton.cuts(index);
        let mut next = 0;
        while next < vessel.solid {
            let (centre, radius) = (vessel.points[next], vessel.radii[next]);
            let cut = cuts.into_iter().flatten().find(|cut| {
                let span = (cut.point - centre).norm();
                span < CUT_REACH * cut.radius.max(radius)
            });
            balls.push(Ball { centre, radius, cut });
            if next + 1 == vessel.solid {
                break;
            }
            next = (next + stride(vessel, next, voxel)).min(vessel.solid - 1);
        }
    }
    balls
}

/// Spheres of radius r that are s apart leave dents of s^2 / 8r.
fn stride(vessel: &Vessel, place: usize, voxel: f64) -> usize {
    let step = (vessel.points[place.max(1)] - vessel.points[place.max(1) - 1]).norm();
    let spacing = (8.0 * vessel.radii[place] * 0.01 * voxel).sqrt();
    ((spacing / step) as usize).max(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A straight tube of radius 2 along x, from 0 to 20.
    fn tube() -> Skeleton {
        let points = (0..=200).map(|step| Point3::new(f64::from(step) * 0.1, 0.0, 0.0)).collect();
        Skeleton { vessels: vec![Vessel::tapered(points, [2.0, 2.0], None)] }
    }

    fn check(grid: &Grid, expected: impl Fn(Point3<f64>) -> f64) -> usize {
        let mut nodes = 0;
        for [i, j, k] in grid.filled() {
            for place in 0..SIDE * SIDE * SIDE {
                let node = [i + place % SIDE, j + place / SIDE % SIDE, k + place / SIDE / SIDE];
                let known = expected(grid.point(node));
                if known.abs() < 1.7 * grid.voxel {
                    let found = grid.value(node);
                    assert!((found - known).abs() < 0.011 * grid.voxel, "{found} is not {known}");
                    nodes += 1;
                }
            }
        }
        nodes
    }

    #[test]
    fn the_field_near_the_wall_is_the_distance_to_a_flat_cut_tube() {
        let grid = Grid::of(&tube(), 0.4, 0.3).unwrap();
        let side = |point: Point3<f64>| point.y.hypot(point.z) - 2.0;
        let nodes = check(&grid, |point| {
            let beyond = (-point.x).max(point.x - 20.0);
            // Off the rim, outside of both, the distance is no such simple thing.
            if side(point) > 0.0 && beyond > 0.0 { f64::NAN } else { side(point).max(beyond) }
        });
        assert!(nodes > 5000, "{nodes}");
    }

    #[test]
    fn a_voxel_that_would_fill_the_memory_is_refused() {
        assert!(matches!(Grid::of(&tube(), 1e-5, 0.0), Err(PhantomError::TooFine { .. })));
    }
}
