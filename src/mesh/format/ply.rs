//! PLY, ASCII and binary of both byte orders (Turk, *The PLY Polygon File Format*, 1994).
//!
//! The header is read by `ply-rs-bw`, the data here: the crate builds a vector for every face,
//! knows no ASCII number such as `.5` or `nan`, and quotes the file in its errors.

use ply_rs_bw::parser::{Parser, Reader};
use ply_rs_bw::ply::{DefaultElement, ElementDef, Encoding, Header, PropertyType, ScalarType};

use super::scalar::{ByteOrder, Scalar};
use super::surface::Surface;
use super::text::Tokens;
use super::values::Values;
use super::{Format, Limits, ReadError};
use crate::mesh::TriangleMesh;

const FORMAT: Format = Format::Ply;

/// A header takes a few hundred bytes; comments may fill some more.
const LONGEST_HEADER: usize = 1 << 20;

pub(super) fn read(bytes: &[u8], limits: &Limits) -> Result<TriangleMesh, ReadError> {
    let (header, start) = read_header(bytes)?;
    let tokens = Tokens::starting_at(FORMAT, bytes, start);
    let mut data = match header.encoding {
        Encoding::Ascii => Values::text(tokens),
        Encoding::BinaryLittleEndian => Values::binary(tokens, ByteOrder::Little),
        Encoding::BinaryBigEndian => Values::binary(tokens, ByteOrder::Big),
    };
    let mut surface = Surface::new(FORMAT, limits);
    let mut has_vertices = false;
    // Faces that stand before the vertices are read once these are known.
    let mut early_faces = Vec::new();
    for element in header.elements.values() {
        match element.name.as_str() {
            "vertex" => {
                read_vertices(&mut data, element, &mut surface)?;
                has_vertices = true;
            }
            "face" | "tristrips" if has_vertices => read_faces(&mut data, element, &mut surface)?,
            "face" | "tristrips" => {
                early_faces.push((element, data.clone()));
                skip(&mut data, element)?;
            }
            _ => skip(&mut data, element)?,
        }
    }
    for (element, mut data) in early_faces {
        read_faces(&mut data, element, &mut surface)?;
    }
    surface.finish("")
}

fn malformed(detail: impl Into<String>) -> ReadError {
    ReadError::Malformed { format: FORMAT, detail: detail.into() }
}

/// The header, and the offset at which the data begin.
fn read_header(bytes: &[u8]) -> Result<(Header, usize), ReadError> {
    let head = &bytes[..bytes.len().min(LONGEST_HEADER)];
    // Binary data may begin with a line feed: a CR alone ends lines only where it ends the first.
    let first = head.iter().position(|byte| matches!(byte, b'\n' | b'\r')).unwrap_or(head.len());
    let line_break: &[u8] = match head[first..] {
        [b'\r', b'\n', ..] => b"\r\n",
        [b'\r', ..] => b"\r",
        _ => b"\n",
    };
    let mut text = String::new();
    let mut at = 0;
    while let Some(length) = head[at..].windows(line_break.len()).position(|window| window == line_break) {
        let line = String::from_utf8_lossy(head[at..at + length].trim_ascii());
        at += length + line_break.len();
        // A comment may hold a patient's name, in any encoding: it goes no further.
        let is_comment = line.is_empty() || line.starts_with("comment") || line.starts_with("obj_info");
        text.push_str(if is_comment { "comment" } else { &line });
        text.push('\n');
        if line == "end_header" {
            return Ok((parse_header(&text)?, at));
        }
    }
    Err(ReadError::Truncated { format: FORMAT, detail: "its header has no end_header".to_owned() })
}

fn parse_header(text: &str) -> Result<Header, ReadError> {
    let header = Parser::<DefaultElement>::new().read_header(&mut Reader::new(text.as_bytes()));
    header.map_err(|error| match error.line() {
        Some(line) => malformed(format!("line {line} of its header breaks the rules")),
        None => malformed("its header has no valid format line"),
    })
}

/// What a property is made of.
#[derive(Debug, Clone, Copy)]
enum Kind {
    One(Scalar),
    /// Of the length, of an entry.
    List(Scalar, Scalar),
}

impl Kind {
    fn of(property: &PropertyType) -> Self {
        match property {
            PropertyType::Scalar(kind) => Kind::One(scalar(kind)),
            PropertyType::List(length, entry) => Kind::List(scalar(length), scalar(entry)),
        }
    }

    /// Bytes that it takes at least: an empty list its length.
    fn least_size(self) -> usize {
        match self {
            Kind::One(scalar) | Kind::List(scalar, _) => scalar.size(),
        }
    }

    fn skip(self, data: &mut Values<'_>) -> Result<(), ReadError> {
        match self {
            Kind::One(scalar) => data.skip(scalar, 1),
            Kind::List(length, entry) => {
                let count = data.count(length)?;
                data.skip(entry, count)
            }
        }
    }
}

fn scalar(of: &ScalarType) -> Scalar {
    match of {
        ScalarType::Char => Scalar::I8,
        ScalarType::UChar => Scalar::U8,
        ScalarType::Short => Scalar::I16,
        ScalarType::UShort => Scalar::U16,
        ScalarType::Int => Scalar::I32,
        ScalarType::UInt => Scalar::U32,
        ScalarType::Float => Scalar::F32,
        ScalarType::Double => Scalar::F64,
    }
}

/// The properties of an element, each with what `role` makes of its name.
fn properties<R>(element: &ElementDef, role: impl Fn(&str) -> R) -> Vec<(Kind, R)> {
    element
        .properties
        .values()
        .map(|property| (Kind::of(&property.data_type), role(&property.name)))
        .collect()
}

/// Fails when `element` declares more than the rest of the file can hold.
fn check_count(data: &Values<'_>, element: &ElementDef) -> Result<(), ReadError> {
    let least: usize = if data.is_binary() {
        properties(element, |_| ()).iter().map(|(kind, ())| kind.least_size()).sum()
    } else {
        // A digit and a space or line break, which the last one may lack.
        2 * element.properties.len()
    };
    data.check_count(FORMAT, element.count, (data.tokens.left() + 1) / least.max(1))
}

fn skip(data: &mut Values<'_>, element: &ElementDef) -> Result<(), ReadError> {
    check_count(data, element)?;
    let properties = properties(element, |_| ());
    if properties.is_empty() {
        return Ok(());
    }
    for _ in 0..element.count {
        properties.iter().try_for_each(|(kind, ())| kind.skip(data))?;
    }
    Ok(())
}

fn read_vertices(
    data: &mut Values<'_>,
    element: &ElementDef,
    surface: &mut Surface<'_>,
) -> Result<(), ReadError> {
    surface.declare_vertices(element.count, 0)?;
    check_count(data, element)?;
    surface.declare_vertices(element.count, element.count)?;
    let properties = properties(element, |name| ["x", "y", "z"].iter().position(|axis| *axis == name));
    let has = |axis| properties.iter().any(|(kind, of)| matches!(kind, Kind::One(_)) && *of == Some(axis));
    if !(0..3).all(has) {
        return Err(malformed("its vertices have no x, y and z"));
    }
    for _ in 0..element.count {
        let mut coordinates = [0.0; 3];
        for &(kind, axis) in &properties {
            match (kind, axis) {
                (Kind::One(scalar), Some(axis)) => coordinates[axis] = data.real(scalar)?,
                _ => kind.skip(data)?,
            }
        }
        surface.vertex(coordinates)?;
    }
    Ok(())
}

/// Polygons, or strips in which -1 ends one.
fn read_faces(
    data: &mut Values<'_>,
    element: &ElementDef,
    surface: &mut Surface<'_>,
) -> Result<(), ReadError> {
    surface.declare_faces(element.count, 0)?;
    check_count(data, element)?;
    surface.declare_faces(element.count, element.count)?;
    let properties = properties(element, |name| matches!(name, "vertex_indices" | "vertex_index"));
    if !properties.iter().any(|(kind, is_corners)| *is_corners && matches!(kind, Kind::List(..))) {
        return Err(malformed("its faces have no list of vertex_indices"));
    }
    let mut corners = Vec::new();
    for _ in 0..element.count {
        for &(kind, is_corners) in &properties {
            match kind {
                Kind::List(length, entry) if is_corners => {
                    let count = data.count(length)?;
                    data.integers(entry, count, &mut corners)?;
                }
                _ => kind.skip(data)?,
            }
        }
        if element.name == "face" {
            surface.polygon(&corners)?;
        } else {
            corners.split(|&corner| corner == -1).try_for_each(|strip| surface.strip(strip))?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::format::{Hint, read};

    const LIMITS: Limits = Limits { vertices: 100, triangles: 100, decoded_bytes: 1000, expansion: 1 };

    fn ply(bytes: &[u8]) -> Result<TriangleMesh, ReadError> {
        let (mesh, format) = read(bytes, Hint::default(), &LIMITS)?;
        assert_eq!(format, Format::Ply);
        Ok(mesh)
    }

    const VERTICES: &str = "element vertex 4\nproperty float x\nproperty float y\nproperty float z\n";
    const FACES: &str = "element face 2\nproperty list uchar int vertex_indices\n";
    const SQUARE: &str = "0 0 0\n1. 0 0\n1 1e0 0\n0 +1 -.0\n3 0 1 2\n3 0 2 3";

    fn ascii(elements: &str, body: &str) -> Vec<u8> {
        format!("ply\nformat ascii 1.0\n{elements}end_header\n{body}").into_bytes()
    }

    #[test]
    fn text_reads_with_other_properties_orders_and_line_breaks() -> Result<(), ReadError> {
        let plain = ply(&ascii(&format!("{VERTICES}{FACES}"), SQUARE))?;
        assert_eq!(plain.triangles, [[0, 1, 2], [0, 2, 3]]);
        let faces_first = ascii(&format!("{FACES}{VERTICES}"), "3 0 1 2 3 0 2 3 0 0 0 1 0 0 1 1 0 0 1 0");
        assert_eq!(ply(&faces_first)?, plain);
        let rich = ascii(
            "comment by M\u{fc}ller\nelement camera 1\nproperty list uchar float view\nelement vertex 4\n\
             property double z\nproperty uchar red\nproperty double x\nproperty double y\n\
             element face 1\nproperty uchar a\nproperty list int uint vertex_index\nproperty list uchar float uv\n",
            "2 0.5 nan\n0 9 0 0\n0 9 1 0\n0 9 1 1\n0 9 0 1\n7 4 0 1 2 3 2 .5 .5\n",
        );
        assert_eq!(ply(&rich)?, plain);
        for line_break in ["\r", "\r\n"] {
            let text = String::from_utf8_lossy(&rich).replace('\n', line_break);
            assert_eq!(ply(text.as_bytes())?, plain);
        }
        let latin = [b"ply\ncomment \xe9\xff\n", &rich[4..]].concat();
        assert_eq!(ply(&latin)?, plain);
        let strips = "element tristrips 1\nproperty list int int vertex_indices\n";
        let stripped =
            ply(&ascii(&format!("{VERTICES}{strips}"), "0 0 0\n1 0 0\n1 1 0\n0 1 0\n8 1 2 0 3 -1 0 1 2\n"))?;
        assert_eq!(stripped.triangles, [[1, 2, 0], [0, 2, 3], [0, 1, 2]]);
        Ok(())
    }

    #[test]
    fn binary_reads_in_both_byte_orders() -> Result<(), ReadError> {
        let plain = ply(&ascii(&format!("{VERTICES}{FACES}"), SQUARE))?;
        let vertices = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0f32, 1.0, 0.0]].concat();
        let faces = [[0, 1, 2], [0, 2, 3i32]];
        let head = |order: &str| {
            format!("ply\r\nformat binary_{order}_endian 1.0\r\n{VERTICES}{FACES}end_header\r\n")
        };
        let mut little = head("little").into_bytes();
        let mut big = head("big").into_bytes();
        little.extend(vertices.iter().flat_map(|number| number.to_le_bytes()));
        big.extend(vertices.iter().flat_map(|number| number.to_be_bytes()));
        for face in faces {
            little.push(3);
            big.push(3);
            little.extend(face.iter().flat_map(|corner| corner.to_le_bytes()));
            big.extend(face.iter().flat_map(|corner| corner.to_be_bytes()));
        }
        // The header's elements end in LF here, the other lines in CR LF: no reader of text minds.
        let fix = |bytes: Vec<u8>| {
            let end = bytes.windows(10).position(|window| window == b"end_header").unwrap_or(0);
            let head = String::from_utf8_lossy(&bytes[..end]).replace("\r\n", "\n").replace('\n', "\r\n");
            [head.as_bytes(), &bytes[end..]].concat()
        };
        assert_eq!(ply(&fix(little.clone()))?, plain);
        assert_eq!(ply(&fix(big))?, plain);
        for cut in 1..little.len() - 140 {
            assert_eq!(
                ply(&fix(little[..little.len() - cut].to_vec())).unwrap_err().code(),
                "truncated",
                "{cut}"
            );
        }
        Ok(())
    }

    #[test]
    fn a_negative_count_is_said_with_its_place() {
        let bytes = ascii(&format!("{VERTICES}{FACES}"), &SQUARE.replace("3 0 2 3", "-3 0 2 3"));
        let end = bytes.len() - " 0 2 3".len();
        let said = format!("a count is -3, which is negative; it ends at byte {end}, line 15;");
        let error = ply(&bytes).unwrap_err().to_string();
        assert!(error.contains(&said), "{error}");
    }

    #[test]
    fn what_is_wrong_is_said() {
        let body = |body: &str| ascii(&format!("{VERTICES}{FACES}"), body);
        let head = |head: &str| ascii(head, SQUARE);
        for (bytes, code) in [
            (body(&SQUARE.replace("3 0 2 3", "3 0 2 4")), "index-out-of-range"),
            (body(&SQUARE.replace("3 0 2 3", "3 0 2 -1")), "index-out-of-range"),
            (body(&SQUARE.replace("3 0 2 3", "-3 0 2 3")), "malformed"),
            (body(&SQUARE.replace("1e0", "1e999")), "non-finite-coordinate"),
            (body(&SQUARE.replace("1e0", "one")), "malformed"),
            (head(&format!("{VERTICES}{FACES}").replace("element face 2", "element face 3")), "truncated"),
            (head("element vertex 90\nproperty float x\nproperty float y\nproperty float z\n"), "truncated"),
            (head("element vertex 1000000000\nproperty float x\n"), "too-large"),
            (head("element nothing 18446744073709551615\n"), "truncated"),
            (head("element vertex 99999999999999999999\n"), "malformed"),
            (head("element vertex 4\nproperty float x\nproperty float y\n"), "malformed"),
            (head(&format!("{VERTICES}element face 2\nproperty int vertex_indices\n")), "malformed"),
            (head("property float x\n"), "malformed"),
            (head(VERTICES), "no-polygons"),
            (b"ply\nformat ascii 1.0\nelement vertex 4\n".to_vec(), "truncated"),
            (b"ply\nend_header\n".to_vec(), "malformed"),
        ] {
            assert_eq!(ply(&bytes).unwrap_err().code(), code, "{}", String::from_utf8_lossy(&bytes));
        }
    }
}
