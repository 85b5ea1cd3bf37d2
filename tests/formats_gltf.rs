//! glTF and GLB: nodes, primitives, accessors, and what is refused.
#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

use nalgebra::Point3;
use rosaline::mesh::TriangleMesh;
use rosaline::mesh::format::{Format, Hint, Limits, ReadError, ReadErrorKind, read};
use serde_json::{Value, json};

/// A GLB of a model and the bytes of its first buffer.
fn glb(model: &Value, buffer: &[u8]) -> Vec<u8> {
    let mut json = model.to_string().into_bytes();
    json.resize(json.len().next_multiple_of(4), b' ');
    let mut bin = buffer.to_vec();
    bin.resize(bin.len().next_multiple_of(4), 0);
    let mut bytes = b"glTF\x02\0\0\0".to_vec();
    bytes.extend((28 + json.len() as u32 + bin.len() as u32).to_le_bytes());
    bytes.extend((json.len() as u32).to_le_bytes());
    bytes.extend(b"JSON");
    bytes.extend(json);
    bytes.extend((bin.len() as u32).to_le_bytes());
    bytes.extend(b"BIN\0");
    bytes.extend(bin);
    bytes
}

fn read_glb(model: &Value, buffer: &[u8]) -> Result<TriangleMesh, ReadError> {
    let (mesh, format) = read(&glb(model, buffer), Hint::default(), &Limits::default())?;
    assert_eq!(format, Format::Glb);
    Ok(mesh)
}

/// Corners of a tetrahedron as floats (48 bytes), then a strip over them as bytes (8 bytes).
fn buffer() -> Vec<u8> {
    let corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0f32]];
    let mut bytes: Vec<u8> = corners.iter().flatten().flat_map(|number| number.to_le_bytes()).collect();
    bytes.extend([0, 2, 1, 3, 0, 2, 0, 0]);
    bytes
}

/// Two accessors on [`buffer`]: positions, and the strip's indices.
fn model(primitive: Value, nodes: Value) -> Value {
    json!({
        "asset": {"version": "2.0"},
        "buffers": [{"byteLength": 56}],
        "bufferViews": [
            {"buffer": 0, "byteLength": 48},
            {"buffer": 0, "byteOffset": 48, "byteLength": 8},
        ],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "type": "VEC3", "count": 4},
            {"bufferView": 1, "componentType": 5121, "type": "SCALAR", "count": 6},
        ],
        "meshes": [{"primitives": [primitive]}],
        "nodes": nodes,
    })
}

fn strip() -> Value {
    json!({"attributes": {"POSITION": 0}, "indices": 1, "mode": 5})
}

/// Volume inside, positive when the triangles are wound to face outwards.
fn volume(mesh: &TriangleMesh) -> f64 {
    let corner = |vertex: u32| mesh.vertices[vertex as usize].coords;
    let six = mesh.triangles.iter().map(|&[a, b, c]| corner(a).dot(&corner(b).cross(&corner(c))));
    six.sum::<f64>() / 6.0
}

#[test]
fn strips_fans_and_lists_make_the_same_tetrahedron() {
    let mesh = read_glb(&model(strip(), json!([{"mesh": 0}])), &buffer()).unwrap();
    assert_eq!(mesh.triangles, [[0, 2, 1], [2, 3, 1], [1, 3, 0], [3, 2, 0]]);
    assert!((volume(&mesh) - 1.0 / 6.0).abs() < 1e-12);

    let mut fan = model(json!({"attributes": {"POSITION": 0}, "indices": 1, "mode": 6}), json!([]));
    let mut bytes = buffer();
    bytes[48..53].copy_from_slice(&[3, 0, 1, 2, 0]);
    fan["accessors"][1]["count"] = json!(5);
    let mesh = read_glb(&fan, &bytes).unwrap();
    assert_eq!(mesh.triangles, [[0, 1, 3], [1, 2, 3], [2, 0, 3]]);

    // Without indices the corners follow one another; a last incomplete triangle is left out.
    let list = model(json!({"attributes": {"POSITION": 0}}), json!([{"mesh": 0}]));
    assert_eq!(read_glb(&list, &bytes).unwrap().triangles, [[0, 1, 2]]);
}

#[test]
fn nodes_place_their_meshes_and_mirrors_keep_the_outside_outside() {
    let half = std::f64::consts::FRAC_1_SQRT_2;
    let nodes = json!([
        {"children": [1, 2], "translation": [10, 0, 0], "scale": [2, 2, 2]},
        {"mesh": 0, "rotation": [0, 0, half, half]},
        {"mesh": 0, "matrix": [-1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 5, 1]},
        {"mesh": 0},
    ]);
    let mut scene = model(strip(), nodes);
    scene["scenes"] = json!([{"nodes": [3]}, {"nodes": [0]}]);
    scene["scene"] = json!(1);
    let mesh = read_glb(&scene, &buffer()).unwrap();
    assert_eq!(mesh.vertices.len(), 8);
    assert_eq!(mesh.triangles.len(), 8);
    assert!((volume(&mesh) - 16.0 / 6.0).abs() < 1e-9, "{}", volume(&mesh));
    // The first child: a quarter turn about z, doubled, moved.
    let expected = [[10.0, 0.0, 0.0], [10.0, 2.0, 0.0], [8.0, 0.0, 0.0], [10.0, 0.0, 2.0]].map(Point3::from);
    for (found, expected) in mesh.vertices.iter().zip(expected) {
        assert!((found - expected).norm() < 1e-6, "{found} {expected}");
    }
    // The second: mirrored in x, lifted by 5, doubled, moved.
    assert_eq!(mesh.vertices[5], Point3::new(8.0, 0.0, 10.0));

    scene["scene"] = json!(0);
    assert_eq!(read_glb(&scene, &buffer()).unwrap().vertices.len(), 4);
    // Without scenes the roots count: nodes 0 and 3.
    scene["scenes"] = json!([]);
    scene["scene"] = Value::Null;
    assert_eq!(read_glb(&scene, &buffer()).unwrap().vertices.len(), 12);
}

#[test]
fn interleaved_quantised_and_sparse_positions_are_read() {
    let truth = read_glb(&model(strip(), json!([])), &buffer()).unwrap();
    // Positions as normalised bytes, each element padded to 4 bytes.
    let mut quantised = model(strip(), json!([]));
    quantised["extensionsRequired"] = json!(["KHR_mesh_quantization"]);
    quantised["bufferViews"][0] = json!({"buffer": 0, "byteLength": 16, "byteStride": 4});
    quantised["accessors"][0]["componentType"] = json!(5120);
    quantised["accessors"][0]["normalized"] = json!(true);
    let mut bytes = vec![0; 56];
    (bytes[4], bytes[9], bytes[14]) = (127, 127, 127);
    bytes[48..].copy_from_slice(&buffer()[48..]);
    assert_eq!(read_glb(&quantised, &bytes).unwrap(), truth);

    // All zero but three elements, replaced out of the float buffer.
    let mut sparse = model(strip(), json!([]));
    sparse["bufferViews"]
        .as_array_mut()
        .unwrap()
        .push(json!({"buffer": 0, "byteOffset": 56, "byteLength": 6}));
    sparse["buffers"][0]["byteLength"] = json!(62);
    sparse["accessors"][0] = json!({
        "componentType": 5126, "type": "VEC3", "count": 4,
        "sparse": {
            "count": 3,
            "indices": {"bufferView": 2, "componentType": 5123},
            "values": {"bufferView": 0, "byteOffset": 12},
        },
    });
    let mut bytes = buffer();
    bytes.extend([1, 0, 2, 0, 3, 0]);
    assert_eq!(read_glb(&sparse, &bytes).unwrap(), truth);
    bytes[60] = 4;
    assert_eq!(read_glb(&sparse, &bytes).unwrap_err().code(), "malformed");
}

#[test]
fn data_uris_are_read_and_other_files_are_not() {
    use base64::Engine;
    let mut model = model(strip(), json!([]));
    let encoded = base64::engine::general_purpose::STANDARD.encode(buffer());
    model["buffers"][0]["uri"] = json!(format!("data:application/octet-stream;base64,{encoded}"));
    let text = format!("\u{feff} {model:#}");
    let (mesh, format) = read(text.as_bytes(), Hint::default(), &Limits::default()).unwrap();
    assert_eq!(format, Format::Gltf);
    assert_eq!(mesh.triangles.len(), 4);
    for uri in ["mesh.bin", "file:///etc/passwd", "http://127.0.0.1/mesh.bin"] {
        model["buffers"][0]["uri"] = json!(uri);
        let error = read(model.to_string().as_bytes(), Hint::default(), &Limits::default()).unwrap_err();
        assert_eq!((error.kind(), error.code()), (ReadErrorKind::Unprocessable, "unsupported-feature"));
        assert!(!error.to_string().contains(uri), "{error}");
    }
    model["buffers"][0]["uri"] = json!("data:application/octet-stream;base64,AAA*");
    let error = read(model.to_string().as_bytes(), Hint::default(), &Limits::default()).unwrap_err();
    assert_eq!(error.code(), "malformed");
}

/// A change to the model at a JSON pointer, and the code of the error that follows.
fn broken() -> Vec<(&'static str, Value, &'static str)> {
    vec![
        ("/accessors/0/count", json!(5), "malformed"),
        ("/accessors/0/count", json!(u64::MAX), "malformed"),
        ("/accessors/0/byteOffset", json!(u64::MAX), "malformed"),
        ("/accessors/0/bufferView", json!(7), "malformed"),
        ("/accessors/0/bufferView", Value::Null, "malformed"),
        ("/accessors/0/type", json!("VEC2"), "malformed"),
        ("/accessors/0/type", json!("VEC9"), "malformed"),
        ("/accessors/0/componentType", json!(5125), "malformed"),
        ("/accessors/1/componentType", json!(5126), "malformed"),
        ("/accessors/1/componentType", json!(1), "malformed"),
        ("/bufferViews/0/byteOffset", json!(u64::MAX), "malformed"),
        ("/bufferViews/0/byteLength", json!(1_000_000_000), "malformed"),
        ("/bufferViews/0/buffer", json!(3), "malformed"),
        ("/buffers/0/byteLength", json!(1_000_000_000), "truncated"),
        ("/meshes/0/primitives/0/indices", json!(2), "malformed"),
        ("/meshes/0/primitives/0/attributes", json!({}), "malformed"),
        ("/meshes/0/primitives/0/mode", json!(9), "malformed"),
        ("/meshes/0/primitives/0/mode", json!(3), "no-polygons"),
        ("/meshes", json!([]), "malformed"),
        ("/nodes", json!([{"mesh": 0, "children": [9]}]), "malformed"),
        ("/nodes", json!([{"mesh": 0}, {"children": [0, 0]}]), "malformed"),
        (
            "/nodes",
            json!([{"mesh": 0, "scale": [1e30, 1e30, 1e30], "translation": [0, 0, 1e39]}]),
            "malformed",
        ),
        ("/nodes", json!([{"mesh": 0, "rotation": [0, 0, 0, 0]}]), "non-finite-coordinate"),
        ("/asset", Value::Null, "malformed"),
        ("/accessors", json!({"a": 1}), "malformed"),
    ]
}

#[test]
fn what_is_broken_is_a_typed_error() {
    for (pointer, change, code) in broken() {
        let mut model = model(strip(), json!([{"mesh": 0}]));
        let (parent, key) = pointer.rsplit_once('/').unwrap();
        match model.pointer_mut(pointer) {
            Some(place) => *place = change.clone(),
            None => model.pointer_mut(parent).unwrap()[key] = change.clone(),
        }
        if change.is_null() && pointer.ends_with("bufferView") {
            model["accessors"][0]["count"] = json!(1_000_000);
        }
        let error = read_glb(&model, &buffer()).unwrap_err();
        assert_eq!(error.code(), code, "{pointer} {change}: {error}");
    }
    let mut cycle = model(strip(), json!([{"children": [1]}, {"children": [0], "mesh": 0}]));
    assert_eq!(read_glb(&cycle, &buffer()).unwrap_err().code(), "no-polygons");
    cycle["scenes"] = json!([{"nodes": [0]}]);
    assert_eq!(read_glb(&cycle, &buffer()).unwrap_err().code(), "malformed");
    let mut far = buffer();
    far[48] = 4;
    let error = read_glb(&model(strip(), json!([])), &far).unwrap_err();
    assert_eq!(error.code(), "index-out-of-range");
    for extension in ["KHR_draco_mesh_compression", "EXT_meshopt_compression", "EXT_unheard_of"] {
        let mut model = model(strip(), json!([]));
        model["extensionsRequired"] = json!([extension]);
        let error = read_glb(&model, &buffer()).unwrap_err();
        assert_eq!(error.code(), "unsupported-feature", "{extension}");
    }
}

#[test]
fn shared_meshes_cannot_multiply_without_end() {
    let nodes: Vec<Value> = (0..3000).map(|_| json!({"mesh": 0})).collect();
    let mut many = model(strip(), json!(nodes));
    let points = json!({"attributes": {}, "mode": 0});
    many["meshes"][0]["primitives"] = json!(vec![points; 3000]);
    assert_eq!(read_glb(&many, &buffer()).unwrap_err().kind(), ReadErrorKind::TooLarge);
    let limits = Limits { triangles: 3000, ..Limits::default() };
    let many = glb(&model(strip(), json!(nodes)), &buffer());
    let error = read(&many, Hint::default(), &limits).unwrap_err();
    assert_eq!(error.kind(), ReadErrorKind::TooLarge);
    let limits = Limits { decoded_bytes: 100_000, ..Limits::default() };
    assert_eq!(read(&many, Hint::default(), &limits).unwrap_err().kind(), ReadErrorKind::TooLarge);
}

#[test]
fn a_glb_cut_anywhere_is_truncated() {
    let whole = glb(&model(strip(), json!([{"mesh": 0}])), &buffer());
    for length in 4..whole.len() {
        let error = read(&whole[..length], Hint::default(), &Limits::default()).unwrap_err();
        assert_eq!(error.code(), "truncated", "{length}");
    }
}
