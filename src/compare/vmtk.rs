//! Centerlines as VMTK, 3D Slicer and SimVascular write them: a VTP with a polyline from the source to every tip.
//!
//! The lines repeat what they share. Each stretch is taken once; points at the same place are one node. The file
//! names neither its unit nor the surface's diagonal.

use std::collections::{HashMap, HashSet};

use nalgebra::Point3;

use crate::mesh::format::{Limits, Polylines, read_polylines};

use super::line::DisjointSets;
use super::{CompareError, Line, Polyline};

/// Whether `bytes` are XML, which no other line is.
pub(super) fn is_xml(bytes: &[u8]) -> bool {
    bytes.trim_ascii_start().starts_with(b"<")
}

pub(super) fn read(bytes: &[u8]) -> Result<Line, CompareError> {
    let found = read_polylines(bytes, &Limits::default())?;
    let places = places(&found.points);
    let mut stretches = Stretches { seen: HashSet::new(), polylines: Vec::new() };
    for line in &found.lines {
        stretches.add(line, &found, &places);
    }
    let (tips, loops, parts) = topology(&stretches.seen, found.points.len());
    Ok(Line { polylines: stretches.polylines, tips, loops, parts, units: None, diagonal: None })
}

/// For each point the number of the first at the same place.
fn places(points: &[Point3<f64>]) -> Vec<usize> {
    let mut first = HashMap::new();
    // Adding 0 makes -0 and 0 one.
    let key = |point: &Point3<f64>| [point.x, point.y, point.z].map(|value| (value + 0.0).to_bits());
    points.iter().enumerate().map(|(number, point)| *first.entry(key(point)).or_insert(number)).collect()
}

/// The stretches that no earlier line had.
struct Stretches {
    /// Edges between places, the lesser number first.
    seen: HashSet<(usize, usize)>,
    polylines: Vec<Polyline>,
}

impl Stretches {
    fn add(&mut self, line: &[usize], of: &Polylines, places: &[usize]) {
        let mut fresh: Vec<usize> = Vec::new();
        for pair in line.windows(2) {
            let (a, b) = (places[pair[0]], places[pair[1]]);
            if a == b {
                continue;
            }
            if !self.seen.insert((a.min(b), a.max(b))) {
                self.finish(std::mem::take(&mut fresh), of);
                continue;
            }
            if fresh.is_empty() {
                fresh.push(a);
            }
            fresh.push(b);
        }
        self.finish(fresh, of);
    }

    fn finish(&mut self, stretch: Vec<usize>, of: &Polylines) {
        if stretch.len() > 1 {
            let points = stretch.iter().map(|&point| of.points[point]).collect();
            let radii = stretch.iter().map(|&point| of.radii[point]).collect();
            self.polylines.push(Polyline { points, radii });
        }
    }
}

/// Tips, loops and parts of the graph of `edges` between `count` places.
fn topology(edges: &HashSet<(usize, usize)>, count: usize) -> (usize, usize, usize) {
    let mut degrees = vec![0_usize; count];
    let mut parts = DisjointSets::new(count);
    for &(a, b) in edges {
        degrees[a] += 1;
        degrees[b] += 1;
        parts.join(a, b);
    }
    let used = degrees.iter().filter(|&&degree| degree > 0).count();
    let parts = parts.count() - (count - used);
    let tips = degrees.iter().filter(|&&degree| degree == 1).count();
    (tips, edges.len() + parts - used, parts)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two lines from one source: they share the first stretch and end in two tips.
    const FORK: &str = r#"<VTKFile type="PolyData"><PolyData>
        <Piece NumberOfPoints="6" NumberOfLines="2" NumberOfPolys="0">
        <PointData>
            <DataArray type="String" Name="notes" format="ascii">of no use here</DataArray>
            <DataArray type="Float64" Name="MaximumInscribedSphereRadius" format="ascii">2 2 1 2 2 1.5</DataArray>
        </PointData>
        <Points><DataArray type="Float64" NumberOfComponents="3" format="ascii">
            0 0 0  5 0 0  10 5 0  0 0 0  5 0 0  10 -5 0</DataArray></Points>
        <Lines>
            <DataArray type="Int64" Name="connectivity" format="ascii">0 1 2 3 4 5</DataArray>
            <DataArray type="Int64" Name="offsets" format="ascii">3 6</DataArray>
        </Lines></Piece></PolyData></VTKFile>"#;

    #[test]
    fn what_lines_share_is_taken_once() {
        let line = Line::read(FORK.as_bytes()).unwrap();
        assert_eq!((line.tips, line.loops, line.parts), (3, 0, 1));
        assert_eq!((line.units, line.diagonal), (None, None));
        let shapes: Vec<_> = line.polylines.iter().map(|one| (one.points.len(), one.radii.clone())).collect();
        assert_eq!(shapes, [(3, vec![2.0, 2.0, 1.0]), (2, vec![2.0, 1.5])]);
    }

    #[test]
    fn lines_that_cannot_be_compared_say_why() {
        let says =
            |from: &str, to: &str| Line::read(FORK.replace(from, to).as_bytes()).unwrap_err().to_string();
        let error = says("MaximumInscribedSphereRadius", "Width");
        assert!(error.contains("no MaximumInscribedSphereRadius"), "{error}");
        assert!(says("0 1 2 3 4 5", "0 1 2 3 4 6").contains("a point that is not there"));
        assert!(says("2 2 1 2 2 1.5", "2 2 1 2 2 -1").contains("a radius is no positive number"));
        assert!(says("NumberOfLines=\"2\"", "NumberOfLines=\"0\"").contains("no lines"));
        assert!(says("2 2 1 2 2 1.5", "2 2 1 2 2").contains("data array"));
    }

    #[test]
    fn a_line_that_comes_back_is_a_loop() {
        let ring = FORK.replace("0 1 2 3 4 5", "0 1 2 2 5 1").replace("10 -5 0", "9 9 9");
        let line = Line::read(ring.as_bytes()).unwrap();
        assert_eq!((line.tips, line.loops, line.parts), (1, 1, 1));
    }
}
