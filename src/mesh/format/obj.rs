//! Wavefront OBJ (Alias|Wavefront, *Object Files*, appendix B1), polygons only.
//!
//! `tobj` reads the positions and faces. It is shown nothing else: groups, materials and texture
//! coordinates do not shape a surface, and names and comments need not even be text.
//! Vertices that no face uses are left out.

use std::io::{self, BufRead, Read};

use tobj::{LoadError, LoadOptions, Mesh};

use super::surface::{Surface, check_limit};
use super::text::parse;
use super::{Format, Limits, ReadError};
use crate::mesh::TriangleMesh;

const FORMAT: Format = Format::Obj;

pub(super) fn read(bytes: &[u8], limits: &Limits) -> Result<TriangleMesh, ReadError> {
    let mut lines = GeometryLines::new(bytes, limits);
    let options = LoadOptions { ignore_lines: true, ignore_points: true, ..LoadOptions::default() };
    // The lines shown to tobj name no material library, so it asks for none.
    let no_materials = |_: &std::path::Path| Err(LoadError::OpenFileFailed);
    let loaded = tobj::load_obj_buf(&mut lines, &options, no_materials);
    let models = match loaded {
        Ok((models, _)) => models,
        Err(error) => return Err(lines.failure.take().unwrap_or_else(|| explain(error, &lines, bytes))),
    };
    let mut surface = Surface::new(FORMAT, limits);
    for model in models {
        add_mesh(&mut surface, &model.mesh)?;
    }
    surface.finish("")
}

fn add_mesh(surface: &mut Surface<'_>, mesh: &Mesh) -> Result<(), ReadError> {
    let first = surface.vertices() as i64;
    surface.declare_vertices(mesh.positions.len() / 3, mesh.positions.len() / 3)?;
    for position in mesh.positions.chunks_exact(3) {
        surface.vertex([position[0], position[1], position[2]])?;
    }
    let mut corners = mesh.indices.iter().map(|&index| first + i64::from(index));
    // No arities: all are triangles.
    let arities = mesh.face_arities.iter().map(|&arity| arity as usize);
    let triangles = if mesh.face_arities.is_empty() { mesh.indices.len() / 3 } else { 0 };
    let mut polygon = Vec::new();
    for arity in arities.chain(std::iter::repeat_n(3, triangles)) {
        polygon.clear();
        polygon.extend(corners.by_ref().take(arity));
        surface.polygon(&polygon)?;
    }
    Ok(())
}

/// What tobj found, and where: it reads one line at a time, and looks up indices at the end.
fn explain(error: LoadError, lines: &GeometryLines<'_>, bytes: &[u8]) -> ReadError {
    let line = lines.lines.number;
    let detail = match error {
        LoadError::FaceVertexOutOfBounds => return find_bad_index(bytes),
        LoadError::PositionParseError => format!("line {line} has no three numbers after its v"),
        LoadError::ScalingByZeroError => format!("the weight in line {line} is zero"),
        LoadError::FaceParseError => format!("a corner of the face in line {line} is no index"),
        _ => format!("line {line} breaks the rules"),
    };
    ReadError::Malformed { format: FORMAT, detail }
}

/// Looks for the face that made tobj fail. Indices count from 1, or back from the last vertex.
fn find_bad_index(bytes: &[u8]) -> ReadError {
    let vertices = Lines::new(bytes).filter(|line| line.keyword() == b"v").count();
    let mut so_far = 0;
    let mut face = 0;
    for line in Lines::new(bytes) {
        match line.keyword() {
            b"v" => so_far += 1,
            b"f" => {
                for index in line.corners().filter_map(parse::<i64>) {
                    let place = if index < 0 { so_far + index } else { index - 1 };
                    if !(0..vertices as i64).contains(&place) {
                        return ReadError::IndexOutOfRange { format: FORMAT, face, index, vertices };
                    }
                }
                face += 1;
            }
            _ => {}
        }
    }
    let detail = "a face refers to a vertex that is not there".to_owned();
    ReadError::Malformed { format: FORMAT, detail }
}

/// A line of the file, a backslash at its end joined with the next.
struct Line<'a> {
    text: &'a [u8],
}

impl<'a> Line<'a> {
    fn words(&self) -> impl Iterator<Item = &'a [u8]> + use<'a> {
        let text = self.text.split(|&byte| byte == b'#').next().unwrap_or_default();
        let is_space = |byte: &u8| byte.is_ascii_whitespace() || matches!(byte, b'\\' | 0x0b);
        text.split(is_space).filter(|word| !word.is_empty())
    }

    fn keyword(&self) -> &'a [u8] {
        self.words().next().unwrap_or_default()
    }

    /// The vertex indices of a face, without those of texture coordinates and normals.
    fn corners(&self) -> impl Iterator<Item = &'a [u8]> + use<'a> {
        self.words().skip(1).map(|word| word.split(|&byte| byte == b'/').next().unwrap_or_default())
    }
}

/// The lines of a file, whatever breaks them.
struct Lines<'a> {
    rest: &'a [u8],
    /// The number of the last line given out.
    number: usize,
}

impl<'a> Lines<'a> {
    fn new(bytes: &'a [u8]) -> Self {
        Lines { rest: bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes), number: 0 }
    }
}

impl<'a> Iterator for Lines<'a> {
    type Item = Line<'a>;

    fn next(&mut self) -> Option<Line<'a>> {
        if self.rest.is_empty() {
            return None;
        }
        let mut end = 0;
        loop {
            let tail = &self.rest[end..];
            let length = tail.iter().position(|byte| matches!(byte, b'\n' | b'\r')).unwrap_or(tail.len());
            let break_length = match tail[length..] {
                [b'\r', b'\n', ..] => 2,
                [_, ..] => 1,
                [] => 0,
            };
            end += length;
            self.number += 1;
            if break_length == 0 || !self.rest[..end].ends_with(b"\\") {
                let line = Line { text: &self.rest[..end] };
                self.rest = &self.rest[end + break_length..];
                return Some(line);
            }
            end += break_length;
        }
    }
}

/// A file as tobj sees it: positions and polygons without any other index, a line at a time.
struct GeometryLines<'a> {
    lines: Lines<'a>,
    limits: &'a Limits,
    vertices: usize,
    triangles: usize,
    /// The line being read, and how much of it was.
    line: Vec<u8>,
    read: usize,
    /// Why the last read failed.
    failure: Option<ReadError>,
}

impl<'a> GeometryLines<'a> {
    fn new(bytes: &'a [u8], limits: &'a Limits) -> Self {
        let lines = Lines::new(bytes);
        GeometryLines { lines, limits, vertices: 0, triangles: 0, line: Vec::new(), read: 0, failure: None }
    }

    /// Puts the next position or polygon into `self.line`; nothing at the end.
    fn advance(&mut self) -> Result<(), ReadError> {
        self.line.clear();
        self.read = 0;
        while let Some(line) = self.lines.next() {
            match line.keyword() {
                b"v" => {
                    self.vertices += 1;
                    // A fourth number alone is a weight; more are a colour.
                    let numbers = line.words().count() - 1;
                    self.put(b"v", line.words().skip(1).take(if numbers == 4 { 4 } else { 3 }));
                    return check_limit(FORMAT, "vertices", self.vertices, self.limits.vertices);
                }
                b"f" => {
                    let corners = line.corners().count();
                    if corners >= 3 {
                        self.triangles += corners - 2;
                        self.put(b"f", line.corners());
                        return check_limit(FORMAT, "triangles", self.triangles, self.limits.triangles);
                    }
                }
                _ => {}
            }
        }
        Ok(())
    }

    fn put<'w>(&mut self, keyword: &[u8], words: impl Iterator<Item = &'w [u8]>) {
        self.line.extend_from_slice(keyword);
        for word in words {
            self.line.push(b' ');
            self.line.extend_from_slice(word);
        }
        self.line.push(b'\n');
    }
}

impl BufRead for GeometryLines<'_> {
    fn fill_buf(&mut self) -> io::Result<&[u8]> {
        if self.read == self.line.len()
            && let Err(failure) = self.advance()
        {
            self.failure = Some(failure);
            return Err(io::Error::from(io::ErrorKind::InvalidData));
        }
        Ok(&self.line[self.read..])
    }

    fn consume(&mut self, amount: usize) {
        self.read += amount;
    }
}

impl Read for GeometryLines<'_> {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        let length = self.fill_buf()?.read(out)?;
        self.consume(length);
        Ok(length)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::format::{Hint, read};

    const LIMITS: Limits = Limits { vertices: 100, triangles: 100, decoded_bytes: 1000, expansion: 1 };

    fn obj(text: &[u8]) -> Result<TriangleMesh, ReadError> {
        let (mesh, format) = read(text, Hint::default(), &LIMITS)?;
        assert_eq!(format, Format::Obj);
        Ok(mesh)
    }

    const SQUARE: &[u8] = b"v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3\nf 1 3 4\n";

    #[test]
    fn variants_read_the_same() -> Result<(), ReadError> {
        let plain = obj(SQUARE)?;
        assert_eq!(plain.triangles, [[0, 1, 2], [0, 2, 3]]);
        for text in [
            &b"# \xe9\xff\nmtllib /etc/passwd\no a\nv 0 0 0 1 0 0\nv 1 0 0\nv 2 2 0 2 # w\nv 0 1 0\nusemtl b\nf 1/7/9 2//3 3/1 4\n"[..],
            b"v 0 0 0\r\nv 1 0 0\r\nvn 0 0 x\r\nv 1 1 0\r\nf -3 -2 \\\r\n  -1\r\nv 0 1 0\r\ng b\r\nf 1 3 4\r\nl 1 2\r\np 4",
            b"f 1 2 3 4\rv 0 0 0 0 0 0 1\rv 1 0 0\rv 1 1 0\rv 0 1 0\rv 5 5 5\rf 1\rf 1 2",
        ] {
            assert_eq!(obj(text)?, plain, "{}", String::from_utf8_lossy(text));
        }
        Ok(())
    }

    #[test]
    fn what_is_wrong_is_said() {
        for (text, code, says) in [
            ("v 0 0 0\nv 1 0\n", "malformed", "line 2"),
            ("v 0 0 0\n#\nv 1 0 x\n", "malformed", "line 3"),
            ("v 0 0 0 0\n", "malformed", "line 1"),
            ("v 0 0 0\nf 1 a 1\n", "malformed", "line 2"),
            ("v 0 0 0\nf 1 1 1\nf 1 2 1\n", "index-out-of-range", "face 1"),
            ("v 0 0 0\nf 1 1 1\nf 1 0 1\n", "index-out-of-range", "vertex 0"),
            ("v 0 0 0\nf 1 1 -2\n", "index-out-of-range", "vertex -2"),
            ("v 0 0 0\nf 1 1 -9223372036854775808\n", "index-out-of-range", "of 1"),
            ("v 0 0 0\nf 1 1 9223372036854775807\n", "index-out-of-range", "of 1"),
            ("v 0 0 inf\nf 1 1 1\n", "non-finite-coordinate", "vertex 0"),
            ("v 0 0 0\nl 1 1\n", "no-polygons", "no polygons"),
        ] {
            let error = obj(text.as_bytes()).unwrap_err();
            assert_eq!(error.code(), code, "{text}");
            assert!(error.to_string().contains(says), "{text}: {error}");
        }
        assert_eq!(obj(&SQUARE.repeat(26)).unwrap_err().code(), "too-large");
    }
}
