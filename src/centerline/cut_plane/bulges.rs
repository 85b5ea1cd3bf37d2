//! Bulges: sacs that show no section of their own (an aneurysm's dome).
//!
//! Their line runs straight from the joint through the middle of the dome to its far wall.

use nalgebra::{Matrix3, Matrix4, Point3, Unit, Vector3, Vector4};

use crate::mesh::preparation::Surface;

use crate::centerline::cut_plane::dome::{Dome, deviation};
use crate::centerline::segmentation::level_sets::LevelSet;
use crate::centerline::segmentation::track::{Bulge, Neck, SPACING, Sight, Station, Track};
use crate::centerline::triangle_grid::TriangleGrid;

/// Finds the bulge that a leaf is, whatever sections could be cut through it and the vessel together, and draws its line;
/// returns whether it is one. By its wall; where that is no whole sphere, by its level sets.
pub fn round_bulge(grid: &TriangleGrid<'_>, track: &mut Track, tip: u32, tip_first: bool) -> bool {
    let mut way: Vec<(Point3<f64>, f64)> =
        track.rings.iter().map(|ring| (ring.centroid, ring.radius())).collect();
    if tip_first {
        way.reverse();
    }
    let Some(&(joint, base_radius)) = way.first() else { return false };
    let dome = Dome::around(grid, tip);
    let by_wall = dome.as_ref().and_then(|dome| dome.as_sac(grid, &way));
    let under_bleb = || Dome::under(grid, &track.rings, tip)?.as_sac(grid, &way);
    let by_levels = || {
        let (centre, radius) = sphere_of_levels(grid, &track.rings, base_radius)?;
        let neck = dome.as_ref().and_then(|dome| dome.neck_toward(&joint));
        // It is drawn out into its neck: no stalk leads on from it.
        let neck = neck.map(|neck| Neck { stalk: 0.0, ..neck });
        Some(Bulge { neck, ..Bulge::ball(centre, radius) })
    };
    let Some(bulge) = by_wall.or_else(under_bleb).or_else(by_levels) else { return false };
    track.bulge = Some(bulge);
    track.stations = line_through(grid, track, &joint, &bulge.centre, !tip_first);
    true
}

/// The sphere that all level sets of a leaf lie on; `base_radius` is that of the one at its joint.
fn sphere_of_levels(
    grid: &TriangleGrid<'_>,
    rings: &[LevelSet],
    base_radius: f64,
) -> Option<(Point3<f64>, f64)> {
    /// Largest deviation (root mean square) of the wall from its sphere, in radii. Sacs of the phantoms
    /// have up to 0.04, stumps of tubes 0.10 and more.
    const DEVIATION: f64 = 0.06;
    /// Largest distance of the tip from the base's centre, and largest sphere against the base: where it
    /// is much larger, the rings lie flat.
    const HEIGHT: f64 = 2.0;
    const FLAT: f64 = 2.0;
    /// How far from the middle its wall may be, in radii.
    const NEAR: f64 = 1.3;
    let points: Vec<Point3<f64>> = rings.iter().flat_map(|ring| ring.points.iter().copied()).collect();
    let sphere @ (centre, radius) = sphere_through(&points, |_| 1.0)?;
    let (first, last) = (rings.first()?, rings.last()?);
    let height = (first.centroid - last.centroid).norm();
    let is_round = deviation(&points, &sphere) <= DEVIATION && height <= HEIGHT * radius;
    if !is_round || radius > FLAT * base_radius {
        return None;
    }
    // A front covers a sac's sides unevenly: its whole wall counts.
    Some(dome(&grid.vertices_within(&centre, NEAR * radius), sphere))
}

/// Makes a track a small ball that touches the wall at its tip: an end that was asked for on the side of a vessel has
/// no sections, its line runs straight from the joint to the wall.
pub fn at_wall(surface: &Surface, track: &mut Track, tip: u32) {
    let place = surface.mesh.vertices[tip as usize];
    let spokes: Vec<Vector3<f64>> =
        surface.corners.neighbours(tip).map(|v| surface.mesh.vertices[v as usize] - place).collect();
    let radius = spokes.iter().map(Vector3::norm).sum::<f64>() / spokes.len().max(1) as f64;
    let normal: Vector3<f64> = surface.corners.star(tip).map(|h| surface.mesh.area_vector(h / 3)).sum();
    let inward = -normal.try_normalize(0.0).unwrap_or_else(Vector3::zeros);
    track.bulge = Some(Bulge::ball(place + inward * radius, radius));
    track.stations.clear();
}

/// Stations of a bulge, straight from its joint to `end`; in reverse where the joint is the track's end.
///
/// The radius of each is its distance from the nearest vertex. O(stations x cubes of that radius).
pub fn line_through(
    grid: &TriangleGrid<'_>,
    track: &Track,
    joint: &Point3<f64>,
    end: &Point3<f64>,
    joint_first: bool,
) -> Vec<Station> {
    let Some(bulge) = track.bulge else { return track.stations.clone() };
    let step = end - joint;
    let Some(outward) = Unit::try_new(step, 0.0) else { return Vec::new() };
    let count = (step.norm() / (SPACING * bulge.radius)).ceil().clamp(1.0, 64.0) as usize;
    let at = |i: usize| {
        let point = joint + step * (i as f64 / count as f64);
        let tangent = if joint_first { outward } else { -outward };
        let mut station = Station::rough(point, tangent, grid.clearance(&point), track.rings.len() / 2);
        station.sight = Sight::Clean;
        station.weight = Matrix3::identity();
        station
    };
    let mut stations: Vec<Station> = (1..count).map(at).collect();
    if !joint_first {
        stations.reverse();
    }
    stations
}

/// The sphere through most of the points: those of the neck lie off it and are heard ever less (Geman and
/// McClure's weights).
fn dome(points: &[Point3<f64>], first: (Point3<f64>, f64)) -> (Point3<f64>, f64) {
    const ROUNDS: usize = 8;
    /// Deviation (radii) at which a point counts a quarter.
    const USUAL: f64 = 0.02;
    let mut sphere = first;
    for _ in 0..ROUNDS {
        let (centre, radius) = sphere;
        let weight = |p: &Point3<f64>| {
            let off = ((p - centre).norm() / radius - 1.0) / USUAL;
            (1.0 + off * off).powi(-2)
        };
        let Some(next) = sphere_through(points, weight) else { return sphere };
        if next.1 > 1.5 * first.1 || (next.0 - first.0).norm() > 0.5 * first.1 {
            return first;
        }
        sphere = next;
    }
    sphere
}

/// Weighted least squares sphere: centre and radius (algebraic fit, about the points' mean); `None` for fewer than eight
/// points and for those of a plane.
pub fn sphere_through(
    points: &[Point3<f64>],
    weight: impl Fn(&Point3<f64>) -> f64,
) -> Option<(Point3<f64>, f64)> {
    if points.len() < 8 {
        return None;
    }
    let origin = points[0];
    let mean = points.iter().map(|p| p - origin).sum::<Vector3<f64>>() / points.len() as f64;
    let spread = points.iter().map(|p| (p - origin - mean).norm_squared()).sum::<f64>() / points.len() as f64;
    let scale = spread.sqrt();
    let mut normal = Matrix4::zeros();
    let mut right = Vector4::zeros();
    for p in points {
        let d = (p - origin - mean) / scale;
        let row = Vector4::new(2.0 * d.x, 2.0 * d.y, 2.0 * d.z, 1.0);
        let weight = weight(p);
        normal += row * row.transpose() * weight;
        right += row * (d.norm_squared() * weight);
    }
    let solved = normal.try_inverse()? * right;
    let centre = solved.xyz();
    let radius = (solved.w + centre.norm_squared()).max(0.0).sqrt();
    (radius.is_finite() && radius > 0.0).then(|| (origin + mean + centre * scale, radius * scale))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_on_a_dome_give_its_sphere() {
        let on = |i: usize| {
            let (a, z) = (0.7 * i as f64, 0.02 * i as f64);
            let flat = (1.0 - z * z).sqrt();
            Point3::new(5.0 + 2.0 * flat * a.cos(), 2.0 * flat * a.sin(), 2.0 * z)
        };
        let points: Vec<_> = (0..45).map(on).collect();
        let (centre, radius) = sphere_through(&points, |_| 1.0).unwrap();
        assert!((centre - Point3::new(5.0, 0.0, 0.0)).norm() < 1e-9 && (radius - 2.0).abs() < 1e-9);
    }
}
