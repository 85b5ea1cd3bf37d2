//! Known centerlines as polylines `[x, y, z, radius]` in mm, with their topology.

use nalgebra::Point3;
use serde::Deserialize;

use super::line::DisjointSets;
use super::nearest::SegmentTree;
use super::{CompareError, Line, Polyline};

#[derive(Deserialize)]
struct File {
    polylines: Vec<Vec<[f64; 4]>>,
    tips: usize,
    loops: usize,
    l_dia: f64,
}

/// Whether `bytes` are JSON with polylines.
pub(super) fn is_known(bytes: &[u8]) -> bool {
    #[derive(Deserialize)]
    struct Probe {
        #[serde(rename = "polylines")]
        _polylines: serde::de::IgnoredAny,
    }
    serde_json::from_slice::<Probe>(bytes).is_ok()
}

pub(super) fn read(bytes: &[u8]) -> Result<Line, CompareError> {
    let file: File = serde_json::from_slice(bytes)?;
    let polylines: Result<Vec<_>, _> = file.polylines.iter().enumerate().map(polyline).collect();
    let polylines = polylines?;
    Ok(Line {
        parts: parts(&polylines),
        polylines,
        tips: file.tips,
        loops: file.loops,
        units: Some("mm".to_owned()),
        diagonal: Some(file.l_dia),
    })
}

fn polyline((place, points): (usize, &Vec<[f64; 4]>)) -> Result<Polyline, CompareError> {
    if points.len() < 2 {
        return Err(CompareError::TooShort { polyline: place, points: points.len() });
    }
    if !points.iter().flatten().all(|value| value.is_finite()) {
        return Err(CompareError::BadPoint { polyline: place });
    }
    Ok(Polyline {
        points: points.iter().map(|&[x, y, z, _]| Point3::new(x, y, z)).collect(),
        radii: points.iter().map(|&[.., radius]| radius).collect(),
    })
}

/// Connected parts of the lumen: two polylines belong to one where an end of one lies within
/// the other's radius.
fn parts(polylines: &[Polyline]) -> usize {
    let mut sets = DisjointSets::new(polylines.len());
    let trees: Vec<_> = polylines.iter().map(|one| SegmentTree::new(std::slice::from_ref(one))).collect();
    for (place, polyline) in polylines.iter().enumerate() {
        for end in [polyline.points.first(), polyline.points.last()].into_iter().flatten() {
            for (other, tree) in trees.iter().enumerate() {
                let near = tree.as_ref().map(|tree| tree.nearest(end));
                if near.is_some_and(|near| near.distance < near.radius) {
                    sets.join(place, other);
                }
            }
        }
    }
    sets.count()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn polylines_are_read_with_their_topology() {
        let text = br#"{"kind": "fork", "l_dia": 12.5, "tips": 3, "loops": 0, "polylines": [
            [[0, 0, 0, 2], [5, 0, 0, 1.5], [10, 0, 0, 1]],
            [[5, 0.5, 0, 1], [5, 6, 0, 0.5]],
            [[0, 20, 0, 1], [10, 20, 0, 1]]]}"#;
        let line = Line::read(text).unwrap();
        assert_eq!((line.tips, line.loops, line.parts), (3, 0, 2));
        assert_eq!((line.diagonal, line.units.as_deref()), (Some(12.5), Some("mm")));
        assert_eq!(line.polylines[0].radii, [2.0, 1.5, 1.0]);
        assert_eq!(line.polylines[1].points[1], Point3::new(5.0, 6.0, 0.0));
    }

    #[test]
    fn broken_files_are_refused_with_a_reason() {
        let short = br#"{"l_dia": 1, "tips": 2, "loops": 0, "polylines": [[[0, 0, 0, 1]]]}"#;
        assert_eq!(Line::read(short).unwrap_err().to_string(), "polyline 0 has 1 points; a line needs two");
        let three = br#"{"l_dia": 1, "tips": 2, "loops": 0, "polylines": [[[0, 0, 0], [1, 0, 0]]]}"#;
        assert!(matches!(Line::read(three), Err(CompareError::Json(_))));
        assert!(matches!(Line::read(b"{}"), Err(CompareError::Document(_))));
        for (bytes, found) in [
            (&b"glTF\x02\0\0\0"[..], "this is a GLB;"),
            (b"{\"asset\": {\"version\": \"2.0\"}}", "this is a glTF;"),
            (b"solid mesh", "this is neither JSON nor XML;"),
            (b"", "this is empty;"),
        ] {
            let error = Line::read(bytes).unwrap_err().to_string();
            assert!(error.starts_with(found) && error.contains("results/centerline.json"), "{error}");
        }
    }
}
