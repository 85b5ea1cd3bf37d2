//! Results as other programs read them: the Khronos validator, three.js, the gltf crate and
//! the schema.
#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

#[path = "common/gltf_checker.rs"]
mod gltf_checker;

use nalgebra::Point3;
use rosaline::centerline::{
    Branch, Centeredness, Centerline, Extraction, Homotopy, Node, NodeKind, Parameters, Quality,
    SurfaceSummary,
};
use rosaline::mesh::Units;
use rosaline::mesh::format::{Limits, read_polylines};
use rosaline::output::{
    NodeRecord, OutputError, OutputFormat, ResultDocument, Source, read_json, write, write_glb,
};

/// A helix that forks into two straight branches, moved by `shift` and scaled by `scale`.
fn document(shift: [f64; 3], scale: f64) -> ResultDocument {
    let place = |point: [f64; 3]| Point3::from(std::array::from_fn(|axis| shift[axis] + scale * point[axis]));
    let helix: Vec<_> = (0..=200)
        .map(|step| {
            let angle = f64::from(step) * 0.05;
            place([7.0 * angle.cos(), 7.0 * angle.sin(), 1.5 * angle])
        })
        .collect();
    let ends = [place([20.0, 3.0, 25.0]), place([-11.0, 16.1, 25.3])];
    let node = |kind, position, radius: f64| Node {
        kind,
        position,
        radius: scale * radius,
        equivalent_radius: scale * 1.25 * radius,
    };
    let nodes = vec![
        node(NodeKind::End, helix[0], 2.0),
        node(NodeKind::Junction, helix[200], 1.7),
        node(NodeKind::End, ends[0], 1.1),
        node(NodeKind::End, ends[1], 0.9),
    ];
    let straight = |to: usize| {
        let radii = vec![nodes[1].radius, nodes[to].radius];
        wide(Branch::new(1, to, vec![nodes[1].position, nodes[to].position], radii))
    };
    let taper = |step: usize| scale * (2.0 - 0.3 * step as f64 / 200.0);
    let radii = (0..helix.len()).map(taper).collect();
    let branches = vec![wide(Branch::new(0, 1, helix, radii)), straight(2), straight(3)];
    let extraction = Extraction {
        centerline: Centerline { nodes, branches },
        surface: SurfaceSummary { components: 1, diagonal: 50.0 * scale, ..SurfaceSummary::default() },
        quality: Some(Quality {
            homotopy: Homotopy { components: 1, genus: 0, parts: 1, loops: 0, equal: true },
            inside: 0.75,
            centeredness: Centeredness { mean: Some(0.125), max: None, sections: 7 },
            coverage: 0.5,
            thinness: true,
        }),
        warnings: Vec::new(),
    };
    let source = Source { name: None, format: "stl", sha256: &"0".repeat(64), units: Units::Millimetres };
    ResultDocument::new(&extraction, &source, &Parameters::default())
}

/// With sections a quarter wider than the spheres in them.
fn wide(branch: Branch) -> Branch {
    let equivalent_radii = branch.radii.iter().map(|radius| 1.25 * radius).collect();
    Branch { equivalent_radii, ..branch }
}

/// The frames that the checks go through: at the origin, in metres, and far away.
fn documents() -> [(&'static str, ResultDocument); 3] {
    [
        ("near", document([0.0; 3], 1.0)),
        ("metres", document([0.1, -0.2, 0.3], 1e-3)),
        ("far", document([1e5, -3e5, 4321.125], 1.0)),
    ]
}

fn as_points(value: &serde_json::Value) -> [f64; 3] {
    std::array::from_fn(|axis| value[axis].as_f64().unwrap())
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    (Point3::from(a) - Point3::from(b)).norm()
}

#[test]
fn the_khronos_validator_finds_nothing_and_three_js_loads_the_same_line() {
    let Some(script) = gltf_checker::checker() else { return };
    let folder = tempfile::tempdir().unwrap();
    let (mut files, mut expected) = (Vec::new(), Vec::new());
    for (name, document) in documents() {
        for format in [OutputFormat::Glb, OutputFormat::Gltf] {
            let path = folder.path().join(format!("{name}.{}", format.extension()));
            std::fs::write(&path, write(&document, format).unwrap()).unwrap();
            files.push(path);
            expected.push(document.clone());
        }
    }
    let reports = gltf_checker::checked(&script, &files);
    for (report, document) in reports.iter().zip(&expected) {
        let lines = report["three"]["lines"].as_array().unwrap();
        assert_eq!(lines.len(), document.branches.len());
        let nodes = &report["three"]["extras"][0]["nodes"];
        let nodes: Vec<NodeRecord> = serde_json::from_value(nodes.clone()).unwrap();
        assert_eq!(nodes, document.nodes);
        for (line, branch) in lines.iter().zip(&document.branches) {
            assert_eq!(line["extras"]["id"], branch.id);
            assert_eq!(line["points"], branch.points.len());
            let tolerance = 1e-6 * document.source.diagonal;
            for (end, index) in [("first", 0), ("last", branch.points.len() - 1)] {
                let off = distance(as_points(&line[end]), branch.points[index]);
                assert!(off < tolerance, "{} branch {} {end}: {off}", report["file"], branch.id);
            }
            for (radius, known) in line["radii"].as_array().unwrap().iter().zip(&branch.radii) {
                assert_eq!(radius.as_f64().unwrap() as f32, *known as f32);
            }
        }
    }
}

/// The one buffer: a GLB's binary chunk, or the `data:` URI of a .gltf.
fn buffer(root: &gltf::Gltf) -> Vec<u8> {
    use base64::Engine as _;
    match root.buffers().next().unwrap().source() {
        gltf::buffer::Source::Bin => root.blob.clone().unwrap(),
        gltf::buffer::Source::Uri(uri) => {
            let text = uri.strip_prefix("data:application/octet-stream;base64,").unwrap();
            base64::engine::general_purpose::STANDARD.decode(text).unwrap()
        }
    }
}

#[test]
fn the_gltf_crate_reads_every_point_and_radius_back() {
    for (name, document) in documents() {
        for format in [OutputFormat::Glb, OutputFormat::Gltf] {
            let bytes = write(&document, format).unwrap();
            let root = gltf::Gltf::from_slice(&bytes).unwrap();
            let buffer = buffer(&root);
            let node = root.nodes().next().unwrap();
            let (offset, ..) = node.transform().decomposed();
            assert_eq!(offset == [0.0; 3], name != "far", "{name}: an offset only where it is needed");
            let mesh = node.mesh().unwrap();
            assert_eq!(mesh.primitives().len(), document.branches.len());
            for (primitive, branch) in mesh.primitives().zip(&document.branches) {
                assert_eq!(primitive.mode(), gltf::mesh::Mode::LineStrip);
                let reader = primitive.reader(|_| Some(&buffer));
                let points: Vec<_> = reader.read_positions().unwrap().collect();
                assert_eq!(points.len(), branch.points.len());
                for (point, known) in points.iter().zip(&branch.points) {
                    let place = std::array::from_fn(|axis| f64::from(point[axis]) + f64::from(offset[axis]));
                    assert!(distance(place, *known) < 1e-6 * document.source.diagonal, "{name}");
                }
                let kinds = [("RADIUS", &branch.radii), ("EQUIVALENT_RADIUS", &branch.equivalent_radii)];
                for (name, known) in kinds {
                    let radii = primitive.get(&gltf::Semantic::Extras(name.to_owned())).unwrap();
                    let radii = gltf::accessor::Iter::<f32>::new(radii, |_| Some(&buffer)).unwrap();
                    let known: Vec<_> = known.iter().map(|&radius| radius as f32).collect();
                    assert_eq!(radii.collect::<Vec<_>>(), known);
                }
            }
        }
    }
}

#[test]
fn equal_documents_give_equal_bytes() {
    for format in OutputFormat::ALL {
        let first = write(&document([1.0, 2.0, 3.0], 1.0), format).unwrap();
        let second = write(&document([1.0, 2.0, 3.0], 1.0), format).unwrap();
        assert_eq!(first, second, "{format:?}");
    }
}

#[test]
fn vtp_has_every_branch_to_the_last_digit() {
    for (name, document) in documents() {
        let bytes = write(&document, OutputFormat::Vtp).unwrap();
        let found = read_polylines(&bytes, &Limits::default()).unwrap();
        assert_eq!(found.lines.len(), document.branches.len(), "{name}");
        for (line, branch) in found.lines.iter().zip(&document.branches) {
            let points: Vec<[f64; 3]> = line.iter().map(|&point| found.points[point].coords.into()).collect();
            let radii: Vec<f64> = line.iter().map(|&point| found.radii[point]).collect();
            assert_eq!((&points, &radii), (&branch.points, &branch.radii), "{name} branch {}", branch.id);
        }
        let text = String::from_utf8(bytes).unwrap();
        for (array, values) in [("FromNode", "0 1 1"), ("ToNode", "1 2 3"), ("offsets", "201 203 205")] {
            assert!(text.contains(&format!("Name=\"{array}\" format=\"ascii\">{values}<")), "{array}");
        }
    }
    let mut spheres = document([0.0; 3], 1e-30);
    spheres.branches.iter_mut().for_each(|branch| branch.equivalent_radii.clear());
    let text = String::from_utf8(write(&spheres, OutputFormat::Vtp).unwrap()).unwrap();
    let array =
        |name: &str| text.split(&format!("\"{name}\" format=\"ascii\">")).nth(1).unwrap().split('<').next();
    assert_eq!(array("EquivalentRadius"), array("MaximumInscribedSphereRadius"));
    assert!(array("Length").unwrap().contains("e-29"), "{:?}", array("Length"));
}

#[test]
fn json_reads_back_to_the_same_document() {
    for (name, document) in documents() {
        let bytes = write(&document, OutputFormat::Json).unwrap();
        assert_eq!(read_json(&bytes).unwrap(), document, "{name}");
    }
}

#[test]
fn json_obeys_the_schema_that_the_service_publishes() {
    use utoipa::PartialSchema as _;
    let mut parts = Vec::new();
    <ResultDocument as utoipa::ToSchema>::schemas(&mut parts);
    let schemas: serde_json::Map<_, _> =
        parts.into_iter().map(|(name, schema)| (name, serde_json::to_value(schema).unwrap())).collect();
    let mut root = serde_json::to_value(ResultDocument::schema()).unwrap();
    root["components"] = serde_json::json!({ "schemas": schemas });
    let validator = jsonschema::validator_for(&root).unwrap();
    let mut value: serde_json::Value =
        serde_json::from_slice(&write(&document([0.0; 3], 1.0), OutputFormat::Json).unwrap()).unwrap();
    let problems: Vec<_> = validator.iter_errors(&value).map(|error| error.to_string()).collect();
    assert!(problems.is_empty(), "{problems:?}");
    value["branches"][0]["points"][5] = serde_json::json!([1.0, 2.0]);
    assert!(!validator.is_valid(&value), "a point of two numbers");
}

#[test]
fn a_line_that_gltf_cannot_hold_is_refused_with_a_reason() {
    let error = write_glb(&document([0.0; 3], 1e38)).unwrap_err();
    assert!(matches!(error, OutputError::TooLarge { .. }), "{error}");
    let mut empty = document([0.0; 3], 1.0);
    empty.branches.clear();
    assert!(matches!(write_glb(&empty), Err(OutputError::Empty)));
    let mut broken = document([0.0; 3], 1.0);
    broken.branches[0].points[3][1] = f64::INFINITY;
    assert!(matches!(write_glb(&broken), Err(OutputError::NotFinite { .. })));
}

#[test]
fn the_quality_stands_in_every_format() {
    let (_, document) = &documents()[0];
    let json: serde_json::Value =
        serde_json::from_slice(&write(document, OutputFormat::Json).unwrap()).unwrap();
    assert_eq!(
        json["quality"],
        serde_json::json!({
            "homotopy": {"components": 1, "genus": 0, "parts": 1, "loops": 0, "equal": true},
            "inside": 0.75,
            "centeredness": {"mean": 0.125, "max": null, "sections": 7},
            "coverage": 0.5,
            "thinness": true,
        })
    );
    let gltf: serde_json::Value =
        serde_json::from_slice(&write(document, OutputFormat::Gltf).unwrap()).unwrap();
    assert_eq!(gltf["nodes"][0]["extras"]["quality"], json["quality"]);
}
