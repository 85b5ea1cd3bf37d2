//! Readers: the shared meshes, one surface as other tools write it, and files that lie.
#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

mod common;

use std::collections::BTreeSet;
use std::f64::consts::PI;
use std::path::Path;

use nalgebra::Point3;
use rosaline::mesh::TriangleMesh;
use rosaline::mesh::format::{Format, Hint, Limits, ReadError, ReadErrorKind, read, read_polylines};

fn read_any(bytes: &[u8]) -> Result<(TriangleMesh, Format), ReadError> {
    read(bytes, Hint::default(), &Limits::default())
}

/// Vertices and triangles of surfaces in `../shared`, welded; 78 of the artery's 7407 polygons are quads.
const SHARED: [(&str, usize, usize); 10] = [
    ("meshes/aorta.vtp", 6468, 12932),
    ("meshes/aortoiliac.vtp", 7319, 14634),
    ("meshes/artery-open.vtp", 3862, 7485),
    ("meshes/aorta-open-ends.stl", 6068, 11887),
    ("meshes/carotid-left.stl", 4615, 9071),
    ("meshes/carotid-left-capped.stl", 4492, 8982),
    ("phantoms/tube.stl", 10886, 21768),
    ("phantoms/bigtree.stl", 93116, 186_228),
    ("phantoms/mixed-stair.stl", 39644, 79284),
    ("phantoms/tree-open.stl", 18565, 36934),
];

#[test]
fn shared_surfaces_have_the_known_size() {
    let Some(shared) = common::shared() else { return };
    for (name, vertices, triangles) in SHARED {
        let (mesh, format) = read_any(&std::fs::read(shared.join(name)).unwrap()).unwrap();
        assert_eq!((mesh.vertices.len(), mesh.triangles.len()), (vertices, triangles), "{name}");
        assert!(name.ends_with(format.name()), "{name}: {format}");
    }
}

#[test]
fn a_file_of_centerlines_has_no_polygons() {
    let Some(shared) = common::shared() else { return };
    let files = [("aorta.vmtk", 409, 2), ("aortoiliac.simvascular", 2354, 6), ("carotid-left.vmtk", 478, 6)];
    for (name, points, count) in files {
        let bytes = std::fs::read(shared.join(format!("meshes/{name}-centerlines.vtp"))).unwrap();
        let error = read_any(&bytes).unwrap_err();
        assert_eq!((error.kind(), error.code()), (ReadErrorKind::Unprocessable, "no-polygons"), "{name}");
        assert!(error.to_string().contains("only lines"), "{error}");
        let lines = read_polylines(&bytes, &Limits::default()).unwrap();
        assert_eq!((lines.points.len(), lines.lines.len()), (points, count), "{name}");
        assert_eq!(lines.radii.len(), points, "{name}");
    }
}

/// The tube of `data/peers/make.py`: 4 rings of 8 vertices, quads between, an octagon at each end.
fn tube() -> TriangleMesh {
    let mut vertices = Vec::new();
    for (ring, radius) in [1.0, 1.25, 1.5, 1.0].into_iter().enumerate() {
        let ring = ring as f64;
        for corner in 0..8 {
            let angle = f64::from(corner) * PI / 4.0;
            let point = [radius * angle.cos() + 0.3 * ring * ring, radius * angle.sin() - 5.0, 2.0 * ring];
            vertices.push(Point3::from(point.map(|coordinate| (8.0 * coordinate).round() / 8.0)));
        }
    }
    let mut triangles = Vec::new();
    for (ring, corner) in (0..3).flat_map(|ring| (0..8).map(move |corner| (ring, corner))) {
        let [a, b] = [8 * ring + corner, 8 * ring + (corner + 1) % 8];
        triangles.extend([[a, b, b + 8], [a, b + 8, a + 8]]);
    }
    triangles.extend((1..7).map(|corner| [7, 7 - corner, 6 - corner]));
    triangles.extend((1..7).map(|corner| [24, 24 + corner, 25 + corner]));
    TriangleMesh { vertices, triangles }
}

/// The triangles by their corners' places, whatever order the file has them in. Panics where a
/// coordinate is no multiple of 1/8, or a triangle is there twice.
fn surface(mesh: &TriangleMesh) -> BTreeSet<[[i64; 3]; 3]> {
    let place = |vertex: u32| {
        mesh.vertices[vertex as usize].coords.map(|coordinate| {
            assert_eq!((coordinate * 8.0).fract(), 0.0);
            (coordinate * 8.0) as i64
        })
    };
    let mut surface = BTreeSet::new();
    for triangle in &mesh.triangles {
        let mut corners = triangle.map(|vertex| place(vertex).into());
        while corners.iter().any(|corner| *corner < corners[0]) {
            corners.rotate_left(1);
        }
        assert!(surface.insert(corners));
    }
    surface
}

#[test]
fn every_variant_that_other_tools_write_reads_to_the_same_surface() {
    let truth = surface(&tube());
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/peers");
    let mut files = 0;
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_str().unwrap();
        let result = read_any(&std::fs::read(&path).unwrap());
        if matches!(name, "make.py" | "meshio-grid.vtk") {
            assert_eq!(result.unwrap_err().kind(), ReadErrorKind::Unsupported);
        } else if name == "lines.vtp" {
            assert_eq!(result.unwrap_err().code(), "no-polygons");
        } else if name.contains("lz4") && !name.starts_with("ascii") {
            let error = result.unwrap_err();
            assert_eq!(error.code(), "unsupported-feature", "{name}");
            assert!(error.to_string().contains("LZ4"), "{error}");
        } else {
            let (mesh, format) = result.unwrap_or_else(|error| panic!("{name}: {error}"));
            assert!(name.ends_with(format.name()), "{name}: {format}");
            assert_eq!(mesh.vertices.len(), 32, "{name}");
            assert_eq!(surface(&mesh), truth, "{name}");
            files += 1;
        }
    }
    assert_eq!(files, 55);
}
