//! The kinds of phantom, as vessels. Lengths are in mm.

use nalgebra::{Point3, Unit, Vector3};

use super::curve::{Pose, direction, sampled, turned, wander};
use super::growth::{Fork, Growth, grow_tree, side_branch};
use super::random::{Random, frame};
use super::skeleton::{Skeleton, Vessel};
use super::{Kind, PhantomError};

/// Whole skeletons that are tried before a seed is given up.
const TRIES: u64 = 64;

/// The vessels of a kind; those of a seed do not touch where they should not.
pub(super) fn build(kind: Kind, seed: u64) -> Result<Skeleton, PhantomError> {
    for attempt in 0..TRIES {
        // Seeds of the same kind share nothing, and neither do kinds of the same seed.
        let stream = seed.wrapping_mul(0x0001_0000_0001_b300).wrapping_add(kind as u64 * TRIES + attempt);
        if let Some(skeleton) = attempt_at(kind, &mut Random::new(stream)) {
            return Ok(skeleton);
        }
    }
    Err(PhantomError::Crowded { kind, seed })
}

/// `None` when a vessel found no place.
fn attempt_at(kind: Kind, random: &mut Random) -> Option<Skeleton> {
    let fork = |levels, ways, radius, length| Fork { levels, ways, radius, length };
    match kind {
        Kind::Tube => Some(single(tube(random))),
        Kind::Stenosis => Some(single(stenosis(random))),
        Kind::Bifurcation => grow_tree(&fork(1, 2, 2.5, 25.0), random),
        Kind::Tree => grow_tree(&fork(3, 2, 2.5, 25.0), random),
        Kind::Bigtree => grow_tree(&fork(5, 2, 4.0, 30.0), random),
        Kind::Trifurcation => grow_tree(&fork(2, 3, 2.5, 25.0), random),
        Kind::Loop => ring(random),
        Kind::Aneurysm => aneurysm(random),
        Kind::Mixed => mixed(random),
        Kind::Parallel => Some(parallel(random)),
    }
}

fn single(vessel: Vessel) -> Skeleton {
    Skeleton { vessels: vec![vessel] }
}

fn origin(direction: Unit<Vector3<f64>>) -> Pose {
    Pose { point: Point3::origin(), direction }
}

fn tube(random: &mut Random) -> Vessel {
    let points = wander(origin(Vector3::x_axis()), 60.0, 0.8, random);
    Vessel::tapered(points, [3.0, 3.0], None)
}

/// A tube whose radius falls to between 0.3 and 0.45 of itself near its middle.
fn stenosis(random: &mut Random) -> Vessel {
    let mut vessel = tube(random);
    let middle = random.range(0.42, 0.58);
    let severity = random.range(0.55, 0.7);
    let last = (vessel.radii.len() - 1) as f64;
    for (place, radius) in vessel.radii.iter_mut().enumerate() {
        let away = (place as f64 / last - middle) / 0.0435;
        *radius *= 1.0 - severity * (-0.5 * away * away).exp();
    }
    vessel
}

/// A ring with three branches.
fn ring(random: &mut Random) -> Option<Skeleton> {
    let (wide, narrow, wave) = (random.range(13.0, 15.0), random.range(9.0, 11.0), random.range(1.5, 2.5));
    let ellipse = |share: f64| {
        let angle = std::f64::consts::TAU * share;
        Point3::new(wide * angle.cos(), narrow * angle.sin(), wave * (3.0 * angle).sin())
    };
    let mut points = sampled(6.3 * wide.max(narrow), ellipse);
    let last = points.len() - 1;
    points[last] = points[0];
    let mut vessel = Vessel::tapered(points, [1.8, 1.8], None);
    vessel.closed = true;
    let mut growth = Growth::new(vec![vessel], 1.0);
    for third in 0..3 {
        let share = (f64::from(third) + random.range(0.05, 0.35)) / 3.0;
        let place = (share * last as f64) as usize;
        let point = growth.vessels()[0].points[place];
        let outward = Unit::new_normalize(point.coords + Vector3::z() * random.range(-4.0, 4.0));
        side_branch(&mut growth, (0, place), 25.0, [1.7, 1.3], 0.5, random, |_| outward)?;
    }
    Some(growth.finish())
}

/// A bifurcation with a sac at the side of its trunk: a ball drawn out away from the trunk, on a
/// wide neck. The sac's line runs from the trunk's axis to the far wall of the dome; its radius is
/// that of the largest sphere inside the sac.
fn aneurysm(random: &mut Random) -> Option<Skeleton> {
    let tree = grow_tree(&Fork { levels: 1, ways: 2, radius: 2.5, length: 30.0 }, random)?;
    let trunk = &tree.vessels[0];
    let place = (trunk.points.len() as f64 * random.range(0.42, 0.55)) as usize;
    let start = trunk.points[place];
    let out = random.perpendicular(&direction(&trunk.points, place));
    let ball = random.range(3.8, 4.6);
    let neck = 1.6;
    // The ball's centres lie from `near` to `far` on the line.
    let near = trunk.radii[place] + 0.65 * ball;
    let far = near + 0.4 * ball;
    let length = far + ball;
    let points = sampled(length, |share| start + out.scale(share * length));
    let along = |place: usize| length * place as f64 / (points.len() - 1) as f64;
    let radius = |along: f64| {
        let inside = (ball - (near - along).max(along - far).max(0.0)).max(0.0);
        if along < near { inside.max(neck) } else { inside }
    };
    let radii = (0..points.len()).map(|place| radius(along(place))).collect();
    let solid = (0..points.len()).take_while(|&place| along(place) <= far).count();
    let mut sac = Vessel::new(points, radii, Some((0, place)));
    sac.solid = solid;
    let mut growth = Growth::new(tree.vessels, 1.5);
    growth.add_clear(sac, length).then(|| growth.finish())
}

/// A wide trunk with thin side branches: radii from 12 to 1.
fn mixed(random: &mut Random) -> Option<Skeleton> {
    let points = wander(origin(Vector3::z_axis()), 120.0, 0.25, random);
    let last = (points.len() - 1) as f64;
    let mut growth = Growth::new(vec![Vessel::tapered(points, [12.0, 10.0], None)], 1.5);
    let turn = random.range(0.0, std::f64::consts::TAU);
    for side in 0..5 {
        let place = (last * (0.2 + 0.15 * f64::from(side))) as usize;
        // About the golden angle apart, so that no two leave on the same side.
        let angle = turn + 2.4 * f64::from(side) + random.range(-0.3, 0.3);
        let radius = random.range(1.1, 2.2);
        side_branch(&mut growth, (0, place), 50.0, [radius, 1.0], 0.35, random, |axis| {
            let (first, second) = frame(&axis);
            let across = first.scale(angle.cos()) + second.scale(angle.sin());
            Unit::new_normalize(across + axis.scale(0.3))
        })?;
    }
    Some(growth.finish())
}

/// A vessel that forks into two that run wall to wall, 0.6 apart.
fn parallel(random: &mut Random) -> Skeleton {
    let length = 60.0;
    let (half, open) = (2.3, random.range(6.5, 8.0));
    let (sway, bow) = (random.range(0.0, 1.5), random.range(3.0, 4.5));
    let middle = move |x: f64| {
        let share = x / length;
        Vector3::new(
            x,
            sway * (std::f64::consts::TAU * share).sin(),
            bow * (std::f64::consts::PI * share).sin(),
        )
    };
    let arm = |side: f64| {
        // Across the middle line, so that the gap stays 0.6 where the pair sways.
        let apart = |x: f64| half * (std::f64::consts::FRAC_PI_2 * (x / open).min(1.0)).sin();
        let place = |x: f64| {
            let along = middle(x + 1e-3) - middle(x - 1e-3);
            let across = Vector3::z().cross(&along).normalize();
            Point3::from(middle(x) + across * (side * apart(x)))
        };
        sampled(1.02 * length, |share| place(length * share))
    };
    let mut back = wander(origin(-Vector3::x_axis()), 20.0, 0.25, random);
    back.reverse();
    let joint = Some((0, back.len() - 1));
    let mut vessels = vec![Vessel::tapered(back, [2.6, 2.6], None)];
    for side in [1.0, -1.0] {
        let mut points = arm(side);
        points[0] = Point3::origin();
        vessels.push(Vessel::tapered(points, [2.0, 2.0], joint));
    }
    Skeleton { vessels }
}

/// The direction of a branch that leaves `axis` at `angle`, on the side of `across`.
pub(super) fn leaving(
    axis: Unit<Vector3<f64>>,
    across: Unit<Vector3<f64>>,
    angle: f64,
) -> Unit<Vector3<f64>> {
    turned(axis, Unit::new_normalize(axis.cross(&across)), angle)
}
