//! Legacy VTK polydata, ASCII and binary (*The VTK User's Guide*, "Simple Legacy Formats"), up to
//! version 5.1, which writes cells as offsets and connectivity.
//!
//! Own reader: the crate for it does not read both cell layouts. Reading ends with the geometry;
//! the title, attributes and field data are passed over.

use super::error::EXTRACT_THE_SURFACE;
use super::scalar::{ByteOrder, Scalar};
use super::surface::Surface;
use super::text::Tokens;
use super::values::Values;
use super::{Format, Limits, ReadError};
use crate::mesh::TriangleMesh;

const FORMAT: Format = Format::Vtk;

pub(super) fn read(bytes: &[u8], limits: &Limits) -> Result<TriangleMesh, ReadError> {
    let mut tokens = Tokens::new(FORMAT, bytes);
    let has_offsets = read_version(&mut tokens)? >= 5.0;
    tokens.skip_line_break();
    // The title: free text.
    tokens.skip_line();
    let data = match tokens.next()?.to_ascii_uppercase().as_slice() {
        b"ASCII" => Values::text(tokens),
        b"BINARY" => Values::binary(tokens, ByteOrder::Big),
        _ => return Err(tokens.malformed("\"ASCII\" or \"BINARY\" is missing before this")),
    };
    let mut file = Legacy { data, has_offsets, surface: Surface::new(FORMAT, limits), has_lines: false };
    file.read_dataset()?;
    file.surface.finish(if file.has_lines { ", only lines" } else { "" })
}

/// Reads the first line, `# vtk DataFile Version 3.0`.
fn read_version(tokens: &mut Tokens<'_>) -> Result<f64, ReadError> {
    tokens.expect("#")?;
    tokens.expect("vtk")?;
    tokens.expect("DataFile")?;
    tokens.expect("Version")?;
    let version = tokens.number()?;
    tokens.skip_line();
    Ok(version)
}

struct Legacy<'a> {
    data: Values<'a>,
    /// Cells are written as offsets and connectivity.
    has_offsets: bool,
    surface: Surface<'a>,
    has_lines: bool,
}

/// What to do with the cells of a section.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Cells {
    Polygons,
    Strips,
    Skipped,
}

impl Legacy<'_> {
    fn read_dataset(&mut self) -> Result<(), ReadError> {
        loop {
            self.data.tokens.skip_padding();
            let Some(keyword) = self.data.tokens.peek() else { return Ok(()) };
            let keyword = keyword.to_ascii_uppercase();
            self.data.tokens.next()?;
            match keyword.as_slice() {
                b"DATASET" => self.check_dataset()?,
                b"POINTS" => self.read_points()?,
                b"POLYGONS" => self.read_cells(Cells::Polygons)?,
                b"TRIANGLE_STRIPS" => self.read_cells(Cells::Strips)?,
                b"VERTICES" => self.read_cells(Cells::Skipped)?,
                b"LINES" => {
                    self.has_lines = true;
                    self.read_cells(Cells::Skipped)?;
                }
                b"FIELD" => self.skip_fields()?,
                b"METADATA" => self.skip_metadata(),
                b"POINT_DATA" | b"CELL_DATA" => return Ok(()),
                _ => return Err(self.data.tokens.malformed("there is an unknown section before this")),
            }
        }
    }

    fn check_dataset(&mut self) -> Result<(), ReadError> {
        if self.data.tokens.take_if("POLYDATA")? {
            return Ok(());
        }
        let found = "a legacy VTK file of another kind than POLYDATA";
        Err(ReadError::Unsupported { found, advice: EXTRACT_THE_SURFACE })
    }

    /// A count in a section's first line, which is text in binary files too.
    fn count(&mut self) -> Result<usize, ReadError> {
        let count = self.data.tokens.integer()?;
        usize::try_from(count)
            .map_err(|_| self.data.tokens.malformed("there is a negative count before this"))
    }

    /// A data type, which ends its line; binary data begin behind it.
    fn scalar(&mut self) -> Result<Scalar, ReadError> {
        let scalar = match self.data.tokens.next()?.to_ascii_lowercase().as_slice() {
            b"char" => Scalar::I8,
            b"unsigned_char" => Scalar::U8,
            b"short" => Scalar::I16,
            b"unsigned_short" => Scalar::U16,
            b"int" | b"vtktypeint32" | b"vtkidtype" => Scalar::I32,
            b"unsigned_int" | b"vtktypeuint32" => Scalar::U32,
            b"long" | b"vtktypeint64" => Scalar::I64,
            b"unsigned_long" | b"vtktypeuint64" => Scalar::U64,
            b"float" => Scalar::F32,
            b"double" => Scalar::F64,
            b"bit" | b"variant" => {
                let (feature, advice) =
                    ("field data that are neither numbers nor texts", "save it without its field data");
                return Err(ReadError::UnsupportedFeature { format: FORMAT, feature, advice });
            }
            _ => return Err(self.data.tokens.malformed("there is an unknown data type before this")),
        };
        self.end_line();
        Ok(scalar)
    }

    /// Steps over the line's end, and nothing more: what follows may be binary.
    fn end_line(&mut self) {
        if self.data.is_binary() {
            self.data.tokens.skip_line();
            self.data.tokens.skip_line_break();
        }
    }

    fn read_points(&mut self) -> Result<(), ReadError> {
        let points = self.count()?;
        let scalar = self.scalar()?;
        self.surface.declare_vertices(points, 0)?;
        let most = self.data.most(scalar) / 3;
        self.data.check_count(FORMAT, points, most)?;
        self.surface.declare_vertices(points, most)?;
        for _ in 0..points {
            let point = [self.data.real(scalar)?, self.data.real(scalar)?, self.data.real(scalar)?];
            self.surface.vertex(point)?;
        }
        Ok(())
    }

    fn read_cells(&mut self, cells: Cells) -> Result<(), ReadError> {
        let (first, second) = (self.count()?, self.count()?);
        self.end_line();
        if self.has_offsets {
            self.read_offset_cells(cells, first, second)
        } else {
            self.read_counted_cells(cells, first, second)
        }
    }

    /// Each cell is the number of its corners and these, in `size` integers for all.
    fn read_counted_cells(&mut self, cells: Cells, count: usize, size: usize) -> Result<(), ReadError> {
        let scalar = Scalar::I32;
        self.data.check_count(FORMAT, size, self.data.most(scalar))?;
        if cells == Cells::Skipped {
            return self.data.skip(scalar, size);
        }
        self.surface.declare_faces(count, 0)?;
        self.data.check_count(FORMAT, count, size)?;
        self.surface.declare_faces(count, count)?;
        let mut corners = Vec::new();
        let mut used = 0;
        for _ in 0..count {
            let length = self.data.count(scalar)?;
            self.data.integers(scalar, length, &mut corners)?;
            used += 1 + length;
            self.add(cells, &corners)?;
        }
        if used != size {
            let detail = format!("its cells take {used} integers where {size} are declared");
            return Err(ReadError::Malformed { format: FORMAT, detail });
        }
        Ok(())
    }

    /// First where each cell begins and the last one ends, then the corners of all.
    fn read_offset_cells(&mut self, cells: Cells, offsets: usize, corners: usize) -> Result<(), ReadError> {
        if offsets == 0 {
            return Ok(());
        }
        self.data.tokens.expect("OFFSETS")?;
        let end_type = self.scalar()?;
        let mut ends = self.data.clone();
        self.data.check_count(FORMAT, offsets, self.data.most(end_type))?;
        self.data.skip(end_type, offsets)?;
        self.data.tokens.expect("CONNECTIVITY")?;
        let corner_type = self.scalar()?;
        self.data.check_count(FORMAT, corners, self.data.most(corner_type))?;
        if cells == Cells::Skipped {
            return self.data.skip(corner_type, corners);
        }
        let count = offsets - 1;
        self.surface.declare_faces(count, 0)?;
        self.surface.declare_faces(count, count)?;
        if !end_type.is_integer() || !corner_type.is_integer() || ends.count(end_type)? != 0 {
            let detail = "its cells do not begin at 0, or their indices are not integers".to_owned();
            return Err(ReadError::Malformed { format: FORMAT, detail });
        }
        let mut start = 0;
        let mut list = Vec::new();
        for _ in 0..count {
            let end = ends.count(end_type)?;
            if end < start || end > corners {
                return Err(ends.tokens.malformed("there is an offset that does not fit before this"));
            }
            self.data.integers(corner_type, end - start, &mut list)?;
            self.add(cells, &list)?;
            start = end;
        }
        self.data.skip(corner_type, corners - start)
    }

    fn add(&mut self, cells: Cells, corners: &[i64]) -> Result<(), ReadError> {
        match cells {
            Cells::Polygons => self.surface.polygon(corners),
            Cells::Strips => self.surface.strip(corners),
            Cells::Skipped => Ok(()),
        }
    }

    fn skip_fields(&mut self) -> Result<(), ReadError> {
        self.data.tokens.next()?;
        for _ in 0..self.count()? {
            self.data.tokens.next()?;
            let (components, tuples) = (self.count()?, self.count()?);
            let count = components.saturating_mul(tuples);
            if self.data.tokens.take_if("string")? || self.data.tokens.take_if("utf8_string")? {
                self.skip_texts(count)?;
            } else {
                let scalar = self.scalar()?;
                self.data.check_count(FORMAT, count, self.data.most(scalar))?;
                self.data.skip(scalar, count)?;
            }
            let mut ahead = self.data.tokens.clone();
            if ahead.peek().is_some_and(|token| token.eq_ignore_ascii_case(b"METADATA")) {
                self.data.tokens = ahead;
                self.skip_metadata();
            }
        }
        Ok(())
    }

    /// Texts: a line each, or, in binary files, each behind its length of one, two, four or eight bytes, as the two highest
    /// bits say (`vtkDataWriter`).
    fn skip_texts(&mut self, count: usize) -> Result<(), ReadError> {
        self.data.tokens.skip_line();
        self.data.tokens.skip_line_break();
        for _ in 0..count {
            // Of a file that has ended there is nothing more to take.
            self.data.tokens.clone().take(1)?;
            if self.data.is_binary() {
                let length = self.text_length()?;
                self.data.tokens.take(length)?;
            } else {
                self.data.tokens.skip_line();
                self.data.tokens.skip_line_break();
            }
        }
        Ok(())
    }

    fn text_length(&mut self) -> Result<usize, ReadError> {
        let first = self.data.tokens.take(1)?[0];
        let more = self.data.tokens.take([7, 3, 1, 0][usize::from(first >> 6)])?;
        let length = more.iter().fold(u64::from(first & 0x3f), |length, &byte| length << 8 | u64::from(byte));
        Ok(usize::try_from(length).unwrap_or(usize::MAX))
    }

    /// Text up to an empty line.
    fn skip_metadata(&mut self) {
        let tokens = &mut self.data.tokens;
        loop {
            tokens.skip_line();
            tokens.skip_line_break();
            if tokens.is_at_line_end() {
                return;
            }
        }
    }
}
