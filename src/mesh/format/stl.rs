//! STL, binary and ASCII (3D Systems, *StereoLithography Interface Specification*, 1989).
//!
//! Own reader: `stl_io` drops a second `solid`, rejects upper-case ASCII and keeps
//! only `f32`. Facet normals are not read; the winding of the corners decides.

use std::io::{self, Write};

use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

use super::surface::{Soup, check_limit};
use super::text::Tokens;
use super::{Format, Limits, ReadError};
use crate::mesh::TriangleMesh;

/// Bytes before the first facet: a free header and the number of facets.
pub(super) const PREAMBLE: usize = 84;
/// Bytes of a facet: normal, three corners, attribute.
pub(super) const FACET: usize = 50;

/// The number of facets that the preamble declares, where there is a preamble.
pub(super) fn declared_facets(bytes: &[u8]) -> Option<usize> {
    let count = bytes.get(80..PREAMBLE)?;
    Some(u32::from_le_bytes([count[0], count[1], count[2], count[3]]) as usize)
}

pub(super) fn read_binary(bytes: &[u8], limits: &Limits) -> Result<TriangleMesh, ReadError> {
    let format = Format::StlBinary;
    let facets = declared_facets(bytes).ok_or_else(|| ReadError::Truncated {
        format,
        detail: format!("it has {} bytes where the header alone has {PREAMBLE}", bytes.len()),
    })?;
    check_limit(format, "triangles", facets, limits.triangles)?;
    let body = &bytes[PREAMBLE..];
    let present = body.len() / FACET;
    if facets > present {
        let detail = format!("it declares {facets} facets and holds {present}");
        return Err(ReadError::Truncated { format, detail });
    }
    if facets < present {
        let detail = format!("it declares {facets} facets and holds {present}");
        return Err(ReadError::Malformed { format, detail });
    }
    read_facets(body, limits)
}

/// Facets that are welded among themselves first: their vertices stay in a core's cache.
const PART: usize = 1 << 13;
/// Parts that are in memory at a time for each thread, beside those before.
const PARTS: usize = 2;

/// The facets part by part, many at once; the same surface as one after the other.
fn read_facets(body: &[u8], limits: &Limits) -> Result<TriangleMesh, ReadError> {
    let part = |(number, facets): (usize, &[u8])| {
        let mut soup = Soup::after(PART * number, Format::StlBinary, limits, facets.len() / FACET);
        for facet in facets.chunks_exact(FACET) {
            soup.triangle([corner(facet, 12), corner(facet, 24), corner(facet, 36)])?;
        }
        Ok(soup)
    };
    let parts: Vec<(usize, &[u8])> = body.chunks(PART * FACET).enumerate().collect();
    if let [alone] = parts[..] {
        return part(alone)?.finish();
    }
    let mut whole = Soup::new(Format::StlBinary, limits, body.len() / FACET);
    let mut read: Vec<Result<Soup<'_>, ReadError>> = Vec::new();
    // What was read is joined while the next is read.
    for group in parts.chunks(PARTS * rayon::current_num_threads()).chain([&[][..]]) {
        let join = || read.drain(..).try_for_each(|soup| whole.append(soup?));
        let read_next = || group.par_iter().map(|&facets| part(facets)).collect();
        let (joined, next) = rayon::join(join, read_next);
        joined?;
        read = next;
    }
    whole.finish()
}

fn corner(facet: &[u8], at: usize) -> [f64; 3] {
    [at, at + 4, at + 8]
        .map(|at| f64::from(f32::from_le_bytes([facet[at], facet[at + 1], facet[at + 2], facet[at + 3]])))
}

pub(super) fn read_ascii(bytes: &[u8], limits: &Limits) -> Result<TriangleMesh, ReadError> {
    let format = Format::StlAscii;
    // The shortest facet with its line breaks; makes room without trusting anything.
    let mut soup = Soup::new(format, limits, (bytes.len() / 250).min(limits.triangles));
    let mut tokens = Tokens::new(format, bytes);
    loop {
        tokens.skip_padding();
        if tokens.is_at_end() {
            return soup.finish();
        }
        tokens.expect("solid")?;
        skip_name(&mut tokens);
        loop {
            while !tokens.take_if("endsolid")? {
                soup.triangle(read_facet(&mut tokens)?)?;
            }
            skip_name(&mut tokens);
            if !tokens.is_at(b"facet normal") {
                break;
            }
        }
    }
}

/// A name ends with its line, or where the next part begins in a file without line breaks.
fn skip_name(tokens: &mut Tokens<'_>) {
    while !tokens.is_at_line_end() && !tokens.is_at(b"facet normal") && !tokens.is_at(b"endsolid") {
        tokens.advance(1);
    }
}

fn read_facet(tokens: &mut Tokens<'_>) -> Result<[[f64; 3]; 3], ReadError> {
    tokens.expect("facet")?;
    tokens.expect("normal")?;
    // Whatever the normal is, even "-nan(ind)": it is not used.
    for _ in 0..3 {
        tokens.next()?;
    }
    tokens.expect("outer")?;
    tokens.expect("loop")?;
    let mut corners = [[0.0; 3]; 3];
    for corner in &mut corners {
        tokens.expect("vertex")?;
        *corner = [tokens.number()?, tokens.number()?, tokens.number()?];
    }
    tokens.expect("endloop")?;
    tokens.expect("endfacet")?;
    Ok(corners)
}

/// Writes a mesh as binary STL, coordinates rounded to `f32`, normals from the winding.
///
/// # Errors
/// What `out` answers, and `InvalidInput` for more than 2^32 - 1 triangles.
///
/// # Panics
/// When a triangle's index is out of range.
pub fn write_stl_binary(mesh: &TriangleMesh, out: &mut impl Write) -> io::Result<()> {
    let facets = u32::try_from(mesh.triangles.len()).map_err(|_| {
        io::Error::new(io::ErrorKind::InvalidInput, "binary STL counts its facets in 32 bits")
    })?;
    let mut header = [0; 80];
    header[..8].copy_from_slice(b"rosaline");
    out.write_all(&header)?;
    out.write_all(&facets.to_le_bytes())?;
    for triangle in &mesh.triangles {
        out.write_all(&facet_bytes(triangle.map(|index| mesh.vertices[index as usize])))?;
    }
    Ok(())
}

fn facet_bytes(corners: [Point3<f64>; 3]) -> [u8; FACET] {
    let cross = (corners[1] - corners[0]).cross(&(corners[2] - corners[0]));
    let normal = cross.try_normalize(0.0).unwrap_or_else(Vector3::zeros);
    let mut facet = [0; FACET];
    let vectors = [normal, corners[0].coords, corners[1].coords, corners[2].coords];
    let numbers = vectors.iter().flat_map(|vector| vector.iter());
    for (bytes, number) in facet.chunks_exact_mut(4).zip(numbers) {
        bytes.copy_from_slice(&(*number as f32).to_le_bytes());
    }
    facet
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::format::{Hint, ReadErrorKind, read};

    const LIMITS: Limits = Limits { vertices: 100, triangles: 100, decoded_bytes: 1000, expansion: 1 };

    fn ascii(text: &str) -> Result<TriangleMesh, ReadError> {
        let (mesh, format) = read(text.as_bytes(), Hint::default(), &LIMITS)?;
        assert_eq!(format, Format::StlAscii);
        Ok(mesh)
    }

    fn facet(corners: &str) -> String {
        let vertices: String = corners.split(',').map(|corner| format!("vertex {corner}\n")).collect();
        format!("facet normal -nan(ind) 0 0\nouter loop\n{vertices}endloop\nendfacet\n")
    }

    #[test]
    fn several_solids_are_one_mesh() -> Result<(), ReadError> {
        let one = facet("0 0 0,1 0 0,0 1 0");
        let two = facet("1 0 0,1 1 0,-0 1 0");
        let mesh = ascii(&format!("solid a facet of b\n{one}endsolid a\n\nsolid\n{two}endsolid solid\n\0"))?;
        assert_eq!(mesh.triangles, [[0, 1, 2], [1, 3, 2]]);
        assert_eq!(mesh.vertices.len(), 4);
        Ok(())
    }

    #[test]
    fn case_and_line_breaks_do_not_matter() -> Result<(), ReadError> {
        let text =
            format!("solid x y\n{}{}endsolid x y\n", facet("0 0 0,1 0 0,0 1 0"), facet("0 0 0,1 0 0,0 0 1"));
        let plain = ascii(&text)?;
        assert_eq!(plain.triangles.len(), 2);
        assert_eq!(ascii(&text.to_uppercase())?, plain);
        assert_eq!(ascii(&text.replace('\n', "\r"))?, plain);
        assert_eq!(ascii(&text.replace('\n', "\r\n"))?, plain);
        let one_line = text.replace('\n', " ");
        assert_eq!(ascii(&one_line)?, plain);
        assert_eq!(ascii(&format!("{text}{one_line}"))?.triangles.len(), 4);
        assert_eq!(ascii(&format!("{one_line}{one_line}"))?.triangles.len(), 4);
        Ok(())
    }

    #[test]
    fn broken_text_says_where() {
        let whole = format!("solid\n{}endsolid\n", facet("0 0 0,1 0 0,0 1 0"));
        let cut = ascii(&whole[..whole.len() - 12]).unwrap_err();
        assert_eq!(cut.code(), "truncated");
        let comma = ascii(&whole.replace("1 0 0", "1,5 0 0")).unwrap_err();
        assert!(comma.to_string().contains("line 5"), "{comma}");
        let infinite = ascii(&whole.replace("1 0 0", "1 0 1e999")).unwrap_err();
        assert_eq!(infinite.kind(), ReadErrorKind::Unprocessable);
        let empty = ascii("solid nothing\nendsolid nothing\n").unwrap_err();
        assert_eq!(empty.code(), "no-polygons");
    }

    #[test]
    fn a_written_mesh_reads_back_even_with_solid_in_its_header() -> Result<(), Box<dyn std::error::Error>> {
        let mesh = ascii(&format!("solid\n{}endsolid\n", facet("0 0 0,2 0 0,0 0.5 -3")))?;
        let mut bytes = Vec::new();
        write_stl_binary(&mesh, &mut bytes)?;
        assert_eq!(read(&bytes, Hint::default(), &LIMITS)?, (mesh.clone(), Format::StlBinary));
        bytes[..80].copy_from_slice(&[b' '; 80]);
        bytes[..10].copy_from_slice(b"solid body");
        assert_eq!(read(&bytes, Hint::default(), &LIMITS)?, (mesh, Format::StlBinary));
        Ok(())
    }

    /// A strip of so many triangles, each two facets apart from those that it shares an edge with.
    fn strip(facets: u32) -> Vec<u8> {
        let corner = |k: u32| [k as f32, (k % 2) as f32, (k / 3) as f32];
        let mut bytes = vec![0; 80];
        bytes.extend(facets.to_le_bytes());
        for k in 0..facets {
            let first = if k < facets / 2 { 2 * k } else { 2 * (facets - k) - 1 };
            let corners = [first, first + 1, first + 2].map(corner);
            bytes.extend([0; 12]);
            bytes.extend(corners.iter().flatten().flat_map(|number| number.to_le_bytes()));
            bytes.extend([0; 2]);
        }
        bytes
    }

    #[test]
    fn parts_make_the_mesh_that_one_after_the_other_makes() -> Result<(), ReadError> {
        let facets = 10 * PART + 17;
        let bytes = strip(facets as u32);
        let unbound = Limits::default();
        let mut soup = Soup::new(Format::StlBinary, &unbound, 0);
        for facet in bytes[PREAMBLE..].chunks_exact(FACET) {
            soup.triangle([corner(facet, 12), corner(facet, 24), corner(facet, 36)])?;
        }
        let expected = soup.finish()?;
        for threads in [1, 3] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let limits = Limits { vertices: facets + 4, triangles: facets, ..LIMITS };
            assert_eq!(pool.install(|| read_binary(&bytes, &limits))?, expected);
        }
        Ok(())
    }

    #[test]
    fn what_is_wrong_in_a_later_part_is_told_where_it_is() {
        let facets = 3 * PART;
        let limits = Limits { vertices: facets + 4, triangles: facets, ..LIMITS };
        let mut bytes = strip(facets as u32);
        let few = Limits { vertices: 2 * PART, ..limits };
        let told = read_binary(&bytes, &few).unwrap_err();
        assert!(matches!(told, ReadError::TooLarge { what: "vertices", .. }), "{told}");
        let (facet, place) = (2 * PART + 5, 1);
        bytes[PREAMBLE + FACET * facet + 12 + 12 * place..][..4].copy_from_slice(&f32::NAN.to_le_bytes());
        let told = read_binary(&bytes, &limits).unwrap_err();
        assert!(matches!(told, ReadError::NonFinite { vertex, .. } if vertex == 3 * facet + place), "{told}");
    }

    #[test]
    fn counts_that_lie_are_errors() {
        let mut bytes = vec![0; PREAMBLE + 2 * FACET];
        for (count, code) in [(3, "truncated"), (1, "malformed"), (u32::MAX, "too-large")] {
            bytes[80..84].copy_from_slice(&count.to_le_bytes());
            assert_eq!(read(&bytes, Hint::default(), &LIMITS).unwrap_err().code(), code);
        }
    }
}
