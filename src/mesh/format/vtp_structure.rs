//! The structure of a VTK XML PolyData file: its pieces and their data arrays, as they stand in the file.

use std::borrow::Cow;
use std::cell::Cell;

use quick_xml::Reader;
use quick_xml::errors::SyntaxError;
use quick_xml::events::{BytesStart, BytesText, Event};

use super::error::EXTRACT_THE_SURFACE;
use super::scalar::{ByteOrder, Scalar};
use super::values::Values;
use super::vtp_data::{Appended, Array, Compression, Decoder, Role};
use super::{Format, Limits, ReadError};

pub(super) const FORMAT: Format = Format::Vtp;

pub(super) fn malformed(detail: impl Into<String>) -> ReadError {
    ReadError::Malformed { format: FORMAT, detail: detail.into() }
}

/// A `Piece`: how many of each kind it declares, and the arrays that make a surface or a line of it.
#[derive(Debug, Default)]
pub(super) struct Piece<'a> {
    pub(super) points: usize,
    pub(super) coordinates: Option<Array<'a>>,
    /// The radius at each point of a line.
    pub(super) radii: Option<Array<'a>>,
    pub(super) polygons: Cells<'a>,
    pub(super) strips: Cells<'a>,
    pub(super) lines: Cells<'a>,
}

/// The cells of one kind of a piece.
#[derive(Debug, Default)]
pub(super) struct Cells<'a> {
    pub(super) count: usize,
    connectivity: Option<Array<'a>>,
    /// Where each cell ends in `connectivity`.
    offsets: Option<Array<'a>>,
}

/// Reads the structure of `bytes` and hands its pieces to `read`, with what decodes their arrays.
pub(super) fn with_pieces<T>(
    bytes: &[u8],
    limits: &Limits,
    read: impl FnOnce(&[Piece<'_>], &Decoder<'_>) -> Result<T, ReadError>,
) -> Result<T, ReadError> {
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
    read(&file.pieces, &decoder)
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
    PointData,
    Polygons,
    Strips,
    Lines,
}

/// The section that an element begins.
fn section(element: &str) -> Option<Section> {
    match element {
        "Points" => Some(Section::Points),
        "PointData" => Some(Section::PointData),
        "Polys" => Some(Section::Polygons),
        "Strips" => Some(Section::Strips),
        "Lines" => Some(Section::Lines),
        _ => None,
    }
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
                polygons: Cells { count: count(tag, "NumberOfPolys")?, ..Cells::default() },
                strips: Cells { count: count(tag, "NumberOfStrips")?, ..Cells::default() },
                lines: Cells { count: count(tag, "NumberOfLines")?, ..Cells::default() },
                ..Piece::default()
            }),
            name if !is_empty && section(name).is_some() => {
                self.section = section(name).unwrap_or(Section::Other);
            }
            // Other data of the points may be of any type.
            "DataArray" if self.section != Section::Other && self.is_wanted(tag) => {
                let array = Array::new(tag)?;
                if is_empty { self.store(array) } else { self.array = Some(array) }
            }
            _ => {}
        }
        Ok(())
    }

    fn read_file_tag(&mut self, tag: &BytesStart<'a>) -> Result<(), ReadError> {
        if attribute(tag, "type") != Some("PolyData") {
            let found = "a VTK XML file of another kind than PolyData";
            return Err(ReadError::Unsupported { found, advice: EXTRACT_THE_SURFACE });
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
            (None, name) if section(name).is_some() => self.section = Section::Other,
            (None, _) => {}
        }
    }

    fn is_wanted(&self, tag: &BytesStart<'_>) -> bool {
        self.section != Section::PointData || Role::of(tag) == Role::InscribedRadius
    }

    fn store(&mut self, array: Array<'a>) {
        let Some(piece) = self.pieces.last_mut() else { return };
        let cells = match self.section {
            Section::Points => {
                piece.coordinates = Some(array);
                return;
            }
            Section::PointData => {
                piece.radii = Some(array);
                return;
            }
            Section::Polygons => &mut piece.polygons,
            Section::Strips => &mut piece.strips,
            Section::Lines => &mut piece.lines,
            Section::Other => return,
        };
        match array.role {
            Role::Connectivity => cells.connectivity = Some(array),
            Role::Offsets => cells.offsets = Some(array),
            Role::InscribedRadius | Role::Other => {}
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

impl Piece<'_> {
    /// Adds every point to `sink`, which first hears how many there are to come and how many of them the data can hold.
    pub(super) fn each_point<S>(
        &self,
        decoder: &Decoder<'_>,
        sink: &mut S,
        declare: fn(&mut S, usize, usize) -> Result<(), ReadError>,
        add: fn(&mut S, [f64; 3]) -> Result<(), ReadError>,
    ) -> Result<(), ReadError> {
        declare(sink, self.points, 0)?;
        if self.points == 0 {
            return Ok(());
        }
        let missing = || malformed("a piece has no coordinates for its points");
        let array = self.coordinates.as_ref().ok_or_else(missing)?;
        let data = decoder.decode(array, Some(self.points.saturating_mul(3)))?;
        let mut values = data.values(decoder.order);
        declare(sink, self.points, values.most(array.scalar) / 3)?;
        for _ in 0..self.points {
            let mut next = || values.real(array.scalar);
            add(sink, [next()?, next()?, next()?])?;
        }
        check_used_up(&mut values)
    }
}

impl Cells<'_> {
    /// Adds every cell to `sink` by the numbers of its points, each raised by `first`; `declare` as in
    /// [`Piece::each_point`].
    pub(super) fn each<S>(
        &self,
        decoder: &Decoder<'_>,
        first: usize,
        sink: &mut S,
        declare: fn(&mut S, usize, usize) -> Result<(), ReadError>,
        add: fn(&mut S, &[i64]) -> Result<(), ReadError>,
    ) -> Result<(), ReadError> {
        if self.count == 0 {
            return Ok(());
        }
        declare(sink, self.count, 0)?;
        let (Some(connectivity), Some(offsets)) = (&self.connectivity, &self.offsets) else {
            return Err(malformed("its cells lack their connectivity or their offsets"));
        };
        if !connectivity.scalar.is_integer() || !offsets.scalar.is_integer() {
            return Err(malformed("the indices of its cells are not integers"));
        }
        let ends = decoder.decode(offsets, None)?;
        let corners = decoder.decode(connectivity, None)?;
        let (mut ends, mut corners) = (ends.values(decoder.order), corners.values(decoder.order));
        declare(sink, self.count, ends.most(offsets.scalar))?;
        skip_leading_zero(&mut ends, offsets.scalar, self.count)?;
        let mut start = 0;
        let mut list = Vec::new();
        for cell in 0..self.count {
            let end = ends.integer(offsets.scalar)?;
            let length = usize::try_from(end.saturating_sub(start));
            let length = length.map_err(|_| malformed(format!("cell {cell} ends before it begins")))?;
            corners.integers(connectivity.scalar, length, &mut list)?;
            // A negative index stays one: it must not reach back into the piece before.
            list.iter_mut()
                .filter(|corner| **corner >= 0)
                .for_each(|corner| *corner = corner.saturating_add(first as i64));
            add(sink, &list)?;
            start = end;
        }
        check_used_up(&mut ends)?;
        check_used_up(&mut corners)
    }
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

pub(super) fn check_used_up(values: &mut Values<'_>) -> Result<(), ReadError> {
    if !values.is_binary() {
        values.tokens.skip_space();
    }
    if values.tokens.is_at_end() {
        Ok(())
    } else {
        Err(malformed("a data array holds more than its piece declares"))
    }
}
