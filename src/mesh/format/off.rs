//! OFF, ASCII (Geomview manual, *OFF: object file format*), with its colour, normal and texture variants.
//!
//! Own reader: no kept crate covers the variants. As all writers do it, a vertex and a face take
//! a line each; what stands behind the coordinates or the corners there is not read.

use super::surface::Surface;
use super::text::{Tokens, parse};
use super::{Format, Limits, ReadError};
use crate::mesh::TriangleMesh;

const FORMAT: Format = Format::Off;

/// Bytes of the shortest vertex line, `0 0 0` and its break, and of the shortest face, `3 0 0 0`.
const SHORTEST_VERTEX: usize = 6;
const SHORTEST_FACE: usize = 8;

/// Whether a file begins with `OFF` or a variant of it.
pub(super) fn has_keyword(text: &[u8]) -> bool {
    let end = text.iter().position(|byte| byte.is_ascii_whitespace()).unwrap_or(text.len());
    let variant = text[..end].strip_suffix(b"OFF");
    variant.is_some_and(|prefix| prefix.iter().all(|byte| b"STCN4n".contains(byte)))
}

/// The keyword may be missing: then the counts come first.
pub(super) fn read(bytes: &[u8], limits: &Limits) -> Result<TriangleMesh, ReadError> {
    let mut tokens = Tokens::new(FORMAT, bytes);
    skip_comments(&mut tokens);
    if let Some(keyword) = tokens.peek().filter(|token| has_keyword(token)) {
        let advice = "export it in three dimensions";
        if keyword.contains(&b'4') || keyword.contains(&b'n') {
            return Err(ReadError::UnsupportedFeature {
                format: FORMAT,
                feature: "another dimension than three",
                advice,
            });
        }
        tokens.next()?;
        skip_comments(&mut tokens);
        if tokens.peek().is_some_and(|token| token.eq_ignore_ascii_case(b"binary")) {
            let advice = "export it as ASCII OFF";
            return Err(ReadError::UnsupportedFeature {
                format: FORMAT,
                feature: "the binary encoding",
                advice,
            });
        }
    }
    let vertices = count(&mut tokens)?;
    let faces = count(&mut tokens)?;
    tokens.skip_line();
    let mut surface = Surface::new(FORMAT, limits);
    surface.declare_vertices(vertices, bytes.len() / SHORTEST_VERTEX)?;
    surface.declare_faces(faces, bytes.len() / SHORTEST_FACE)?;
    for _ in 0..vertices {
        skip_comments(&mut tokens);
        surface.vertex([tokens.number()?, tokens.number_in_line()?, tokens.number_in_line()?])?;
        tokens.skip_line();
    }
    let mut corners = Vec::new();
    for _ in 0..faces {
        skip_comments(&mut tokens);
        corners.clear();
        for _ in 0..count(&mut tokens)? {
            corners.push(tokens.integer()?);
        }
        surface.polygon(&corners)?;
        tokens.skip_line();
    }
    surface.finish("")
}

fn count(tokens: &mut Tokens<'_>) -> Result<usize, ReadError> {
    skip_comments(tokens);
    let token = tokens.peek().ok_or_else(|| tokens.ends())?;
    let count = parse(token).ok_or_else(|| tokens.malformed("there is no count"))?;
    tokens.next()?;
    Ok(count)
}

fn skip_comments(tokens: &mut Tokens<'_>) {
    while tokens.peek().is_some_and(|token| token[0] == b'#') {
        tokens.skip_line();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::format::{Hint, read};

    const LIMITS: Limits = Limits { vertices: 100, triangles: 100, decoded_bytes: 1000, expansion: 1 };

    fn off(text: &str) -> Result<TriangleMesh, ReadError> {
        let hint = Hint { extension: Some(".OFF"), content_type: None };
        let (mesh, format) = read(text.as_bytes(), hint, &LIMITS)?;
        assert_eq!(format, Format::Off);
        Ok(mesh)
    }

    #[test]
    fn variants_read_the_same() -> Result<(), ReadError> {
        let plain = off("OFF\n4 2 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n3 0 1 2\n3 0 2 3\n")?;
        assert_eq!(plain.triangles, [[0, 1, 2], [0, 2, 3]]);
        let quad = "OFF 4 1 4\n# corners\n0 0 0\n\n1 0 0 # right\n1 1 0\n0 1 0\n4 0 1 2 3 0.5 0.5 0.5\n";
        assert_eq!(off(quad)?, plain);
        let coloured = "# made by hand\r\nCOFF # colours\r\n4 1\r\n0 0 0 255 0 0 255\r\n1 0 0 1 1 1 1\r\n1 1 0 0 0 0 0\r\n0 1 0 9 9 9 9\r\n4 0 1 2 3";
        assert_eq!(off(coloured)?, plain);
        assert_eq!(off("4 1 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3\n")?, plain);
        Ok(())
    }

    #[test]
    fn what_is_wrong_is_said() {
        for (text, code) in [
            ("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 3\n", "index-out-of-range"),
            ("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 -1\n", "index-out-of-range"),
            ("OFF\n3 1 0\n0 0 0\n1 nan 0\n0 1 0\n3 0 1 2\n", "non-finite-coordinate"),
            ("OFF\n3 2 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n", "truncated"),
            ("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n999999999999 0 1 2\n", "truncated"),
            ("OFF\n3 1 0\n0 0\n1 0 0\n0 1 0\n3 0 1 2\n", "malformed"),
            ("OFF\n3 101 0\n", "too-large"),
            ("OFF\n1000000000 1 0\n", "too-large"),
            ("OFF\n1 0 0\n0 0 0\n", "no-polygons"),
            ("4OFF\n1 0 0\n0 0 0 0\n", "unsupported-feature"),
            ("OFF BINARY\n\0\0\0\0", "unsupported-feature"),
        ] {
            assert_eq!(off(text).unwrap_err().code(), code, "{text}");
        }
    }
}
