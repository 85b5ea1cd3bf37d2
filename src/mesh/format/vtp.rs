//! VTP, VTK's XML PolyData (*The VTK User's Guide*, "XML File Formats"; written by VTK to this day).
//!
//! Own reader on `quick-xml`: the crate for it reads neither compressed nor raw appended files
//! as VTK 9 writes them. This file reads the structure, [`super::vtp_data`] the numbers.

use std::borrow::Cow;
use std::cell::Cell;

use quick_xml::Reader;
use quick_xml::errors::SyntaxError;
use quick_xml::events::{BytesStart, BytesText, Event};

use super::scalar::{ByteOrder, Scalar};
use super::surface::Surface;
use super::values::Values;
use super::vtp_data::{Appended, Array, Compression, Decoder, Role};
use super::{Format, Limits, ReadError};
use crate::mesh::TriangleMesh;

pub(super) const FORMAT: Format = Format::Vtp;

pub(super) fn malformed(detail: impl Into<String>) -> ReadError {
    ReadError::Malformed { format: FORMAT, detail: detail.into() }
}

/// A `Piece`: how many of each kind it declares, and the arrays of those kinds that make a surface.
#[derive(Debug, Default)]
struct Piece<'a> {
    points: usize,
    lines: usize,
    coordinates: Option<Array<'a>>,
    polygons: Cells<'a>,
    strips: Cells<'a>,
}

#[derive(Debug, Default)]
struct Cells<'a> {
    count: usize,
    connectivity: Option<Array<'a>>,
    /// Where each cell ends in `connectivity`.
    offsets: Option<Array<'a>>,
}

pub(super) fn read(bytes: &[u8], limits: &Limits) -> Result<TriangleMesh, ReadError> {
    let (head, tail) = split_at_appended(bytes);
    // Names may be in any encoding; nothing else is outside ASCII.
    let head = String::from_utf8_lossy(head);
    let file = Structure::read(&head)?;
    let appended = tail.map(|data| Appended::new(data, file.appended_is_base64)).transpose()?;
    let decoder = Decoder {
        order: file.order,
        header: file.header,
        compression: file.compression,
        appended,
        unpacked: Cell::new(0),
        limit: limits.decoded_of(bytes.len()),
    };
    let mut surface = Surface::new(FORMAT, limits);
    for piece in &file.pieces {
        add_piece(&mut surface, &decoder, piece)?;
    }
    let has_lines = file.pieces.iter().any(|piece| piece.lines > 0);
    surface.finish(if has_lines { ", only lines" } else { "" })
}

/// The XML up to the tag `<AppendedData ...>`, and what stands behind that.
fn split_at_appended(bytes: &[u8]) -> (&[u8], Option<&[u8]>) {
    let mut at = 0;
    while let Some(next) = bytes[at..].iter().position(|&byte| byte == b'<') {
        at += next;
        if bytes[at..].starts_with(b"<AppendedData")
            && let Some(length) = bytes[at..].iter().position(|&byte| byte == b'>')
        {
            let (head, tail) = bytes.split_at(at + length + 1);
            return (head, Some(tail));
        }
        at += 1;
    }
    (bytes, None)
}

/// The element that the reader stands in, as far as it matters.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Section {
    Other,
    Points,
    Polygons,
    Strips,
}

/// The structure of a file, and of what the reader is in while it reads it.
struct Structure<'a> {
    order: ByteOrder,
    /// The type of the counts before binary data.
    header: Scalar,
    compression: Compression,
    appended_is_base64: bool,
    pieces: Vec<Piece<'a>>,
    section: Section,
    array: Option<Array<'a>>,
    /// Elements open inside of `array`.
    depth: usize,
}

impl<'a> Structure<'a> {
    fn read(text: &'a str) -> Result<Self, ReadError> {
        let mut file = Structure {
            order: ByteOrder::Little,
            header: Scalar::U32,
            compression: Compression::None,
            appended_is_base64: true,
            pieces: Vec::new(),
            section: Section::Other,
            array: None,
            depth: 0,
        };
        let mut reader = Reader::from_str(text);
        loop {
            let event = reader.read_event().map_err(|error| match error {
                quick_xml::Error::Syntax(SyntaxError::InvalidBangMarkup) => broken_xml(&reader),
                // Something is not closed before the end.
                quick_xml::Error::Syntax(_) => cut_short(),
                _ => broken_xml(&reader),
            })?;
            match event {
                Event::Start(tag) if tag.name().0 == "AppendedData" => {
                    file.appended_is_base64 = attribute(&tag, "encoding") != Some("raw");
                    return Ok(file);
                }
                Event::Start(tag) => file.open(&tag, false)?,
                Event::Empty(tag) => file.open(&tag, true)?,
                Event::Text(text) => file.text(text)?,
                Event::End(tag) if tag.name().0 == "VTKFile" => return Ok(file),
                Event::End(tag) => file.close(tag.name().0),
                Event::Eof => return Err(cut_short()),
                _ => {}
            }
        }
    }

    fn open(&mut self, tag: &BytesStart<'a>, is_empty: bool) -> Result<(), ReadError> {
        if self.array.is_some() {
            self.depth += usize::from(!is_empty);
            return Ok(());
        }
        match tag.name().0 {
            "VTKFile" => self.read_file_tag(tag)?,
            "Piece" => self.pieces.push(Piece {
                points: count(tag, "NumberOfPoints")?,
                lines: count(tag, "NumberOfLines")?,
                coordinates: None,
                polygons: Cells { count: count(tag, "NumberOfPolys")?, ..Cells::default() },
                strips: Cells { count: count(tag, "NumberOfStrips")?, ..Cells::default() },
            }),
            "Points" if !is_empty => self.section = Section::Points,
            "Polys" if !is_empty => self.section = Section::Polygons,
            "Strips" if !is_empty => self.section = Section::Strips,
            "DataArray" if self.section != Section::Other => {
                let array = Array::new(tag)?;
                if is_empty { self.store(array) } else { self.array = Some(array) }
            }
            _ => {}
        }
        Ok(())
    }

    fn read_file_tag(&mut self, tag: &BytesStart<'a>) -> Result<(), ReadError> {
        if attribute(tag, "type") != Some("PolyData") {
            let found = "a VTK XML file of another kind than PolyData (extract the surface and save that)";
            return Err(ReadError::Unsupported { found });
        }
        if attribute(tag, "byte_order") == Some("BigEndian") {
            self.order = ByteOrder::Big;
        }
        if attribute(tag, "header_type") == Some("UInt64") {
            self.header = Scalar::U64;
        }
        self.compression = match attribute(tag, "compressor") {
            None | Some("") => Compression::None,
            Some("vtkZLibDataCompressor") => Compression::Zlib,
            Some("vtkLZ4DataCompressor") => Compression::Other("LZ4 compression"),
            Some("vtkLZMADataCompressor") => Compression::Other("LZMA compression"),
            Some(_) => Compression::Other("an unknown compression"),
        };
        Ok(())
    }

    fn text(&mut self, text: BytesText<'a>) -> Result<(), ReadError> {
        let (Some(array), 0, Cow::Borrowed(text)) = (&mut self.array, self.depth, text.into_inner()) else {
            return Ok(());
        };
        let text = text.trim_ascii();
        if !text.is_empty() && !std::mem::replace(&mut array.text, text).is_empty() {
            return Err(malformed("a data array holds its data in two parts"));
        }
        Ok(())
    }

    fn close(&mut self, name: &str) {
        match (self.array.take(), name) {
            (Some(array), "DataArray") if self.depth == 0 => self.store(array),
            (Some(array), _) => {
                self.depth = self.depth.saturating_sub(1);
                self.array = Some(array);
            }
            (None, "Points" | "Polys" | "Strips") => self.section = Section::Other,
            (None, _) => {}
        }
    }

    fn store(&mut self, array: Array<'a>) {
        let Some(piece) = self.pieces.last_mut() else { return };
        let cells = match self.section {
            Section::Points => {
                piece.coordinates = Some(array);
                return;
            }
            Section::Polygons => &mut piece.polygons,
            Section::Strips => &mut piece.strips,
            Section::Other => return,
        };
        match array.role {
            Role::Connectivity => cells.connectivity = Some(array),
            Role::Offsets => cells.offsets = Some(array),
            Role::Other => {}
        }
    }
}

fn broken_xml(reader: &Reader<&[u8]>) -> ReadError {
    malformed(format!("its XML breaks the rules near byte {}", reader.buffer_position()))
}

fn cut_short() -> ReadError {
    ReadError::Truncated { format: FORMAT, detail: "its XML stops before the end tag of VTKFile".to_owned() }
}

/// An attribute's value without the space around it.
pub(super) fn attribute<'t>(tag: &'t BytesStart<'_>, name: &str) -> Option<&'t str> {
    // quick-xml's check for duplicates compares every pair of attributes.
    let mut attributes = tag.attributes();
    let mut attributes = attributes.with_checks(false).flatten();
    match attributes.find(|attribute| attribute.key.0 == name)?.value {
        Cow::Borrowed(value) => Some(value.trim_ascii()),
        Cow::Owned(_) => None,
    }
}

fn count(tag: &BytesStart<'_>, name: &str) -> Result<usize, ReadError> {
    let parse = |text: &str| text.parse().map_err(|_| malformed(format!("{name} is no count")));
    attribute(tag, name).map_or(Ok(0), parse)
}

fn add_piece<'a>(
    surface: &mut Surface<'_>,
    decoder: &Decoder<'a>,
    piece: &Piece<'a>,
) -> Result<(), ReadError> {
    let first = surface.vertices();
    surface.declare_vertices(piece.points, 0)?;
    if let (Some(array), 1..) = (&piece.coordinates, piece.points) {
        let data = decoder.decode(array, Some(piece.points.saturating_mul(3)))?;
        let mut values = data.values(decoder.order);
        surface.declare_vertices(piece.points, values.most(array.scalar) / 3)?;
        for _ in 0..piece.points {
            surface.vertex([
                values.real(array.scalar)?,
                values.real(array.scalar)?,
                values.real(array.scalar)?,
            ])?;
        }
        check_used_up(&mut values)?;
    } else if piece.points > 0 {
        return Err(malformed("a piece has no coordinates for its points"));
    }
    add_cells(surface, decoder, &piece.polygons, first, Surface::polygon)?;
    add_cells(surface, decoder, &piece.strips, first, Surface::strip)
}

fn add_cells<'a, 's>(
    surface: &mut Surface<'s>,
    decoder: &Decoder<'a>,
    cells: &Cells<'a>,
    first: usize,
    add: fn(&mut Surface<'s>, &[i64]) -> Result<(), ReadError>,
) -> Result<(), ReadError> {
    if cells.count == 0 {
        return Ok(());
    }
    surface.declare_faces(cells.count, 0)?;
    let (Some(connectivity), Some(offsets)) = (&cells.connectivity, &cells.offsets) else {
        return Err(malformed("its cells lack their connectivity or their offsets"));
    };
    if !connectivity.scalar.is_integer() || !offsets.scalar.is_integer() {
        return Err(malformed("the indices of its cells are not integers"));
    }
    let ends = decoder.decode(offsets, None)?;
    let corners = decoder.decode(connectivity, None)?;
    let (mut ends, mut corners) = (ends.values(decoder.order), corners.values(decoder.order));
    surface.declare_faces(cells.count, ends.most(offsets.scalar))?;
    skip_leading_zero(&mut ends, offsets.scalar, cells.count)?;
    let mut start = 0;
    let mut list = Vec::new();
    for cell in 0..cells.count {
        let end = ends.integer(offsets.scalar)?;
        let length = usize::try_from(end.saturating_sub(start));
        let length = length.map_err(|_| malformed(format!("cell {cell} ends before it begins")))?;
        corners.integers(connectivity.scalar, length, &mut list)?;
        // A negative index stays one: it must not reach back into the piece before.
        list.iter_mut()
            .filter(|corner| **corner >= 0)
            .for_each(|corner| *corner = corner.saturating_add(first as i64));
        add(surface, &list)?;
        start = end;
    }
    check_used_up(&mut ends)?;
    check_used_up(&mut corners)
}

/// VTK itself keeps a 0 before the first cell's end; some files do so too.
fn skip_leading_zero(ends: &mut Values<'_>, scalar: Scalar, cells: usize) -> Result<(), ReadError> {
    let mut probe = ends.clone();
    if probe.integer(scalar)? == 0 {
        let after_zero = probe.clone();
        probe.skip(scalar, cells - 1)?;
        if probe.skip(scalar, 1).is_ok() {
            *ends = after_zero;
        }
    }
    Ok(())
}

fn check_used_up(values: &mut Values<'_>) -> Result<(), ReadError> {
    if !values.is_binary() {
        values.tokens.skip_space();
    }
    if values.tokens.is_at_end() {
        Ok(())
    } else {
        Err(malformed("a data array holds more than its piece declares"))
    }
}
