//! Which format some bytes are: by content first, by the sender's word where content leaves doubts.

use super::error::SEND_A_MESH;
use super::{Format, Hint, ReadError, off, stl};

/// How far to look for the first telling words of a text file.
const LOOK: usize = 64 * 1024;

/// The bytes that [`plainly_foreign`] looks at: a NIfTI image says what it is at byte 344.
pub const TELLING: usize = 512;

/// First words of an OBJ line; a comment is none, for other formats have those too.
const OBJ_WORDS: [&str; 14] =
    ["v", "vn", "vt", "vp", "f", "l", "p", "g", "o", "s", "mtllib", "usemtl", "mg", "cstype"];

/// The advice where the mesh is in what was found.
const UNPACK: &str = "unpack it first and send the mesh itself";
const NOT_UTF_16: &str = "save it as ASCII or UTF-8 and send the mesh itself";

/// # Errors
/// `Empty`, or `Unsupported` with what the bytes look like.
pub(super) fn sniff(bytes: &[u8], hint: Hint<'_>) -> Result<Format, ReadError> {
    if bytes.is_empty() {
        return Err(ReadError::Empty);
    }
    if let Some(format) = by_signature(bytes) {
        return Ok(format);
    }
    if let Some(error) = foreign(bytes) {
        return Err(error);
    }
    if has_obj_words(bytes) {
        return Ok(Format::Obj);
    }
    if begins_like_facets(bytes) {
        return Ok(Format::StlBinary);
    }
    by_hint(bytes, hint).ok_or_else(|| ReadError::Unsupported {
        found: if is_text(bytes) { "text of no known kind" } else { "data of no known kind" },
        advice: SEND_A_MESH,
    })
}

/// What a file that begins with `begin` is, when that is plainly no mesh, whatever follows.
///
/// `begin` has [`TELLING`] bytes, or is the whole file. A binary STL may begin with any text, so what goes on
/// like one is left to [`sniff`], as is XML, whose first words may be far behind.
pub fn plainly_foreign(begin: &[u8]) -> Option<ReadError> {
    let is_stl = stl::declared_facets(begin).is_some_and(|facets| facets > 0) && begins_like_facets(begin);
    if is_stl || skip_space(begin).starts_with(b"<") || by_signature(begin).is_some() {
        return None;
    }
    foreign(begin)
}

/// Formats that say what they are, or whose size does.
fn by_signature(bytes: &[u8]) -> Option<Format> {
    let facets = stl::declared_facets(bytes);
    if facets.is_some_and(|facets| bytes.len() == stl::PREAMBLE + facets * stl::FACET) {
        return Some(Format::StlBinary);
    }
    let text = skip_space(bytes);
    let starts = |word: &[u8]| text.get(..word.len()).is_some_and(|begin| begin.eq_ignore_ascii_case(word));
    if bytes.starts_with(b"glTF") {
        Some(Format::Glb)
    } else if text.starts_with(b"ply\n") || text.starts_with(b"ply\r") || text.starts_with(b"ply ") {
        Some(Format::Ply)
    } else if starts(b"# vtk DataFile") {
        Some(Format::Vtk)
    } else if text.starts_with(b"<") && contains(head(text), b"<VTKFile") {
        Some(Format::Vtp)
    } else if text.starts_with(b"{") {
        Some(Format::Gltf)
    } else if starts(b"solid") {
        Some(if is_ascii_stl(text) { Format::StlAscii } else { Format::StlBinary })
    } else if off::has_keyword(text) {
        Some(Format::Off)
    } else {
        None
    }
}

/// Binary files may begin with "solid" too: then no facet follows in words.
fn is_ascii_stl(text: &[u8]) -> bool {
    let head = head(text).to_ascii_lowercase();
    contains(&head, b"facet") || contains(&head, b"endsolid") || text.len() < stl::PREAMBLE || is_text(&head)
}

/// Other files that people send by mistake, named so that the answer helps.
fn foreign(bytes: &[u8]) -> Option<ReadError> {
    const SIGNATURES: [(&[u8], &str); 16] = [
        (b"\x89PNG", "a PNG picture"),
        (b"\xff\xd8\xff", "a JPEG picture"),
        (b"GIF8", "a GIF picture"),
        (b"II*\0", "a TIFF picture"),
        (b"MM\0*", "a TIFF picture"),
        (b"%PDF", "a PDF document"),
        (b"PK\x03\x04", "a ZIP archive (or a 3MF file, or an office document)"),
        (b"\x89HDF", "an HDF5 file"),
        (b"NRRD", "an NRRD image"),
        (b"ObjectType", "a MetaImage header"),
        (b"Kaydara FBX", "an FBX scene"),
        (b"BLENDER", "a Blender scene"),
        (b"ISO-10303", "a STEP model"),
        (b"\x7fELF", "an executable program"),
        (b"<!DOCTYPE", "a web page"),
        (b"<html", "a web page"),
    ];
    // A mesh may be in them.
    const WRAPPINGS: [(&[u8], &str, &str); 8] = [
        (b"\x1f\x8b", "gzip-compressed data", UNPACK),
        (b"BZh", "bzip2-compressed data", UNPACK),
        (b"\xfd7zXZ", "xz-compressed data", UNPACK),
        (b"\x28\xb5\x2f\xfd", "zstd-compressed data", UNPACK),
        (b"7z\xbc\xaf", "a 7z archive", UNPACK),
        (b"Rar!", "a RAR archive", UNPACK),
        (b"\xff\xfe", "UTF-16 text", NOT_UTF_16),
        (b"\xfe\xff", "UTF-16 text", NOT_UTF_16),
    ];
    let other = |found| Some(ReadError::Unsupported { found, advice: SEND_A_MESH });
    let text = skip_space(bytes);
    let begins = |signature: &[u8]| {
        bytes.starts_with(signature)
            || text.get(..signature.len()).is_some_and(|begin| begin.eq_ignore_ascii_case(signature))
    };
    if let Some(&(_, found, advice)) = WRAPPINGS.iter().find(|(signature, ..)| begins(signature)) {
        return Some(ReadError::Unsupported { found, advice });
    }
    if let Some((_, found)) = SIGNATURES.iter().find(|(signature, _)| begins(signature)) {
        return other(found);
    }
    if bytes.get(128..132) == Some(b"DICM") {
        return other("a DICOM file");
    }
    if matches!(bytes.get(344..348), Some(b"n+1\0" | b"ni1\0")) {
        return other("a NIfTI image");
    }
    if text.starts_with(b"<") { other("XML other than VTK's") } else { None }
}

fn has_obj_words(bytes: &[u8]) -> bool {
    let lines = skip_space(bytes).split(|byte| matches!(byte, b'\n' | b'\r'));
    let mut words = lines.filter_map(|line| {
        line.split(u8::is_ascii_whitespace).find(|word| !word.is_empty()).filter(|word| word[0] != b'#')
    });
    words.next().is_some_and(|word| OBJ_WORDS.iter().any(|known| known.as_bytes() == word))
}

/// A binary STL cut short, or with a wrong count: its first facet still has a unit or zero normal.
fn begins_like_facets(bytes: &[u8]) -> bool {
    let Some(facet) = bytes.get(stl::PREAMBLE..stl::PREAMBLE + stl::FACET) else { return false };
    let mut numbers = facet.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]));
    let normal: f32 = numbers.by_ref().take(3).map(|number| number * number).sum();
    let is_normal = normal == 0.0 || (0.98..1.02).contains(&normal);
    is_normal && numbers.all(|number| number == 0.0 || (1e-9..1e9).contains(&number.abs()))
}

fn by_hint(bytes: &[u8], hint: Hint<'_>) -> Option<Format> {
    let extension = hint.extension.map(|text| text.trim_start_matches('.').to_ascii_lowercase());
    let named = match extension.as_deref() {
        Some("stl") => Some(Format::StlBinary),
        Some("obj") => Some(Format::Obj),
        Some("ply") => Some(Format::Ply),
        Some("gltf") => Some(Format::Gltf),
        Some("glb") => Some(Format::Glb),
        Some("vtp") => Some(Format::Vtp),
        Some("vtk") => Some(Format::Vtk),
        Some("off") => Some(Format::Off),
        _ => None,
    };
    let format = named.or_else(|| by_content_type(hint.content_type?))?;
    let is_ascii_stl = format == Format::StlBinary && is_text(bytes);
    Some(if is_ascii_stl { Format::StlAscii } else { format })
}

fn by_content_type(content_type: &str) -> Option<Format> {
    let essence = content_type.split(';').next()?.trim().to_ascii_lowercase();
    match essence.as_str() {
        "model/stl"
        | "model/x.stl-binary"
        | "model/x.stl-ascii"
        | "application/sla"
        | "application/vnd.ms-pki.stl" => Some(Format::StlBinary),
        "model/obj" => Some(Format::Obj),
        "model/ply" => Some(Format::Ply),
        "model/gltf+json" => Some(Format::Gltf),
        "model/gltf-binary" => Some(Format::Glb),
        "model/vtk" => Some(Format::Vtk),
        "model/off" => Some(Format::Off),
        _ => None,
    }
}

fn head(bytes: &[u8]) -> &[u8] {
    &bytes[..bytes.len().min(LOOK)]
}

fn contains(bytes: &[u8], word: &[u8]) -> bool {
    bytes.windows(word.len()).any(|window| window == word)
}

/// Without a byte order mark and leading white space.
fn skip_space(bytes: &[u8]) -> &[u8] {
    bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes).trim_ascii_start()
}

/// No control characters but white space near the beginning.
fn is_text(bytes: &[u8]) -> bool {
    let begin = &bytes[..bytes.len().min(1024)];
    begin.iter().all(|&byte| byte >= 0x20 && byte != 0x7f || byte.is_ascii_whitespace())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn hint<'a>(extension: &'a str, content_type: &'a str) -> Hint<'a> {
        let some = |text: &'a str| (!text.is_empty()).then_some(text);
        Hint { extension: some(extension), content_type: some(content_type) }
    }

    #[test]
    fn content_decides_over_the_hint() {
        for (bytes, format) in [
            (&b"ply\nformat ascii 1.0\n"[..], Format::Ply),
            (b"\xef\xbb\xbf\r\n  {\"asset\":{}}", Format::Gltf),
            (b"glTF\x02\0\0\0", Format::Glb),
            (b"# vtk DataFile Version 3.0\n", Format::Vtk),
            (b"<?xml version=\"1.0\"?>\n<VTKFile type=\"PolyData\">", Format::Vtp),
            (b"SOLID A\nFACET NORMAL 0 0 1\n", Format::StlAscii),
            (b"solid\nendsolid\n", Format::StlAscii),
            (b"STCNOFF\n0 0 0\n", Format::Off),
            (b"# comment\n\n  # another\nmtllib a\nv 0 0 0\n", Format::Obj),
        ] {
            assert_eq!(sniff(bytes, hint("stl", "model/ply")), Ok(format));
            assert_eq!(sniff(bytes, Hint::default()), Ok(format));
        }
    }

    #[test]
    fn a_binary_stl_is_known_by_its_size_or_by_its_first_facet() {
        let mut bytes = vec![0; 84 + 50];
        bytes[..5].copy_from_slice(b"solid");
        bytes[80] = 1;
        assert_eq!(sniff(&bytes, Hint::default()), Ok(Format::StlBinary));
        // A wrong count, and a header that is no text.
        bytes[80] = 2;
        assert_eq!(sniff(&bytes, Hint::default()), Ok(Format::StlBinary));
        bytes[..5].copy_from_slice(b"\0\x01MESH"[..5].as_ref());
        bytes[84..88].copy_from_slice(&1.0f32.to_le_bytes());
        assert_eq!(sniff(&bytes, Hint::default()), Ok(Format::StlBinary));
        bytes[84..88].copy_from_slice(&1e20f32.to_le_bytes());
        assert!(sniff(&bytes, Hint::default()).is_err());
        assert_eq!(sniff(&bytes, hint(".STL", "")), Ok(Format::StlBinary));
        assert_eq!(sniff(&bytes, hint("", "Model/STL; charset=x")), Ok(Format::StlBinary));
    }

    #[test]
    fn hints_decide_doubts() {
        assert_eq!(sniff(b"8 6 12\n0 0 0\n", hint("off", "application/octet-stream")), Ok(Format::Off));
        assert_eq!(sniff(b"# only a comment\n", hint("", "model/obj")), Ok(Format::Obj));
        assert_eq!(sniff(b"facet normal 0 0 1\n", hint("stl", "")), Ok(Format::StlAscii));
        assert!(sniff(b"8 6 12\n0 0 0\n", hint("", "text/plain")).is_err());
    }

    #[test]
    fn other_files_are_named() {
        let dicom = [&[0; 128][..], b"DICM", &[0; 400]].concat();
        for (bytes, found) in [
            (&b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR"[..], "PNG"),
            (b"%PDF-1.7\n", "PDF"),
            (b"PK\x03\x04", "ZIP"),
            (b"\x1f\x8b\x08", "gzip"),
            (&dicom, "DICOM"),
            (b"\xff\xfes\0o\0l\0i\0d\0", "UTF-16"),
            (b"<!doctype html><html>", "web page"),
            (b"<?xml version=\"1.0\"?><COLLADA>", "XML"),
            (b"Dear colleague,\n", "text"),
            (b"\x01\x02\x03", "data of no known kind"),
        ] {
            let error = sniff(bytes, hint("stl", "model/stl")).err();
            let error = error.or_else(|| sniff(bytes, Hint::default()).err());
            let text = error.map(|error| error.to_string()).unwrap_or_default();
            assert!(text.contains(found), "{text}");
        }
        assert_eq!(sniff(b"", hint("stl", "")), Err(ReadError::Empty));
    }

    #[test]
    fn what_is_plainly_no_mesh_is_known_by_its_beginning() {
        let dicom = [&[0; 128][..], b"DICM", &[0; 400]].concat();
        let nifti = [&[92, 1, 0, 0][..], &[0; 340], b"n+1\0", &[0; 200]].concat();
        for bytes in [
            &b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR"[..],
            b"%PDF-1.7\n",
            b"PK\x03\x04",
            b"\x1f\x8b\x08",
            &dicom,
            &nifti,
        ] {
            let long: Vec<u8> = bytes.iter().copied().chain([7; TELLING]).take(TELLING).collect();
            assert!(matches!(plainly_foreign(&long), Some(ReadError::Unsupported { .. })), "{bytes:?}");
        }
        let mut stl = b"PK\x03\x04 is how the name in this header begins".to_vec();
        stl.resize(80, b' ');
        stl.extend([9, 0, 0, 0]);
        stl.extend([0.0_f32, 0.0, 1.0].iter().chain(&[0.5; 9]).flat_map(|number| number.to_le_bytes()));
        stl.resize(TELLING, 0);
        for bytes in [
            &stl[..],
            b"",
            b"solid",
            b"v 0 0 0\n",
            b"# a comment\n",
            b"<?xml version=\"1.0\"?>",
            b"{\"asset\":",
            b"glTF\x02\0\0\0",
            b"8 6 12\n0 0 0\n",
            b"Dear colleague,\n",
            b"\x01\x02\x03",
        ] {
            assert_eq!(plainly_foreign(bytes), None, "{bytes:?}");
        }
    }
}
