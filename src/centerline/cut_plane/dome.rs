//! The dome of a sac: how much of a sphere its wall covers, and where it leaves it.
//!
//! Level sets tell a sac only where the front came to it from its neck. Its wall tells it from any side: the sphere that
//! touches the wall at the tip is fitted to all of it that lies in one piece around the tip. A vessel's round end
//! and what of the vessel lies near its sphere cover less than three quarters of it, a sac all but its neck.

use nalgebra::{Point3, Vector3};

use crate::mesh::preparation::Surface;

use crate::centerline::cut_plane::bulges::sphere_through;
use crate::centerline::cut_plane::dome_wall::{Border, DomeWall};
use crate::centerline::segmentation::level_sets::LevelSet;
use crate::centerline::segmentation::track::{Bulge, Neck};
use crate::centerline::triangle_grid::TriangleGrid;

type Sphere = (Point3<f64>, f64);

/// The sphere through the wall around a tip.
pub struct Dome {
    sphere: Sphere,
    /// Share of it that is wall.
    share: f64,
    wall: DomeWall,
    border: Border,
}

impl Dome {
    /// The sphere through the wall around a tip; `None` where that is no sphere's. O(rounds x triangles of the dome + vertices
    /// and triangles around it).
    pub fn around(grid: &TriangleGrid<'_>, tip: u32) -> Option<Self> {
        let star: Vec<u32> = grid.surface().corners.star(tip).map(|h| h / 3).collect();
        Self::fitted(grid.surface(), &star, touching(grid, tip)?)
    }

    /// The sphere through the wall at the widest of a leaf's level sets, as of a sac whose tip is on a bleb; `None` where
    /// that is no sphere's, and where the tip is not on it or on what closes its holes. O(as [`Dome::around`]).
    pub fn under(grid: &TriangleGrid<'_>, rings: &[LevelSet], tip: u32) -> Option<Self> {
        let surface = grid.surface();
        let widest = rings.iter().max_by(|a, b| a.length.total_cmp(&b.length))?;
        let first = (widest.centroid, grid.clearance(&widest.centroid));
        let dome = Self::fitted(surface, &widest.triangles, first)?;
        let mut star = surface.corners.star(tip).map(|h| h / 3);
        star.all(|t| dome.wall.holds(t) || dome.border.closes(t)).then_some(dome)
    }

    /// Fits a sphere to what lies on it in one piece around some triangles.
    fn fitted(surface: &Surface, seeds: &[u32], first: Sphere) -> Option<Self> {
        const ROUNDS: usize = 6;
        /// Most that a sphere is larger than the first: one through a flat cap has no bounds, and all of the surface near it.
        const LARGER: f64 = 3.0;
        /// Largest deviation (root mean square) of the wall from it, in radii.
        const DEVIATION: f64 = 0.05;
        let mut sphere = first;
        let mut wall = DomeWall::around(surface, seeds, &sphere);
        for _ in 0..ROUNDS {
            sphere = sphere_through(&wall.points(surface), |_| 1.0)
                .filter(|sphere| sphere.1 < LARGER * first.1)?;
            let before = std::mem::replace(&mut wall, DomeWall::around(surface, seeds, &sphere));
            if before.is_same(&wall) {
                break;
            }
        }
        if deviation(&wall.points(surface), &sphere) > DEVIATION {
            return None;
        }
        let border = Border::of(&wall, surface, &sphere);
        let share = wall.share(surface, &border, &sphere.0);
        Some(Self { sphere, share, wall, border })
    }

    /// The sac that the dome is; `None` where it is too little of a sphere, or where a vessel of its own leads to it, long or
    /// bent: `way` are the centres and radii of its level sets, from the joint on.
    pub fn as_sac(&self, grid: &TriangleGrid<'_>, way: &[(Point3<f64>, f64)]) -> Option<Bulge> {
        /// Least share of the sphere that is wall: a vessel's round end and what of the vessel lies near its sphere fill up
        /// to 0.74, of one that widens to its end by a tenth of its radius a radius 0.76, a bulb of 1.3 of them 0.82.
        const SHARE: f64 = 0.83;
        let joint = way.first().filter(|_| self.share >= SHARE)?.0;
        let (centre, radius) = self.sphere;
        let ball = Bulge::ball(centre, radius);
        let Some(neck) = self.neck_toward(&joint) else { return self.holds(&joint).then_some(ball) };
        let outside = way.iter().take_while(|(place, _)| !self.holds(place)).count();
        let is_short = self.is_straight(&neck, &way[..outside]) && self.is_clear(grid, &neck);
        is_short.then_some(Bulge { neck: Some(neck), ..ball })
    }

    /// Whether a short straight stalk leads to the neck; `way` are the level sets around it.
    fn is_straight(&self, neck: &Neck, way: &[(Point3<f64>, f64)]) -> bool {
        /// The longest way from the joint to the dome that shows no sections of its own, in radii of the neck.
        const STALK: f64 = 4.0;
        /// Level sets up to so many radii of the neck go around its stalk, and are no farther than so many from its axis: no
        /// line runs straight through a bent one.
        const WIDE: f64 = 1.3;
        const BENT: f64 = 0.7;
        let along: f64 = way.windows(2).map(|pair| (pair[1].0 - pair[0].0).norm()).sum();
        let straight = neck.mouth.map_or(0.0, |mouth| (mouth - self.sphere.0).norm() - self.rise(neck));
        let aside = |place: &Point3<f64>| (place - self.sphere.0).cross(&neck.direction).norm();
        let mut around = way.iter().filter(|ring| ring.1 < WIDE * neck.stalk);
        along.max(straight) <= STALK * neck.stalk && around.all(|ring| aside(&ring.0) < BENT * neck.stalk)
    }

    /// Whether the axis through the neck keeps clear of the wall as far as the mouth.
    fn is_clear(&self, grid: &TriangleGrid<'_>, neck: &Neck) -> bool {
        /// Least distance from it, in radii of the neck. Sacs on straight stalks have 0.58 and more.
        const CLEAR: f64 = 0.5;
        /// Places between the neck and the mouth that are looked at.
        const PLACES: u32 = 8;
        let Some(mouth) = neck.mouth else { return true };
        let (centre, rise) = (self.sphere.0, self.rise(neck));
        let along = (mouth - centre).dot(&neck.direction) - rise;
        (0..=PLACES).all(|i| {
            let place = centre + neck.direction * (rise + along * f64::from(i) / f64::from(PLACES));
            grid.clearance(&place) >= CLEAR * neck.stalk
        })
    }

    /// Distance of the neck's plane from the sphere's middle.
    fn rise(&self, neck: &Neck) -> f64 {
        (self.sphere.1.powi(2) - neck.stalk.powi(2)).max(0.0).sqrt()
    }

    /// The neck of a dome that may be no whole sphere, as of a sac that is drawn out; `None` where it is too little of one to
    /// show a neck, or its neck opens into a stalk that bends away from the `joint`. Where that lies in the sac, as a front
    /// has climbed it, it says nothing.
    pub fn neck_toward(&self, joint: &Point3<f64>) -> Option<Neck> {
        /// Least share of the sphere that is wall.
        const SHARE: f64 = 0.6;
        /// Least cosine between the neck and the way to the joint.
        const TOWARD: f64 = 0.7;
        if self.share < SHARE {
            return None;
        }
        let arm = joint - self.sphere.0;
        let is_within = self.holds(joint);
        let (direction, opening) = self.border.neck(&arm, is_within)?;
        let leads = is_within || direction.dot(&arm) >= TOWARD * arm.norm();
        let stalk = opening.min(self.sphere.1);
        leads.then_some(Neck { direction, stalk, mouth: (!is_within).then_some(*joint) })
    }

    fn holds(&self, place: &Point3<f64>) -> bool {
        (place - self.sphere.0).norm() <= self.sphere.1
    }
}

/// The largest sphere inside that touches the wall at a vertex.
fn touching(grid: &TriangleGrid<'_>, vertex: u32) -> Option<Sphere> {
    /// What other wall may come nearer by: share of the radius, as vertices lie apart, and of the edges around, as they
    /// are noisy.
    const NEARER: f64 = 0.05;
    const NOISE: f64 = 0.4;
    const GROWTH: f64 = 1.2;
    let surface = grid.surface();
    let place = surface.mesh.vertices[vertex as usize];
    let mut around: Vec<u32> =
        surface.corners.neighbours(vertex).flat_map(|u| surface.corners.star(u)).map(|h| h / 3).collect();
    around.sort_unstable();
    around.dedup();
    let normal: Vector3<f64> = around.iter().map(|&t| surface.mesh.area_vector(t)).sum();
    let inward = -normal.try_normalize(0.0)?;
    let spokes =
        surface.corners.neighbours(vertex).map(|u| (surface.mesh.vertices[u as usize] - place).norm());
    let edge = spokes.fold(0.0, f64::max);
    let mut best = None;
    let mut radius = 2.0 * edge;
    while 0.0 < radius && radius < grid.diagonal() {
        let centre = place + inward * radius;
        if grid.clearance(&centre) < (1.0 - NEARER) * radius - NOISE * edge {
            break;
        }
        best = Some((centre, radius));
        radius *= GROWTH;
    }
    best
}

/// Root mean square distance of points from a sphere, in its radii.
pub fn deviation(points: &[Point3<f64>], (centre, radius): &Sphere) -> f64 {
    let squares = points.iter().map(|p| ((p - centre).norm() / radius - 1.0).powi(2));
    (squares.sum::<f64>() / points.len() as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use std::f64::consts::{FRAC_PI_2, PI};

    use super::*;
    use crate::centerline::test_surfaces::{closed_surface, revolved};

    /// The vertex farthest along z, where all tests have their tip.
    fn top(surface: &Surface) -> u32 {
        let z = |v: &u32| surface.mesh.vertices[*v as usize].z;
        (0..surface.mesh.vertices.len() as u32).max_by(|a, b| z(a).total_cmp(&z(b))).unwrap()
    }

    /// Places on the axis from a joint to the sphere.
    fn way(joint: f64) -> [(Point3<f64>, f64); 3] {
        [joint, 0.0, 0.9].map(|z| (Point3::new(0.0, 0.0, z), 0.5))
    }

    fn sac_at_top(surface: &Surface, way: &[(Point3<f64>, f64)]) -> Option<Bulge> {
        let grid = TriangleGrid::new(surface);
        Dome::around(&grid, top(surface))?.as_sac(&grid, way)
    }

    /// A tube of radius `neck` along z up to z = 0, and a sphere of radius 1 on it.
    fn pedunculated(neck: f64) -> Surface {
        let rise = (1.0 - neck * neck).sqrt();
        let tube = (0..=40).map(|i| (neck, -4.0 + 0.1 * f64::from(i)));
        let from = neck.asin();
        let dome = (1..40).map(|i| {
            let angle = from + (PI - from) * f64::from(i) / 40.0;
            (angle.sin(), rise - angle.cos())
        });
        let profile: Vec<(f64, f64)> =
            [(0.0, -4.0)].into_iter().chain(tube).chain(dome).chain([(0.0, rise + 1.0)]).collect();
        closed_surface(&revolved(&profile, 48))
    }

    #[test]
    fn a_sac_is_found_from_its_tip_with_its_neck() {
        let surface = pedunculated(0.5);
        let bulge = sac_at_top(&surface, &way(-0.5)).unwrap();
        let rise = 0.75_f64.sqrt();
        assert!((bulge.centre - Point3::new(0.0, 0.0, rise)).norm() < 0.02, "{bulge:?}");
        assert!((bulge.radius - 1.0).abs() < 0.02, "{bulge:?}");
        let neck = bulge.neck.unwrap();
        assert!(
            (neck.direction + Vector3::z()).norm() < 1e-3 && (neck.stalk - 0.5).abs() < 0.03,
            "{bulge:?}"
        );
        // A stalk that bends, and a long one, have sections of their own.
        let bent = [Point3::new(0.4, 0.0, -0.5), Point3::new(0.0, 0.0, 0.0)].map(|place| (place, 0.5));
        assert_eq!(sac_at_top(&surface, &bent), None);
        assert_eq!(sac_at_top(&surface, &way(-2.5)), None);
    }

    /// The sphere through a cap that is all but flat has no bounds: all of a fine surface lay near it.
    #[test]
    fn a_flat_cap_has_no_dome() {
        let tube = (0..=60).map(|i| (1.0, 0.1 * f64::from(i)));
        let bowed = |rho: f64| 6.0 + 1e-3 * (1.0 - rho * rho);
        let cap = (1..20).map(|i| 1.0 - 0.05 * f64::from(i)).map(|rho| (rho, bowed(rho)));
        let profile: Vec<(f64, f64)> =
            [(0.0, 0.0)].into_iter().chain(tube).chain(cap).chain([(0.0, bowed(0.0))]).collect();
        let surface = closed_surface(&revolved(&profile, 48));
        let grid = TriangleGrid::new(&surface);
        let first = touching(&grid, top(&surface)).unwrap();
        assert!(first.1 < 1.2, "{first:?}");
        let on = DomeWall::around(&surface, &[surface.corners.outgoing(top(&surface)) / 3], &first);
        let through = sphere_through(&on.points(&surface), |_| 1.0).unwrap();
        assert!(through.1 > 100.0, "{through:?}");
        assert!(Dome::around(&grid, top(&surface)).is_none());
    }

    /// A ball of radius 1 on two legs along z, the upper one short and closed.
    #[test]
    fn a_short_leg_is_an_opening_and_a_bleb_is_none() {
        for (leg, openings) in [(3.0, 2), (1.3, 1)] {
            let at = |angle: f64| (angle.sin(), angle.cos());
            let from = 0.4_f64.asin();
            let ball = (0..=40).map(|i| at(PI - from - (PI - 2.0 * from) * f64::from(i) / 40.0));
            let lower = (0..30).map(|i| (0.4, -4.0 + 0.1 * f64::from(i)));
            let rise = at(from).1;
            let upper = (1..=20).map(|i| (0.4, rise + (leg - rise) * f64::from(i) / 20.0));
            let profile: Vec<(f64, f64)> =
                [(0.0, -4.0)].into_iter().chain(lower).chain(ball).chain(upper).chain([(0.0, leg)]).collect();
            let surface = closed_surface(&revolved(&profile, 48));
            let side = (0..surface.mesh.vertices.len() as u32)
                .max_by(|&a, &b| {
                    let x = |v: u32| surface.mesh.vertices[v as usize].x;
                    x(a).total_cmp(&x(b))
                })
                .unwrap();
            let dome = Dome::around(&TriangleGrid::new(&surface), side).unwrap();
            let joint = Point3::new(0.0, 0.0, -2.0);
            let neck = dome.neck_toward(&joint).unwrap();
            assert!(
                (neck.direction + Vector3::z()).norm() < 0.01 && (neck.stalk - 0.4).abs() < 0.05,
                "{neck:?}"
            );
            let within = dome.neck_toward(&Point3::origin());
            assert_eq!(within.is_some(), openings == 1, "{leg}");
        }
    }

    #[test]
    fn the_round_end_of_a_vessel_is_no_sac() {
        // Even, and wider toward its end by a tenth of its radius a radius.
        for widens in [0.0, 0.1] {
            let tube = (0..=60).map(|i| (1.0 - widens * 0.1 * f64::from(60 - i), 0.1 * f64::from(i)));
            let dome = (1..30).map(|i| {
                let angle = FRAC_PI_2 * f64::from(i) / 30.0;
                (angle.cos(), 6.0 + angle.sin())
            });
            let profile: Vec<(f64, f64)> =
                [(0.0, 0.0)].into_iter().chain(tube).chain(dome).chain([(0.0, 7.0)]).collect();
            let surface = closed_surface(&revolved(&profile, 48));
            let way = [4.5, 6.0].map(|z| (Point3::new(0.0, 0.0, z), 1.0));
            assert_eq!(sac_at_top(&surface, &way), None, "{widens}");
        }
    }
}
