//! Looks at results.

use nalgebra::Point3;
use rosaline::centerline::{
    Centerline, Control, ExtractError, Extraction, NodeKind, Parameters, Preset, extract,
};
use rosaline::compare::{Line, Polyline, measure};
use rosaline::mesh::TriangleMesh;

pub fn extracted(mesh: &TriangleMesh, preset: Preset) -> Result<Extraction, ExtractError> {
    extract(mesh, &Parameters::of(preset), &Control::silent())
}

/// The result of the preset `default`.
pub fn line_of(mesh: &TriangleMesh) -> Extraction {
    extracted(mesh, Preset::Default).unwrap()
}

/// Connected parts and independent loops.
pub fn parts_and_loops(line: &Centerline) -> (usize, usize) {
    let mut part: Vec<usize> = (0..line.nodes.len()).collect();
    for branch in &line.branches {
        let (a, b) = (part[branch.from], part[branch.to]);
        part.iter_mut().filter(|other| **other == b).for_each(|other| *other = a);
    }
    part.sort_unstable();
    part.dedup();
    (part.len(), line.branches.len() + part.len() - line.nodes.len())
}

/// Ends and junctions.
pub fn ends_and_junctions(line: &Centerline) -> (usize, usize) {
    let ends = line.nodes.iter().filter(|node| node.kind == NodeKind::End).count();
    (ends, line.nodes.len() - ends)
}

/// Every point of the branches with its radius.
pub fn points(line: &Centerline) -> impl Iterator<Item = (&Point3<f64>, f64)> {
    line.branches.iter().flat_map(|branch| branch.points.iter().zip(branch.radii.iter().copied()))
}

/// The greatest distance of either line from the other, at samples every 1/2000 of the diagonal.
pub fn apart(a: &Extraction, b: &Extraction) -> f64 {
    let line = |extraction: &Extraction| Line {
        polylines: extraction
            .centerline
            .branches
            .iter()
            .map(|branch| Polyline { points: branch.points.clone(), radii: branch.radii.clone() })
            .collect(),
        tips: 0,
        loops: 0,
        parts: 0,
        units: Some("mm".to_owned()),
        diagonal: Some(a.surface.diagonal),
    };
    let measures = measure(&line(a), &line(b)).unwrap();
    measures.o_max.absolute.max(measures.missed.absolute)
}

/// The greatest distance between points of the same place in two results; `None` when they differ in anything
/// but coordinates and radii.
pub fn moved(a: &Extraction, b: &Extraction) -> Option<f64> {
    let (a, b) = (&a.centerline, &b.centerline);
    if (a.nodes.len(), a.branches.len()) != (b.nodes.len(), b.branches.len()) {
        return None;
    }
    let mut most = 0.0_f64;
    for (x, y) in a.nodes.iter().zip(&b.nodes) {
        if x.kind != y.kind {
            return None;
        }
        most = most.max((x.position - y.position).norm()).max((x.radius - y.radius).abs());
    }
    for (x, y) in a.branches.iter().zip(&b.branches) {
        if (x.from, x.to, x.points.len()) != (y.from, y.to, y.points.len()) {
            return None;
        }
        for place in 0..x.points.len() {
            let step = (x.points[place] - y.points[place]).norm();
            most = most.max(step).max((x.radii[place] - y.radii[place]).abs());
        }
    }
    Some(most)
}
