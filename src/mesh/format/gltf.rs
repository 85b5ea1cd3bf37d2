//! glTF 2.0 and GLB (ISO/IEC 12113:2022): the triangles of every primitive, placed by its node.
//!
//! The crate `gltf` reads the container and the JSON model. Accessors are read here, every access
//! checked: the crate's own readers panic on files that lie about their sizes.

use std::borrow::Cow;
use std::panic::{AssertUnwindSafe, catch_unwind};

use gltf::binary::Glb;
use gltf::json::mesh::{Mode, Primitive, Semantic};
use gltf::json::validation::Checked;
use gltf::json::{Mesh, Root};
use nalgebra::Matrix4;

use super::error::SEND_A_MESH;
use super::gltf_data::Buffers;
use super::gltf_scene::placed_meshes;
use super::surface::{Surface, check_limit};
use super::{Format, Limits, ReadError};
use crate::mesh::TriangleMesh;

/// Bytes of a GLB's header.
const GLB_HEADER: usize = 12;

/// Memory that one JSON object takes at most once it is read; its nodes are the largest.
const OBJECT_BYTES: usize = 1024;

/// Placed in the scene; a surface has a few of them. Bounds the time for nodes that share a mesh.
const MOST_PRIMITIVES: usize = 1_000_000;

/// Required extensions that change neither positions nor triangles, or that are read here.
const HARMLESS: [&str; 8] = [
    "KHR_materials_",
    "KHR_texture_",
    "KHR_lights_",
    "KHR_mesh_quantization",
    "KHR_animation_",
    "KHR_xmp",
    "EXT_texture_",
    "EXT_lights_",
];

pub(super) fn read_json(bytes: &[u8], limits: &Limits) -> Result<TriangleMesh, ReadError> {
    let json = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    let read = guarded(Format::Gltf, || read(Format::Gltf, json, None, limits));
    read.map_err(|error| if is_other_json(json) { OTHER_JSON } else { error })
}

/// JSON is taken for glTF by its first character.
const OTHER_JSON: ReadError =
    ReadError::Unsupported { found: "JSON other than glTF (it has no \"asset\")", advice: SEND_A_MESH };

/// Whether this is whole JSON without what every glTF has (glTF 2.0, section 3.2).
fn is_other_json(json: &[u8]) -> bool {
    #[derive(serde::Deserialize)]
    struct Probe {
        asset: Option<serde::de::IgnoredAny>,
    }
    serde_json::from_slice::<Probe>(json).is_ok_and(|probe| probe.asset.is_none())
}

pub(super) fn read_glb(bytes: &[u8], limits: &Limits) -> Result<TriangleMesh, ReadError> {
    let format = Format::Glb;
    let length = bytes.get(8..GLB_HEADER).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]) as usize);
    match length {
        Some(length) if length < GLB_HEADER => {
            return Err(malformed(format, format!("its header says that it has {length} bytes")));
        }
        Some(length) if length <= bytes.len() => {}
        _ => {
            let detail = match length {
                Some(length) => format!("its header says {length} bytes and it has {}", bytes.len()),
                None => "its header is cut".to_owned(),
            };
            return Err(ReadError::Truncated { format, detail });
        }
    }
    guarded(format, || {
        let broken = |_| malformed(format, "its chunks do not fit together".to_owned());
        let glb = Glb::from_slice(bytes).map_err(broken)?;
        read(format, &glb.json, glb.bin, limits)
    })
}

/// The checks below leave the crate nothing to panic about; should it still, that is the file's fault.
fn guarded(
    format: Format,
    read: impl FnOnce() -> Result<TriangleMesh, ReadError>,
) -> Result<TriangleMesh, ReadError> {
    let broken = |_| Err(malformed(format, "its structure contradicts itself".to_owned()));
    catch_unwind(AssertUnwindSafe(read)).unwrap_or_else(broken)
}

pub(super) fn malformed(format: Format, detail: String) -> ReadError {
    ReadError::Malformed { format, detail }
}

fn read(
    format: Format,
    json: &[u8],
    bin: Option<Cow<'_, [u8]>>,
    limits: &Limits,
) -> Result<TriangleMesh, ReadError> {
    let objects = json.iter().filter(|&&byte| byte == b'{').count();
    check_limit(format, "JSON objects", objects, limits.decoded_bytes / OBJECT_BYTES)?;
    let root = parse(format, json)?;
    check_extensions(format, &root)?;
    let buffers = Buffers::new(format, &root, bin, limits)?;
    let mut surface = Surface::new(format, limits);
    let mut others = false;
    let placed = placed_meshes(format, &root)?;
    let primitives = placed.iter().map(|(mesh, _)| mesh.primitives.len()).fold(0, usize::saturating_add);
    check_limit(format, "primitives", primitives, MOST_PRIMITIVES)?;
    for (mesh, transform) in placed {
        others |= add_mesh(&mut surface, &buffers, mesh, &transform)?;
    }
    surface.finish(if others { ", only points or lines" } else { "" })
}

fn parse(format: Format, json: &[u8]) -> Result<Root, ReadError> {
    Root::from_slice(json).map_err(|error| {
        let (line, column) = (error.line(), error.column());
        if error.is_eof() {
            ReadError::Truncated { format, detail: format!("its JSON stops in line {line}, column {column}") }
        } else {
            malformed(format, format!("its JSON breaks glTF's rules in line {line}, column {column}"))
        }
    })
}

fn check_extensions(format: Format, root: &Root) -> Result<(), ReadError> {
    for name in &root.extensions_required {
        let feature = match name.as_str() {
            "KHR_draco_mesh_compression" => "Draco compression",
            "EXT_meshopt_compression" | "KHR_meshopt_compression" => "meshopt compression",
            "EXT_mesh_gpu_instancing" => "GPU instancing",
            name if HARMLESS.iter().any(|harmless| name.starts_with(harmless)) => continue,
            _ => "a required extension that is unknown",
        };
        let advice = "export it as plain glTF 2.0";
        return Err(ReadError::UnsupportedFeature { format, feature, advice });
    }
    Ok(())
}

/// Adds the triangles of a mesh; whether it has points or lines as well.
fn add_mesh(
    surface: &mut Surface<'_>,
    buffers: &Buffers<'_>,
    mesh: &Mesh,
    transform: &Matrix4<f64>,
) -> Result<bool, ReadError> {
    let mut others = false;
    for primitive in &mesh.primitives {
        match primitive.mode {
            Checked::Valid(mode @ (Mode::Triangles | Mode::TriangleStrip | Mode::TriangleFan)) => {
                add_primitive(surface, buffers, primitive, mode, transform)?;
            }
            Checked::Valid(_) => others = true,
            Checked::Invalid => {
                return Err(malformed(surface.format(), "a primitive has an unknown mode".to_owned()));
            }
        }
    }
    Ok(others)
}

fn add_primitive(
    surface: &mut Surface<'_>,
    buffers: &Buffers<'_>,
    primitive: &Primitive,
    mode: Mode,
    transform: &Matrix4<f64>,
) -> Result<(), ReadError> {
    let positions = primitive.attributes.get(&Checked::Valid(Semantic::Positions));
    let positions = positions
        .ok_or_else(|| malformed(surface.format(), "a primitive has no POSITION attribute".to_owned()))?;
    let positions = buffers.positions(positions.value())?;
    let first = surface.vertices() as i64;
    surface.declare_vertices(positions.len(), positions.len())?;
    for index in 0..positions.len() {
        let point = transform.transform_point(&positions.point(index).into());
        surface.vertex([point.x, point.y, point.z])?;
    }
    let indices = primitive.indices.map(|indices| buffers.indices(indices.value())).transpose()?;
    let corners = indices.as_ref().map_or(positions.len(), |indices| indices.len());
    let corner = |place: usize| first + indices.as_ref().map_or(place as i64, |indices| indices.index(place));
    // A mirror image is wound the other way around.
    let is_mirrored = transform.fixed_view::<3, 3>(0, 0).determinant() < 0.0;
    let triangles = if mode == Mode::Triangles { corners / 3 } else { corners.saturating_sub(2) };
    surface.declare_faces(triangles, triangles)?;
    for triangle in 0..triangles {
        let [a, b, c] = match mode {
            Mode::Triangles => [3 * triangle, 3 * triangle + 1, 3 * triangle + 2],
            Mode::TriangleStrip => [triangle, triangle + 1 + triangle % 2, triangle + 2 - triangle % 2],
            _ => [triangle + 1, triangle + 2, 0],
        };
        let (b, c) = if is_mirrored { (c, b) } else { (b, c) };
        surface.triangle([corner(a), corner(b), corner(c)])?;
    }
    Ok(())
}
