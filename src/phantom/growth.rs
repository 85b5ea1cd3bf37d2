//! Vessels that grow where there is room.

use nalgebra::{Point3, Unit, Vector3};

use super::curve::{Pose, direction, turned, wander};
use super::kinds::leaving;
use super::random::Random;
use super::skeleton::{Skeleton, Vessel};

/// Curves that are tried for one vessel.
const TRIES: usize = 60;

/// Points of the curves that are looked at for room: one in so many.
const STRIDE: usize = 4;

/// A tree that forks `levels` times into `ways`.
pub(super) struct Fork {
    pub levels: usize,
    pub ways: usize,
    pub radius: f64,
    pub length: f64,
}

/// Share of its radius that a vessel keeps to its end.
const TAPER: f64 = 0.85;

/// Length of a child over its parent's.
const SHORTER: f64 = 0.86;

/// Vessels, and the room that every two of them leave between their walls.
pub(super) struct Growth {
    skeleton: Skeleton,
    room: f64,
}

impl Growth {
    pub fn new(vessels: Vec<Vessel>, room: f64) -> Self {
        Self { skeleton: Skeleton { vessels }, room }
    }

    pub fn vessels(&self) -> &[Vessel] {
        &self.skeleton.vessels
    }

    pub fn finish(self) -> Skeleton {
        self.skeleton
    }

    /// Adds `vessel` unless it comes too near to another one farther than `joint` from its start.
    pub fn add_clear(&mut self, vessel: Vessel, joint: f64) -> bool {
        let start = vessel.points[0];
        let far = |point: &Point3<f64>| (point - start).norm() > joint;
        let crowded = |point: &Point3<f64>, radius: f64| {
            self.skeleton.vessels.iter().any(|other| {
                let near = |place: usize| {
                    let reach = radius + other.radii[place] + self.room;
                    let apart = (other.points[place] - point).norm();
                    apart < reach && (far(point) || far(&other.points[place]))
                };
                (0..other.points.len()).step_by(STRIDE).any(near)
            })
        };
        let places = (0..vessel.points.len()).step_by(STRIDE);
        if places.into_iter().any(|place| crowded(&vessel.points[place], vessel.radii[place])) {
            return false;
        }
        self.skeleton.vessels.push(vessel);
        true
    }
}

/// Adds a branch of `length` that leaves a vessel in the direction that `leave` makes of the
/// vessel's own; `None` when it finds no room.
pub(super) fn side_branch(
    growth: &mut Growth,
    parent: (usize, usize),
    length: f64,
    radii: [f64; 2],
    turn: f64,
    random: &mut Random,
    leave: impl Fn(Unit<Vector3<f64>>) -> Unit<Vector3<f64>>,
) -> Option<()> {
    let trunk = &growth.vessels()[parent.0];
    let point = trunk.points[parent.1];
    let joint = 2.0 * trunk.radii[parent.1] + 2.0 * radii[0];
    let start = Pose { point, direction: leave(direction(&trunk.points, parent.1)) };
    (0..TRIES)
        .any(|_| {
            let points = wander(start, length, turn, random);
            growth.add_clear(Vessel::tapered(points, radii, Some(parent)), joint)
        })
        .then_some(())
}

/// A tree from the origin along y; `None` when a branch finds no room.
///
/// Radii at a fork follow Murray's law, the children 8 % wider, and taper along each vessel.
pub(super) fn grow_tree(fork: &Fork, random: &mut Random) -> Option<Skeleton> {
    let up = turned(Vector3::y_axis(), Vector3::z_axis(), random.range(-0.4, 0.4));
    let start = Pose { point: Point3::origin(), direction: up };
    let points = wander(start, fork.length, turn(fork.length, fork.radius), random);
    let root = Vessel::tapered(points, [fork.radius, TAPER * fork.radius], None);
    let mut growth = Growth::new(vec![root], 1.5);
    let mut generation = vec![0];
    let mut length = fork.length;
    for _ in 0..fork.levels {
        length *= SHORTER;
        let mut next = Vec::new();
        for parent in generation {
            let first = growth.vessels().len();
            branch_off(&mut growth, parent, fork.ways, length, random)?;
            next.extend(first..growth.vessels().len());
        }
        generation = next;
    }
    Some(growth.finish())
}

/// Adds the children at a vessel's end, evenly around it, each about 45 degrees off its direction.
fn branch_off(
    growth: &mut Growth,
    parent: usize,
    ways: usize,
    length: f64,
    random: &mut Random,
) -> Option<()> {
    let vessel = &growth.vessels()[parent];
    let last = vessel.points.len() - 1;
    let (point, axis) = (vessel.points[last], direction(&vessel.points, last));
    let wide = vessel.radii[last];
    let radius = 1.08 * wide * (ways as f64).powf(-1.0 / 3.0);
    for _ in 0..TRIES {
        let before = growth.vessels().len();
        let across = random.perpendicular(&axis);
        let grown = (0..ways).all(|way| {
            let around = turned(across, axis, std::f64::consts::TAU * way as f64 / ways as f64);
            let start = Pose { point, direction: leaving(axis, around, random.range(0.7, 0.9)) };
            let long = length * random.range(0.85, 1.12);
            (0..TRIES).any(|_| {
                let points = wander(start, long, turn(long, radius), random);
                let child = Vessel::tapered(points, [radius, TAPER * radius], Some((parent, last)));
                growth.add_clear(child, 4.0 * wide)
            })
        });
        if grown {
            return Some(());
        }
        growth.skeleton.vessels.truncate(before);
    }
    None
}

/// The most that an arc of a vessel turns: its bend stays wider than three radii.
fn turn(length: f64, radius: f64) -> f64 {
    (length / 3.0 / (3.0 * radius)).min(0.8)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn straight(from: [f64; 3], to: [f64; 3], parent: Option<(usize, usize)>) -> Vessel {
        let (from, to) = (Point3::from(from), Point3::from(to));
        let points = (0..=100).map(|step| from + (to - from) * (f64::from(step) / 100.0)).collect();
        Vessel::tapered(points, [1.0, 1.0], parent)
    }

    #[test]
    fn a_vessel_grows_only_where_there_is_room() {
        let trunk = straight([0.0; 3], [20.0, 0.0, 0.0], None);
        let mut growth = Growth::new(vec![trunk], 1.5);
        let across = straight([10.0, -8.0, 3.0], [10.0, 8.0, 3.0], None);
        assert!(!growth.add_clear(across, 1.0), "walls 1 apart");
        let higher = straight([10.0, -8.0, 4.0], [10.0, 8.0, 4.0], None);
        assert!(growth.add_clear(higher, 1.0), "walls 2 apart");
        let child = straight([10.0, 0.0, 0.0], [10.0, -7.0, -7.0], Some((0, 50)));
        assert!(growth.add_clear(child, 5.0), "near its own joint only");
        assert_eq!(growth.vessels().len(), 3);
    }

    #[test]
    fn a_tree_has_the_vessels_and_radii_of_its_levels() {
        let fork = Fork { levels: 3, ways: 2, radius: 2.5, length: 25.0 };
        let tree = (0..9).find_map(|seed| grow_tree(&fork, &mut Random::new(seed))).unwrap();
        assert_eq!(tree.vessels.len(), 15);
        let child = &tree.vessels[1];
        assert!((child.radii[0] - 2.5 * 0.85 * 1.08 / 2.0_f64.cbrt()).abs() < 1e-12);
        assert_eq!(child.points[0], *tree.vessels[0].points.last().unwrap());
    }
}
