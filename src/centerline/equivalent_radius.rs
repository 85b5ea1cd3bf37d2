//! Radius of the circle that has the section's area, at every point of the line, whichever preset made it.
//!
//! The line's own sections (see [`super::own_sections`]) tell the ratio of this radius to the inscribed one.
//! Between two of them the ratio is interpolated by the way along the branch; before the first and after the last,
//! at ends, in joints and in sacs without a section, that of the nearest stands; a branch without any has the
//! ratio 1. A node takes that of its widest branch.

use nalgebra::{Point2, SMatrix, SVector, Vector2};

use crate::mesh::preparation::Surface;

use crate::centerline::component::ComponentGraph;
use crate::centerline::cut_plane::section::Section;
use crate::centerline::graph::Branch;
use crate::centerline::own_sections::OwnSection;

/// Terms of the fit: mean, two for each harmonic up to the fourth, slope.
const TERMS: usize = 10;

/// Radius of the circle of the wall's area around a section, in the input's unit.
///
/// A mesh's vertices lie on the wall and its facets cut inside it, so that a section's polygon has too little area.
/// The area is half the integral of the squared distance of the wall: that is fitted to the vertices around the
/// section, each weighted with its share of the angle. `radius` is the polygon's, for sections of few vertices.
pub fn wall_radius(surface: &Surface, cut: &Section, centre: &Point2<f64>, radius: f64) -> f64 {
    /// Facets make no vessel thinner than this share; past it the vertices are not those of this wall.
    const MOST: f64 = 0.2;
    let vertices = cut.vertices(surface);
    let place = |v: u32| {
        let p = surface.mesh.vertices[v as usize];
        let along = (p - cut.frame.origin).dot(&cut.frame.t) / radius;
        let arm = (cut.frame.flat(&p) - centre) / radius;
        // Far along a long triangle the wall may be anything; far off it is another branch's.
        let near = along.abs() < 0.75 && (0.2..4.0).contains(&arm.norm());
        near.then(|| (arm.y.atan2(arm.x), arm, along))
    };
    let mut wall: Vec<(f64, Vector2<f64>, f64)> = vertices.into_iter().filter_map(place).collect();
    if wall.len() < 2 * TERMS {
        return radius;
    }
    wall.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut normal = SMatrix::<f64, TERMS, TERMS>::zeros();
    let mut right = SVector::<f64, TERMS>::zeros();
    for (k, &(_, arm, along)) in wall.iter().enumerate() {
        let before = wall[(k + wall.len() - 1) % wall.len()].0;
        let after = wall[(k + 1) % wall.len()].0;
        let share = (after - before).rem_euclid(std::f64::consts::TAU);
        let mut row = SVector::<f64, TERMS>::zeros();
        row[0] = 1.0;
        let unit = arm.normalize();
        let mut turned = Vector2::x();
        for harmonic in 1..=4 {
            turned =
                Vector2::new(turned.x * unit.x - turned.y * unit.y, turned.x * unit.y + turned.y * unit.x);
            (row[2 * harmonic - 1], row[2 * harmonic]) = (turned.x, turned.y);
        }
        row[TERMS - 1] = along;
        // Its lower half is all that is read.
        normal.syger(share, &row, &row, 1.0);
        right += row * (share * arm.norm_squared());
    }
    // Holds what the vertices leave open (a single ring says nothing of the slope).
    for term in 1..TERMS {
        normal[(term, term)] += 1e-4 * normal[(0, 0)];
    }
    let square = normal.cholesky().map_or(1.0, |cholesky| cholesky.solve(&right)[0]);
    radius * square.max(0.0).sqrt().clamp(1.0 - MOST, 1.0 + MOST)
}

/// Sets the equivalent radii of a component's line. `sections` are its own, in the order of the line.
pub fn settle(graph: &mut ComponentGraph, sections: &[OwnSection]) {
    for (number, branch) in graph.branches.iter_mut().enumerate() {
        let first = sections.partition_point(|section| section.branch < number);
        let last = sections.partition_point(|section| section.branch <= number);
        branch.equivalent_radii = along_branch(branch, &sections[first..last]);
    }
    for (number, node) in graph.nodes.iter_mut().enumerate() {
        let of = |branch: &Branch, at: usize| (branch.radii[at], branch.equivalent_radii[at]);
        // The nodes' own points all have the node's radius: the widest branch is seen one point on.
        let incident = graph.branches.iter().flat_map(|branch| {
            let last = branch.points.len() - 1;
            let start = (branch.from == number).then(|| (of(branch, 1), of(branch, 0)));
            let end = (branch.to == number).then(|| (of(branch, last - 1), of(branch, last)));
            start.into_iter().chain(end)
        });
        let widest = incident.max_by(|a, b| a.0.0.total_cmp(&b.0.0));
        node.equivalent_radius = widest.map_or(node.radius, |(_, (_, equivalent))| equivalent);
    }
    for branch in &mut graph.branches {
        let last = branch.points.len() - 1;
        branch.equivalent_radii[0] = graph.nodes[branch.from].equivalent_radius;
        branch.equivalent_radii[last] = graph.nodes[branch.to].equivalent_radius;
    }
}

/// The equivalent radii of a branch from the ratios at its sections.
///
/// The inscribed sphere's disc lies in the section, so that no ratio is below 1: noise alone, or an inscribed
/// radius averaged over neighbours that are wider, makes one.
fn along_branch(branch: &Branch, sections: &[OwnSection]) -> Vec<f64> {
    let way = branch.ways();
    let known: Vec<(f64, f64)> = sections
        .iter()
        .map(|section| (way[section.place], (section.wall_radius / branch.radii[section.place]).max(1.0)))
        // Where no sphere fits there is no ratio.
        .filter(|(_, ratio)| ratio.is_finite())
        .collect();
    let ratio = |at: f64| {
        let after = known.partition_point(|&(place, _)| place < at);
        match (after.checked_sub(1).and_then(|before| known.get(before)), known.get(after)) {
            (Some(&(a, low)), Some(&(b, high))) => low + (high - low) * (at - a) / (b - a),
            (Some(&(_, ratio)), None) | (None, Some(&(_, ratio))) => ratio,
            (None, None) => 1.0,
        }
    };
    branch.radii.iter().zip(&way).map(|(radius, &at)| radius * ratio(at)).collect()
}

#[cfg(test)]
mod tests {
    use crate::centerline::test_surfaces::revolved;
    use crate::centerline::{Control, Extraction, Parameters, Preset, extract};
    use crate::mesh::TriangleMesh;

    /// A straight tube of length 24 with an elliptical section.
    fn elliptic(a: f64, b: f64, sides: usize) -> TriangleMesh {
        let profile: Vec<(f64, f64)> = std::iter::once((0.0, 0.0))
            .chain((0..=160).map(|k| (1.0, 0.15 * f64::from(k))))
            .chain([(0.0, 24.0)])
            .collect();
        let mut mesh = revolved(&profile, sides);
        mesh.vertices.iter_mut().for_each(|point| (point.x, point.y) = (a * point.x, b * point.y));
        mesh
    }

    fn extracted(mesh: &TriangleMesh, preset: Preset) -> Extraction {
        extract(mesh, &Parameters::of(preset), &Control::silent()).unwrap()
    }

    #[test]
    fn an_elliptic_tube_has_both_its_radii() {
        for (a, b, sides) in [(1.0, 1.0, 16), (1.5, 1.0, 32), (2.0, 1.0, 48), (1.2, 1.0, 12)] {
            let line = extracted(&elliptic(a, b, sides), Preset::Default).centerline;
            let branch = &line.branches[0];
            let known = (a * b).sqrt();
            for (k, point) in branch.points.iter().enumerate().filter(|(_, p)| (3.0..21.0).contains(&p.z)) {
                let (inscribed, equivalent) = (branch.radii[k], branch.equivalent_radii[k]);
                assert!((inscribed / b - 1.0).abs() < 0.02, "{a} {b}: inscribed {inscribed} at {point}");
                assert!(
                    (equivalent / known - 1.0).abs() < 0.01,
                    "{a} {b}: {equivalent} at {point}, not {known}"
                );
            }
        }
    }

    #[test]
    fn no_equivalent_radius_is_below_the_inscribed_one_with_either_preset() {
        for preset in [Preset::Default, Preset::Paper] {
            let line = extracted(&elliptic(1.6, 1.0, 32), preset).centerline;
            for branch in &line.branches {
                let pairs = branch.radii.iter().zip(&branch.equivalent_radii);
                assert!(pairs.clone().all(|(inscribed, equivalent)| equivalent >= inscribed));
                assert!(pairs.clone().any(|(inscribed, equivalent)| *equivalent > 1.15 * inscribed));
                assert_eq!(branch.equivalent_radii[0], line.nodes[branch.from].equivalent_radius);
            }
        }
    }
}
