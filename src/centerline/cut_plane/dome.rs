//! The dome of a sac: how much of a sphere its wall covers, and where it leaves it.
//!
//! Level sets tell a sac only where the front came to it from its neck. Its wall tells it from any side: the sphere that
//! touches the wall at the tip is fitted to all of it that lies in one piece around the tip. A vessel's round end
//! and what of the vessel lies near its sphere cover less than three quarters of it, a sac all but its neck.

use std::f64::consts::PI;

use nalgebra::{Point3, Vector3};
use rustc_hash::FxHashSet;

use crate::mesh::preparation::Surface;

use crate::centerline::cut_plane::bulges::sphere_through;
use crate::centerline::segmentation::track::Bulge;
use crate::centerline::triangle_grid::TriangleGrid;

type Sphere = (Point3<f64>, f64);

/// The sphere through the wall around a tip, and that wall.
pub struct Dome {
    sphere: Sphere,
    wall: DomeWall,
}

impl Dome {
    /// `None` where no sphere fits the wall. O(rounds x triangles of the dome + vertices within its radius).
    pub fn around(grid: &TriangleGrid<'_>, tip: u32) -> Option<Self> {
        const ROUNDS: usize = 6;
        let surface = grid.surface();
        let mut sphere = touching(grid, tip)?;
        let mut wall = DomeWall::around(surface, tip, &sphere);
        for _ in 0..ROUNDS {
            sphere = sphere_through(&wall.points(surface), |_| 1.0)?;
            let before = std::mem::replace(&mut wall, DomeWall::around(surface, tip, &sphere));
            if before.triangles == wall.triangles {
                break;
            }
        }
        Some(Self { sphere, wall })
    }

    /// The sac that the dome is; `None` where it is no sphere, or where a vessel of its own leads to it, long or bent: `way`
    /// are the centres and radii of its level sets, from the joint on.
    pub fn as_sac(&self, surface: &Surface, way: &[(Point3<f64>, f64)]) -> Option<Bulge> {
        /// Least share of the sphere that is wall: a vessel's round end and what of the vessel lies near its sphere fill up
        /// to 0.74, of one that widens to its end by a tenth of its radius a radius 0.76, a bulb of 1.3 of them 0.82.
        const SHARE: f64 = 0.83;
        /// The longest way from the joint to the dome that shows no sections of its own, in radii of the neck.
        const STALK: f64 = 4.0;
        /// Level sets up to so many radii of the neck go around its stalk, and are no farther than so many from its axis: no
        /// line runs straight through a bent one.
        const WIDE: f64 = 1.3;
        const BENT: f64 = 0.7;
        let share = self.share(surface);
        if share < SHARE || !self.is_round(surface) {
            return None;
        }
        let (centre, radius) = self.sphere;
        let cosine = (2.0 * share - 1.0).min(1.0);
        let neck = radius * (1.0 - cosine * cosine).sqrt();
        let joint = way.first()?.0 - centre;
        let outside = way.iter().take_while(|(place, _)| (place - centre).norm() > radius).count();
        let stalk = &way[..outside];
        let along: f64 = stalk.windows(2).map(|pair| (pair[1].0 - pair[0].0).norm()).sum();
        let is_short = along.max(joint.norm() - radius * cosine) <= STALK * neck;
        let axis = self.wall.neck(surface);
        let aside = |(place, _): &(Point3<f64>, f64)| (place - centre).cross(&axis).norm();
        let mut around = stalk.iter().filter(|ring| ring.1 < WIDE * neck);
        let is_straight = around.all(|ring| aside(ring) < BENT * neck);
        (is_short && is_straight && self.leads_to(&axis, &joint)).then_some(Bulge {
            centre,
            radius,
            neck: axis,
        })
    }

    /// Unit direction through the neck of a dome that is no whole sphere, as of a sac that is drawn out; `None` where it is
    /// too little of one to show a neck that leads to the `joint`.
    pub fn neck_toward(&self, surface: &Surface, joint: &Point3<f64>) -> Option<Vector3<f64>> {
        /// Least share of the sphere that is wall.
        const SHARE: f64 = 0.6;
        let is_dome = self.share(surface) >= SHARE && self.is_round(surface);
        let neck = self.wall.neck(surface);
        (is_dome && self.leads_to(&neck, &(joint - self.sphere.0))).then_some(neck)
    }

    /// Whether a neck opens toward its joint, which lies at `joint` from the centre, and not into a stalk that bends away.
    /// Where that lies in the sac, as a front has climbed it, it says nothing.
    fn leads_to(&self, axis: &Vector3<f64>, joint: &Vector3<f64>) -> bool {
        /// Least cosine between both.
        const TOWARD: f64 = 0.7;
        joint.norm() < self.sphere.1 || axis.dot(joint) >= TOWARD * joint.norm()
    }

    fn share(&self, surface: &Surface) -> f64 {
        self.wall.share(surface, &self.sphere.0)
    }

    /// Whether its wall lies on the sphere.
    fn is_round(&self, surface: &Surface) -> bool {
        /// Largest deviation (root mean square), in radii.
        const DEVIATION: f64 = 0.05;
        deviation(&self.wall.points(surface), &self.sphere) <= DEVIATION
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

/// The wall near a sphere, in one piece around a tip.
struct DomeWall {
    triangles: Vec<u32>,
}

impl DomeWall {
    /// Floods the wall from `tip` as far as it is on the sphere. O(its triangles).
    fn around(surface: &Surface, tip: u32, (centre, radius): &Sphere) -> Self {
        /// How far off the sphere its wall may be, in radii.
        const SHELL: f64 = 0.08;
        let on = |t: u32| {
            let corners = surface.mesh.triangles[t as usize].map(|v| surface.mesh.vertices[v as usize]);
            corners.iter().all(|p| ((p - centre).norm() / radius - 1.0).abs() < SHELL)
        };
        let mut triangles: Vec<u32> = surface.corners.star(tip).map(|h| h / 3).filter(|&t| on(t)).collect();
        let mut seen: FxHashSet<u32> = triangles.iter().copied().collect();
        let mut next = 0;
        while let Some(&t) = triangles.get(next) {
            next += 1;
            for h in 3 * t..3 * t + 3 {
                let beside = surface.corners.opposite(h) / 3;
                if !seen.contains(&beside) && on(beside) {
                    seen.insert(beside);
                    triangles.push(beside);
                }
            }
        }
        triangles.sort_unstable();
        Self { triangles }
    }

    fn points(&self, surface: &Surface) -> Vec<Point3<f64>> {
        let mut all: Vec<u32> =
            self.triangles.iter().flat_map(|&t| surface.mesh.triangles[t as usize]).collect();
        all.sort_unstable();
        all.dedup();
        all.into_iter().map(|v| surface.mesh.vertices[v as usize]).collect()
    }

    /// Share of the solid angle around `centre` that it fills (van Oosterom and Strackee 1983).
    fn share(&self, surface: &Surface, centre: &Point3<f64>) -> f64 {
        let angle = |&t: &u32| {
            let [a, b, c] =
                surface.mesh.triangles[t as usize].map(|v| surface.mesh.vertices[v as usize] - centre);
            let (x, y, z) = (a.norm(), b.norm(), c.norm());
            let below = x * y * z + a.dot(&b) * z + b.dot(&c) * x + c.dot(&a) * y;
            2.0 * a.dot(&b.cross(&c)).atan2(below)
        };
        self.triangles.iter().map(angle).sum::<f64>() / (4.0 * PI)
    }

    /// Unit direction through its border, whose area vector closes that of the wall; zero where it has none.
    fn neck(&self, surface: &Surface) -> Vector3<f64> {
        /// Least area of the border against the wall's: what is less is rounding.
        const LEAST: f64 = 1e-6;
        let areas = self.triangles.iter().map(|&t| surface.mesh.area_vector(t));
        let (sum, all) =
            areas.fold((Vector3::zeros(), 0.0), |(sum, all), area| (sum + area, all + area.norm()));
        (-sum).try_normalize(LEAST * all).unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_2;

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
        Dome::around(&TriangleGrid::new(surface), top(surface))?.as_sac(surface, way)
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
        assert!((bulge.neck + Vector3::z()).norm() < 1e-3, "{bulge:?}");
        // A stalk that bends, and a long one, have sections of their own.
        let bent = [Point3::new(0.4, 0.0, -0.5), Point3::new(0.0, 0.0, 0.0)].map(|place| (place, 0.5));
        assert_eq!(sac_at_top(&surface, &bent), None);
        assert_eq!(sac_at_top(&surface, &way(-2.5)), None);
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
