//! What every fuzz target does with its bytes; a panic is a find. The suite's `fuzz_corpus` test does the same with
//! the kept corpus.
#![allow(dead_code, reason = "each target is a program of its own and uses one of these")]

mod surface;

use axum::http::Uri;
use nalgebra::Point3;
use rosaline::centerline::{Centerline, Control, Extraction, extract as extract_centerline};
use rosaline::http::Limits as ServiceLimits;
use rosaline::http::parameters::{Asked, json_pairs, query_pairs};
use rosaline::mesh::format::{Format, Hint, Limits, ReadError, read as read_mesh, read_as};
use rosaline::mesh::{TriangleMesh, Units};
use rosaline::output::{OutputFormat, ResultDocument, Source, read_json, write};

pub use surface::Case;

/// Bytes of an error's text at most: it says what is wrong and quotes no file.
const MOST_TEXT: usize = 1000;

/// Far more than an input of some kilobytes has, far less than would hide a reader that trusts a declared count.
const LIMITS: Limits =
    Limits { vertices: 1 << 20, triangles: 1 << 21, decoded_bytes: 64 << 20, expansion: 50 };

/// The reader of one format, whatever the bytes look like.
pub fn reader(format: Format, bytes: &[u8]) {
    check(read_as(bytes, format, &LIMITS));
}

/// The reader that the content, or else the first byte as a hint, chooses.
pub fn read(bytes: &[u8]) {
    const HINTS: [&str; 8] = ["stl", "obj", ".PLY", "gltf", "glb", "vtp", "vtk", "off"];
    let Some((&hint, rest)) = bytes.split_first() else { return };
    let hint = Hint { extension: HINTS.get(usize::from(hint)).copied(), content_type: None };
    check(read_mesh(rest, hint, &LIMITS).map(|(mesh, _)| mesh));
}

/// What every reader promises.
fn check(result: Result<TriangleMesh, ReadError>) {
    match result {
        Ok(mesh) => {
            assert!(!mesh.triangles.is_empty());
            assert!(mesh.triangles.iter().flatten().all(|&index| (index as usize) < mesh.vertices.len()));
            assert!(mesh.vertices.iter().all(|vertex| vertex.iter().all(|number| number.is_finite())));
        }
        Err(error) => {
            let text = error.to_string();
            assert!(text.len() < MOST_TEXT && text.is_ascii(), "{text}");
        }
    }
}

/// A form's part `parameters` (first byte even) or a query.
pub fn parameters(bytes: &[u8]) {
    let limits = ServiceLimits::default();
    let Some((&kind, rest)) = bytes.split_first() else { return };
    let pairs = if kind % 2 == 0 {
        json_pairs(rest)
    } else {
        let Some(uri) =
            str::from_utf8(rest).ok().and_then(|text| format!("/v1/jobs?{text}").parse::<Uri>().ok())
        else {
            return;
        };
        query_pairs(&uri)
    };
    match pairs.and_then(|pairs| Asked::from_pairs(&pairs, &limits)) {
        Ok(asked) => {
            assert!(asked.parameters.iter().all(|(_, value)| value.is_finite()));
            assert!(asked.client_reference.is_none_or(|text| text.chars().count() <= limits.reference_chars));
            let name = asked.name.as_ref().map_or("a", |name| name.expose());
            assert!(!name.is_empty() && !name.contains(['/', '\\']));
        }
        Err(problem) => {
            let text = serde_json::to_string(&problem).unwrap();
            assert!(text.len() < 4 * MOST_TEXT, "{text}");
        }
    }
}

/// The whole way from a surface to the bytes of every result format.
pub fn extract(bytes: &[u8]) {
    let Some(Case { mesh, parameters }) = Case::decode(bytes) else { return };
    match extract_centerline(&mesh, &parameters, &Control::silent()) {
        Ok(extraction) => {
            check_extraction(&extraction);
            let source =
                Source { name: None, format: "stl", sha256: &"0".repeat(64), units: Units::Millimetres };
            let document = ResultDocument::new(&extraction, &source, &parameters);
            for format in OutputFormat::ALL {
                let written = write(&document, format);
                // Numbers beyond single precision are no glTF.
                if format == OutputFormat::Json {
                    assert_eq!(read_json(&written.unwrap()).unwrap(), document);
                }
            }
        }
        Err(error) => assert!(error.to_string().len() < MOST_TEXT),
    }
}

/// Checks the graph and that every number in it is one.
fn check_extraction(extraction: &Extraction) {
    let Centerline { nodes, branches } = &extraction.centerline;
    let point_is_finite = |point: &Point3<f64>| point.iter().all(|number| number.is_finite());
    assert!(nodes.iter().all(|node| point_is_finite(&node.position) && node.radius.is_finite()));
    for branch in branches {
        assert!(branch.from < nodes.len() && branch.to < nodes.len() && branch.points.len() >= 2);
        assert!(branch.points.len() == branch.radii.len());
        assert!(branch.points.len() == branch.equivalent_radii.len());
        let mut radii = branch.radii.iter().chain(&branch.equivalent_radii);
        assert!(
            branch.points.iter().all(point_is_finite)
                && radii.all(|&radius| (0.0..f64::INFINITY).contains(&radius))
        );
        assert!(branch.points[0] == nodes[branch.from].position);
        assert!(branch.points[branch.points.len() - 1] == nodes[branch.to].position);
    }
}
