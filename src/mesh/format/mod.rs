//! Readers of surface meshes, one file a format, behind [`read`].
//!
//! | format | read by | why |
//! | --- | --- | --- |
//! | STL, binary and ASCII | own | `stl_io` drops a second `solid`, rejects upper case, keeps only `f32` |
//! | OBJ | `tobj` | it is shown positions and faces only, so it never opens a material library |
//! | PLY | header `ply-rs-bw`, data own | the crate builds a vector a face, knows neither `.5` nor `nan`, quotes the file in errors |
//! | glTF, GLB | model `gltf`, accessors own | the crate's accessors panic on sizes that lie; only embedded buffers are read |
//! | VTP | own, on `quick-xml`, `base64`, `flate2` | `vtkio` reads neither compressed nor raw appended files of VTK 9 |
//! | legacy VTK | own | versions up to 4.2 and from 5.0 write cells in two ways |
//! | OFF | own | its header has many variants |
//!
//! The stages of every reader: `sniff` finds the format by content; the reader walks the bytes
//! where they lie (no copy of the file is made) and fills a `surface` (or, for STL, a soup that is
//! welded as it comes), which checks limits, indices and coordinates and splits polygons
//! (`polygon`); [`weld`](crate::mesh::weld) joins equal vertices. `text`, `scalar` and `values` are
//! the words and numbers that the formats share.
//!
//! What a file declares is never trusted: counts are held against [`Limits`] and against the bytes
//! that are left before room is made for them, so that a small file that declares a gigabyte fails
//! at once. Errors name places and counts, never text out of the file.

mod error;
mod gltf;
mod gltf_data;
mod gltf_scene;
mod obj;
mod off;
mod ply;
mod polygon;
mod scalar;
mod sniff;
mod stl;
mod surface;
mod text;
mod values;
mod vtk;
mod vtp;
mod vtp_data;
mod vtp_lines;
mod vtp_structure;

use std::fmt;

pub use error::{ReadError, ReadErrorKind};
pub use sniff::{TELLING, plainly_foreign};
pub use stl::write_stl_binary;
pub use vtp_lines::{Polylines, read_polylines};

use super::TriangleMesh;

/// A mesh file format, as its content shows it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    StlBinary,
    StlAscii,
    Obj,
    Ply,
    Gltf,
    Glb,
    Vtp,
    Vtk,
    Off,
}

impl Format {
    /// A stable word for results: both kinds of STL are `stl`.
    pub fn name(self) -> &'static str {
        match self {
            Format::StlBinary | Format::StlAscii => "stl",
            Format::Obj => "obj",
            Format::Ply => "ply",
            Format::Gltf => "gltf",
            Format::Glb => "glb",
            Format::Vtp => "vtp",
            Format::Vtk => "vtk",
            Format::Off => "off",
        }
    }
}

impl fmt::Display for Format {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Format::StlBinary => "binary STL",
            Format::StlAscii => "ASCII STL",
            Format::Obj => "OBJ",
            Format::Ply => "PLY",
            Format::Gltf => "glTF",
            Format::Glb => "GLB",
            Format::Vtp => "VTP",
            Format::Vtk => "VTK",
            Format::Off => "OFF",
        })
    }
}

/// The largest mesh that a reader accepts; checked before anything is allocated for it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Distinct vertices for STL, vertices in the file for the others.
    pub vertices: usize,
    /// Triangles, after polygons and strips were split.
    pub triangles: usize,
    /// Bytes that compressed or base64 data may unpack to.
    pub decoded_bytes: usize,
    /// How many times the file's bytes its compressed data may unpack to, where that is more than
    /// [`Limits::EXPANSION_FREE`]: coordinates and indices of real surfaces pack into a tenth at best.
    pub expansion: usize,
}

impl Limits {
    /// Bytes that any small file's data may unpack to.
    pub const EXPANSION_FREE: usize = 16 << 20;

    /// Bytes that the compressed data of a file of `length` bytes may unpack to.
    fn decoded_of(&self, length: usize) -> usize {
        self.decoded_bytes.min(length.saturating_mul(self.expansion).max(Self::EXPANSION_FREE))
    }

    /// For surfaces of so many triangles. A closed one without a handle has half as many vertices and two more; each
    /// further part brings two, and open ends half as many as their rims have edges: one in a hundred is room for those.
    pub const fn of_triangles(triangles: usize) -> Self {
        let vertices = triangles.div_ceil(2).saturating_add(triangles.div_ceil(100)).saturating_add(2);
        Limits { vertices, triangles, decoded_bytes: 2 << 30, expansion: 50 }
    }
}

impl Default for Limits {
    /// 40 million triangles, 2 GiB decoded, 50 times the file.
    fn default() -> Self {
        Self::of_triangles(40_000_000)
    }
}

/// What the sender says the file is; decides only where the content leaves doubts.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Hint<'a> {
    /// Of the file name, with or without its dot, in any case.
    pub extension: Option<&'a str>,
    /// A media type, parameters allowed.
    pub content_type: Option<&'a str>,
}

/// Reads a surface mesh of any known format.
///
/// Polygons and strips come out as triangles, vertices with equal coordinates as one, in the
/// order of their first appearance; coordinates stay in the file's unit and frame. Triangles stay
/// as they are: degenerate, doubled or badly wound ones are for `mesh::preparation` to repair.
/// Vertices that no triangle uses stay too, except in OBJ.
///
/// # Errors
/// [`ReadError`] when the bytes are no mesh, break their format's rules, or exceed `limits`.
pub fn read(bytes: &[u8], hint: Hint<'_>, limits: &Limits) -> Result<(TriangleMesh, Format), ReadError> {
    let format = sniff::sniff(bytes, hint)?;
    Ok((read_as(bytes, format, limits)?, format))
}

/// [`read`] of bytes whose format is known.
///
/// # Errors
/// [`ReadError`] when the bytes break the format's rules or exceed `limits`.
pub fn read_as(bytes: &[u8], format: Format, limits: &Limits) -> Result<TriangleMesh, ReadError> {
    match format {
        Format::StlBinary => stl::read_binary(bytes, limits),
        Format::StlAscii => stl::read_ascii(bytes, limits),
        Format::Obj => obj::read(bytes, limits),
        Format::Ply => ply::read(bytes, limits),
        Format::Gltf => gltf::read_json(bytes, limits),
        Format::Glb => gltf::read_glb(bytes, limits),
        Format::Vtp => vtp::read(bytes, limits),
        Format::Vtk => vtk::read(bytes, limits),
        Format::Off => off::read(bytes, limits),
    }
}
