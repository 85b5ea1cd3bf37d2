//! glTF 2.0 (ISO/IEC 12113): one `LINE_STRIP` primitive a branch, with its radii.
//!
//! One node holds one mesh; each branch is a primitive of it with the attributes `POSITION`,
//! `_RADIUS` (inscribed) and `_EQUIVALENT_RADIUS` (one float a point each) and, in `extras`, its `id`, `from`, `to` and `length`.
//! The node's `extras` hold the schema, the unit, the graph's nodes in full precision and the quality.
//!
//! Positions are in the input's own unit and frame, not in glTF's metres, so that the line lies
//! inside the input mesh when both are loaded. They are 32-bit floats. Where the input lies so
//! far from the origin that this would cost more than a millionth of its size, the positions
//! are relative to the node's `translation`, which such a float holds exactly.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use serde_json::{Value, json};

use super::json::check_finite;
use super::{BranchRecord, OutputError, ResultDocument};

/// Distance from the origin, in sizes of the line, past which positions get an offset: a 32-bit
/// float has 24 bits, so that beyond it its step is a millionth of the size.
const FAR: f64 = 16.0;

/// Componenttype FLOAT, target ARRAY_BUFFER, mode LINE_STRIP (glTF 2.0, 3.6.2.2, 5.11.5, 5.24.4).
const FLOAT: u32 = 5126;
const ARRAY_BUFFER: u32 = 34962;
const LINE_STRIP: u32 = 3;

/// Writes binary glTF: a header, a JSON chunk and a binary chunk (glTF 2.0, 4.4).
///
/// # Errors
/// [`OutputError::NotFinite`], [`OutputError::Empty`], [`OutputError::TooLarge`] and
/// [`OutputError::TooLong`].
pub fn write_glb(document: &ResultDocument) -> Result<Vec<u8>, OutputError> {
    let (mut root, buffer) = scene(document)?;
    root["buffers"] = json!([{ "byteLength": buffer.len() }]);
    let mut text = serde_json::to_vec(&root)?;
    text.resize(text.len().next_multiple_of(4), b' ');
    let total = 12 + 8 + text.len() + 8 + buffer.len();
    let length = |bytes: usize| u32::try_from(bytes).map_err(|_| OutputError::TooLong { bytes: total });
    let mut bytes = Vec::with_capacity(total);
    bytes.extend_from_slice(b"glTF");
    bytes.extend_from_slice(&2_u32.to_le_bytes());
    bytes.extend_from_slice(&length(total)?.to_le_bytes());
    bytes.extend_from_slice(&length(text.len())?.to_le_bytes());
    bytes.extend_from_slice(b"JSON");
    bytes.extend_from_slice(&text);
    // Floats only, so that the chunk ends on four bytes without padding.
    bytes.extend_from_slice(&length(buffer.len())?.to_le_bytes());
    bytes.extend_from_slice(b"BIN\0");
    bytes.extend_from_slice(&buffer);
    Ok(bytes)
}

/// Writes glTF as one JSON file, with its buffer in a `data:` URI.
///
/// # Errors
/// As [`write_glb`].
pub fn write_gltf(document: &ResultDocument) -> Result<Vec<u8>, OutputError> {
    let (mut root, buffer) = scene(document)?;
    let uri = format!("data:application/octet-stream;base64,{}", STANDARD.encode(&buffer));
    root["buffers"] = json!([{ "byteLength": buffer.len(), "uri": uri }]);
    let mut text = serde_json::to_vec(&root)?;
    text.push(b'\n');
    Ok(text)
}

/// The glTF root without its `buffers`, and the one buffer: all positions, then all radii
/// of either kind.
fn scene(document: &ResultDocument) -> Result<(Value, Vec<u8>), OutputError> {
    check_finite(document)?;
    if document.branches.is_empty() {
        return Err(OutputError::Empty);
    }
    let offset = offset(document);
    let mut accessors = Vec::new();
    let mut positions = Vec::new();
    let mut radii = [Vec::new(), Vec::new()];
    let mut primitives = Vec::new();
    for branch in &document.branches {
        let points = relative(branch, offset)?;
        let first = accessors.len();
        accessors.push(accessor(0, positions.len(), "VEC3", &points));
        positions.extend(points.iter().flatten().flat_map(|value| value.to_le_bytes()));
        for (kind, of_kind) in [&branch.radii, &branch.equivalent_radii].into_iter().enumerate() {
            let values = narrow_radii(branch, of_kind)?;
            accessors.push(accessor(1 + kind, radii[kind].len(), "SCALAR", &values));
            radii[kind].extend(values.iter().flatten().flat_map(|value| value.to_le_bytes()));
        }
        primitives.push(json!({
            "mode": LINE_STRIP,
            "material": 0,
            "attributes": { "POSITION": first, "_RADIUS": first + 1, "_EQUIVALENT_RADIUS": first + 2 },
            "extras": { "id": branch.id, "from": branch.from, "to": branch.to, "length": branch.length },
        }));
    }
    let view = |start: usize, length: usize, stride: u32| {
        json!({ "buffer": 0, "byteOffset": start, "byteLength": length, "byteStride": stride,
                "target": ARRAY_BUFFER })
    };
    let lengths = [positions.len(), radii[0].len(), radii[1].len()];
    let root = json!({
        "asset": { "version": "2.0", "generator": concat!("Rosaline ", env!("CARGO_PKG_VERSION")) },
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [root_node(document, offset)],
        "meshes": [{ "name": "centerline", "primitives": primitives }],
        "materials": [{ "name": "centerline", "pbrMetallicRoughness":
            { "baseColorFactor": [0.8, 0.05, 0.1, 1.0], "metallicFactor": 0.0 } }],
        "accessors": accessors,
        "bufferViews": [
            view(0, lengths[0], 12),
            view(lengths[0], lengths[1], 4),
            view(lengths[0] + lengths[1], lengths[2], 4),
        ],
    });
    radii.iter_mut().for_each(|of_kind| positions.append(of_kind));
    Ok((root, positions))
}

/// The one node, which places the mesh and keeps what a line strip cannot.
fn root_node(document: &ResultDocument, offset: [f32; 3]) -> Value {
    let mut node = json!({
        "name": "centerline",
        "mesh": 0,
        "extras": { "schema": document.schema, "units": document.units, "nodes": document.nodes },
    });
    if let Some(quality) = document.quality {
        node["extras"]["quality"] = json!(quality);
    }
    if offset != [0.0; 3] {
        node["translation"] = json!(offset.map(f64::from));
    }
    node
}

/// Where the positions are counted from: the origin, or the middle of a line that is far from it.
fn offset(document: &ResultDocument) -> [f32; 3] {
    let mut low = [f64::INFINITY; 3];
    let mut high = [f64::NEG_INFINITY; 3];
    for point in document.branches.iter().flat_map(|branch| &branch.points) {
        for axis in 0..3 {
            low[axis] = low[axis].min(point[axis]);
            high[axis] = high[axis].max(point[axis]);
        }
    }
    let size = (0..3).map(|axis| high[axis] - low[axis]).fold(0.0, f64::max);
    let reach = low.iter().chain(&high).fold(0.0, |reach: f64, value| reach.max(value.abs()));
    if reach <= FAR * size {
        return [0.0; 3];
    }
    // Rounded here, so that a reader that keeps the translation in 32 bits loses nothing.
    std::array::from_fn(|axis| (0.5 * (low[axis] + high[axis])) as f32)
}

fn relative(branch: &BranchRecord, offset: [f32; 3]) -> Result<Vec<[f32; 3]>, OutputError> {
    let near = |point: &[f64; 3]| std::array::from_fn(|axis| (point[axis] - f64::from(offset[axis])) as f32);
    let points: Vec<[f32; 3]> = branch.points.iter().map(near).collect();
    check_range(branch, points.iter().flatten())?;
    Ok(points)
}

fn narrow_radii(branch: &BranchRecord, radii: &[f64]) -> Result<Vec<[f32; 1]>, OutputError> {
    let radii: Vec<[f32; 1]> = radii.iter().map(|&radius| [radius as f32]).collect();
    check_range(branch, radii.iter().flatten())?;
    Ok(radii)
}

fn check_range<'a>(
    branch: &BranchRecord,
    values: impl IntoIterator<Item = &'a f32>,
) -> Result<(), OutputError> {
    if values.into_iter().all(|value| value.is_finite()) {
        return Ok(());
    }
    Err(OutputError::TooLarge { place: format!("branch {}", branch.id) })
}

/// An accessor over `values` at `start` in a buffer view; its bounds are those of the floats
/// as they are stored, which a validator compares bit by bit.
fn accessor<const N: usize>(view: usize, start: usize, shape: &str, values: &[[f32; N]]) -> Value {
    let bound = |pick: fn(f32, f32) -> f32| -> Vec<f64> {
        let fold = |axis: usize| values.iter().map(|value| value[axis]).reduce(pick);
        (0..N).filter_map(fold).map(f64::from).collect()
    };
    json!({
        "bufferView": view,
        "byteOffset": start,
        "componentType": FLOAT,
        "count": values.len(),
        "type": shape,
        "min": bound(f32::min),
        "max": bound(f32::max),
    })
}
