//! VTP and legacy VTK: what their rules allow beyond what VTK itself writes, and what is refused.
#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use rosaline::mesh::TriangleMesh;
use rosaline::mesh::format::{Format, Hint, Limits, ReadError, ReadErrorKind, read};

fn vtp(text: &str) -> Result<TriangleMesh, ReadError> {
    let (mesh, format) = read(text.as_bytes(), Hint::default(), &Limits::default())?;
    assert_eq!(format, Format::Vtp);
    Ok(mesh)
}

/// A file of one piece: a square of two triangles.
fn file(attributes: &str, points: &str, connectivity: &str, offsets: &str) -> String {
    format!(
        "<?xml version=\"1.0\"?>\n<!-- made by hand -->\n<VTKFile type=\"PolyData\" {attributes}><PolyData>\n\
         <Piece NumberOfPoints=\" 4 \" NumberOfPolys=\"2\"><PointData><DataArray type=\"Strange\">x</DataArray></PointData>\n\
         <Points><DataArray type=\"Float64\" NumberOfComponents=\"3\" {points}</DataArray></Points>\n\
         <Polys><DataArray type=\"Int32\" Name=\"connectivity\" {connectivity}</DataArray>\n\
         <DataArray type=\"UInt8\" Name=\"offsets\" {offsets}</DataArray></Polys>\n\
         </Piece></PolyData></VTKFile>\n"
    )
}

const POINTS: &str = "format=\"ascii\">0 0 0 1 0 0\n1 1 0 0 1 0";
const CORNERS: &str = "format=\"ascii\">0 1 2 0 2 3";
const ENDS: &str = "format=\"ascii\">3 6";

fn bytes_of_points() -> Vec<u8> {
    let numbers = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.0, 0.0f64];
    numbers.iter().flat_map(|number| number.to_le_bytes()).collect()
}

#[test]
fn variants_of_text_and_base64_read_the_same() {
    let plain = vtp(&file("", POINTS, CORNERS, ENDS)).unwrap();
    assert_eq!(plain.triangles, [[0, 1, 2], [0, 2, 3]]);
    let count = 96u32.to_le_bytes();
    let data = bytes_of_points();
    let together = STANDARD.encode([&count[..], &data].concat());
    let (left, right) = together.split_at(20);
    let unpadded = together.trim_end_matches('=');
    for points in [
        format!("format=\"binary\">{together}"),
        format!("format=\"binary\">\n {left}\n  {right}\n"),
        format!("format=\"binary\">{unpadded}"),
        format!("format=\"binary\">{}{}", STANDARD.encode(count), STANDARD.encode(&data)),
        format!("format=\"ascii\"><InformationKey><Value> 7 </Value></InformationKey>{}", &POINTS[15..]),
    ] {
        assert_eq!(vtp(&file("", &points, CORNERS, ENDS)).unwrap(), plain, "{points}");
    }
    let leading_zero = "format=\"ascii\">0 3 6";
    assert_eq!(vtp(&file("", POINTS, CORNERS, leading_zero)).unwrap(), plain);
    let named = file("", POINTS, CORNERS, ENDS).replace("by hand", "by M\u{fc}ller");
    let latin: Vec<u8> = named.chars().map(|letter| letter as u8).collect();
    assert_eq!(read(&latin, Hint::default(), &Limits::default()).unwrap().0, plain);
}

#[test]
fn pieces_are_welded_and_indices_stay_in_their_piece() {
    let one = file("", POINTS, CORNERS, ENDS);
    let (start, end) = (one.find("<Piece").unwrap(), one.find("</PolyData>").unwrap());
    let piece = &one[start..end];
    let moved = piece.replace("0 0 0 1 0 0\n1 1 0 0 1 0", "1 0 0 2 0 0 2 1 0 1 1 0");
    let two = |second: &str| format!("{}{second}{}", &one[..end], &one[end..]);
    let mesh = vtp(&two(&moved)).unwrap();
    assert_eq!(mesh.vertices.len(), 6);
    assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3], [1, 4, 5], [1, 5, 2]]);
    for corner in ["-1", "4"] {
        let error = vtp(&two(&moved.replace("0 1 2 0 2 3", &format!("0 1 2 0 2 {corner}")))).unwrap_err();
        assert_eq!(error.code(), "index-out-of-range");
    }
}

#[test]
fn broken_vtp_files_are_typed_errors() {
    let good = file("", POINTS, CORNERS, ENDS);
    for (from, to, code) in [
        ("0 1 2 0 2 3", "0 1 2 0 2 9", "index-out-of-range"),
        ("0 1 2 0 2 3", "0 1 2 0 2", "truncated"),
        ("0 1 2 0 2 3", "0 1 2 0 2 3 0", "malformed"),
        ("3 6", "3 2", "malformed"),
        ("3 6", "3", "truncated"),
        ("3 6", "3 6 9 12", "malformed"),
        ("3 6", "3 9223372036854775807", "truncated"),
        ("1 1 0 0 1 0", "1 1 0 0 1", "truncated"),
        ("1 1 0 0 1 0", "1 1 0 0 1 nan", "non-finite-coordinate"),
        ("1 1 0 0 1 0", "1 1 0 0 1,0", "malformed"),
        ("=\" 4 \"", "=\"5\"", "truncated"),
        ("=\" 4 \"", "=\"3\"", "malformed"),
        ("=\" 4 \"", "=\"four\"", "malformed"),
        ("=\" 4 \"", "=\"1000000000000\"", "too-large"),
        ("NumberOfPolys=\"2\"", "NumberOfPolys=\"1000000000000\"", "too-large"),
        ("NumberOfPolys=\"2\"", "NumberOfPolys=\"30000000\"", "truncated"),
        ("NumberOfPolys=\"2\"", "NumberOfLines=\"2\"", "no-polygons"),
        ("Int32", "Float32", "malformed"),
        ("Float64", "String", "malformed"),
        ("\"ascii\">0 0", "\"appended\">0 0", "malformed"),
        ("\"ascii\">0 0", "\"appended\" offset=\"0\">0 0", "malformed"),
        ("\"ascii\">0 0", "\"binary\">0 0", "truncated"),
        ("\"ascii\">0 0", "\"wrong\">0 0", "malformed"),
        ("<Points>", "<Point>", "malformed"),
        ("connectivity", "adjacency", "malformed"),
        ("type=\"PolyData\"", "type=\"UnstructuredGrid\"", "unsupported-format"),
        ("</VTKFile>", "", "truncated"),
    ] {
        assert!(good.contains(from), "{from}");
        let error = vtp(&good.replacen(from, to, 1)).unwrap_err();
        assert_eq!(error.code(), code, "{from} -> {to}: {error}");
    }
    for length in (good.find("<VTKFile").unwrap() + 9..good.len() - 1).step_by(7) {
        assert_eq!(vtp(&good[..length]).unwrap_err().code(), "truncated", "{length}");
    }
}

/// Points as one compressed block that declares itself, and the file, larger than they are.
fn compressed(blocks: u32, block: u32, last: u32, packed: u32) -> String {
    let mut encoder = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::default());
    std::io::Write::write_all(&mut encoder, &bytes_of_points()).unwrap();
    let data = encoder.finish().unwrap();
    let packed = if packed == 0 { data.len() as u32 } else { packed };
    let header: Vec<u8> = [blocks, block, last, packed].iter().flat_map(|word| word.to_le_bytes()).collect();
    let points = format!("format=\"binary\">{}{}", STANDARD.encode(header), STANDARD.encode(data));
    file("compressor=\"vtkZLibDataCompressor\"", &points, CORNERS, ENDS)
}

#[test]
fn compressed_arrays_that_lie_are_refused_before_anything_is_allocated() {
    assert_eq!(vtp(&compressed(1, 96, 0, 0)).unwrap().triangles.len(), 2);
    assert_eq!(vtp(&compressed(1, 32768, 96, 0)).unwrap().triangles.len(), 2);
    for (blocks, block, last, packed) in [
        (1, 95, 0, 0),
        (1, 97, 0, 0),
        (1, 0, 0, 0),
        (1, 96, 97, 0),
        (1, 1_000_000_000, 0, 0),
        (1, 96, 0, 5),
        (0, 96, 0, 0),
    ] {
        let error = vtp(&compressed(blocks, block, last, packed)).unwrap_err();
        assert_eq!(error.code(), "malformed", "{blocks} {block} {last} {packed}: {error}");
    }
    assert_eq!(vtp(&compressed(1, 96, 0, 1000)).unwrap_err().code(), "truncated");
    assert_eq!(vtp(&compressed(1_000_000_000, 96, 0, 0)).unwrap_err().code(), "truncated");
    assert_eq!(vtp(&compressed(u32::MAX, u32::MAX, 0, 0)).unwrap_err().code(), "truncated");
    let limits = Limits { decoded_bytes: 95, ..Limits::default() };
    let error = read(compressed(1, 96, 0, 0).as_bytes(), Hint::default(), &limits).unwrap_err();
    assert_eq!(error.kind(), ReadErrorKind::TooLarge);
}

fn vtk(text: &[u8]) -> Result<TriangleMesh, ReadError> {
    let (mesh, format) = read(text, Hint::default(), &Limits::default())?;
    assert_eq!(format, Format::Vtk);
    Ok(mesh)
}

const LEGACY: &str = "# vtk DataFile Version 3.0\nName of a patient\nASCII\nDATASET POLYDATA\n\
    FIELD FieldData 2\nA 1 2 double\n0 1\nB 2 1 int\n5 6\nMETADATA\nINFORMATION 1\nNAME x\n\n\
    POINTS 4 float\n0 0 0 1 0 0\n1 1 0 0 1 0\nVERTICES 1 2\n1 0\nLINES 1 3\n2 0 1\n\
    POLYGONS 2 8\n3 0 1 2\n3 0 2 3\nCELL_DATA 4\nSCALARS s float\nLOOKUP_TABLE default\n1 2 3 4\n";

const OFFSETS: &str = "# vtk DataFile Version 5.1\nName\nASCII\nDATASET POLYDATA\nPOINTS 4 float\n\
    0 0 0 1 0 0 1 1 0 0 1 0\nPOLYGONS 3 6\nOFFSETS vtktypeint64\n0 3 6\nCONNECTIVITY vtktypeint64\n0 1 2 0 2 3\n";

#[test]
fn both_layouts_of_legacy_files_read_the_same() {
    let plain = vtk(LEGACY.as_bytes()).unwrap();
    assert_eq!(plain.triangles, [[0, 1, 2], [0, 2, 3]]);
    assert_eq!(vtk(OFFSETS.as_bytes()).unwrap(), plain);
    assert_eq!(vtk(LEGACY.replace('\n', "\r\n").as_bytes()).unwrap(), plain);
    let strip = LEGACY.replace("POLYGONS 2 8\n3 0 1 2\n3 0 2 3", "TRIANGLE_STRIPS 1 5\n4 1 2 0 3");
    assert_eq!(vtk(strip.as_bytes()).unwrap().triangles, [[1, 2, 0], [0, 2, 3]]);
}

#[test]
fn texts_in_field_data_are_passed_over() {
    let plain = vtk(LEGACY.as_bytes()).unwrap();
    let texts = LEGACY.replace("FieldData 2\n", "FieldData 3\nC 1 3 string\na%20name\n\nPOINTS 7\n");
    assert_eq!(vtk(texts.as_bytes()).unwrap(), plain);
    assert_eq!(vtk(texts.replace('\n', "\r\n").as_bytes()).unwrap(), plain);

    // Lengths of one byte, of two and of four.
    let mut file =
        b"# vtk DataFile Version 5.1\nName\nBINARY\nDATASET POLYDATA\nFIELD FieldData 1\nC 1 3 string\n"
            .to_vec();
    file.extend(*b"\xc1x\x81\x2c");
    file.extend([b'\n'; 300]);
    file.extend(*b"\x40\x00\x00\x02ab\nPOINTS 3 float\n");
    file.extend([0.0_f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0].into_iter().flat_map(f32::to_be_bytes));
    file.extend(*b"\nPOLYGONS 2 3\nOFFSETS vtktypeint64\n");
    file.extend([0_i64, 3].into_iter().flat_map(i64::to_be_bytes));
    file.extend(*b"\nCONNECTIVITY vtktypeint64\n");
    file.extend([0_i64, 1, 2].into_iter().flat_map(i64::to_be_bytes));
    assert_eq!(vtk(&file).unwrap().triangles, [[0, 1, 2]]);
    assert_eq!(vtk(&file[..200]).unwrap_err().code(), "truncated");
}

#[test]
fn broken_legacy_files_are_typed_errors() {
    for (good, from, to, code) in [
        (LEGACY, "3 0 2 3", "3 0 2 4", "index-out-of-range"),
        (LEGACY, "3 0 2 3", "3 0 2 -1", "index-out-of-range"),
        (LEGACY, "3 0 2 3", "-3 0 2 3", "malformed"),
        (LEGACY, "POLYGONS 2 8", "POLYGONS 2 7", "malformed"),
        (LEGACY, "POLYGONS 2 8", "POLYGONS 1000000000 8", "too-large"),
        (LEGACY, "POLYGONS 2 8", "POLYGONS 2 1000000000", "truncated"),
        (LEGACY, "POLYGONS 2 8", "POLYGONS 2 -8", "malformed"),
        (LEGACY, "POINTS 4", "POINTS 1000000000", "too-large"),
        (LEGACY, "POINTS 4", "POINTS 10000000", "truncated"),
        (LEGACY, "POINTS 4", "POINTS 3", "malformed"),
        (LEGACY, "POINTS 4 float", "POINTS 4 quaternion", "malformed"),
        (LEGACY, "A 1 2 double", "A 1 2 variant", "unsupported-feature"),
        (LEGACY, "A 1 2 double", "A 1 4294967296 string", "truncated"),
        (LEGACY, "A 1 2 double", "A 4294967296 4294967296 double", "truncated"),
        (LEGACY, "1 1 0 0 1 0", "1 1 0 0 inf 0", "non-finite-coordinate"),
        (LEGACY, "ASCII", "EBCDIC", "malformed"),
        (LEGACY, "POLYDATA", "UNSTRUCTURED_GRID", "unsupported-format"),
        (LEGACY, "POLYGONS 2 8\n3 0 1 2\n3 0 2 3\n", "", "no-polygons"),
        (LEGACY, "POLYGONS 2 8\n", "POLYHEDRA 2 8\n", "malformed"),
        (OFFSETS, "0 3 6", "0 4 3", "malformed"),
        (OFFSETS, "0 3 6", "1 3 6", "malformed"),
        (OFFSETS, "0 3 6", "0 3 7", "malformed"),
        (OFFSETS, "POLYGONS 3", "POLYGONS 100000", "truncated"),
        (OFFSETS, "POLYGONS 3 6", "POLYGONS 3 1000000000", "truncated"),
        (OFFSETS, "OFFSETS vtktypeint64", "OFFSETS float", "malformed"),
        (OFFSETS, "CONNECTIVITY vtk", "VTK vtk", "malformed"),
    ] {
        assert!(good.contains(from), "{from}");
        let error = vtk(good.replacen(from, to, 1).as_bytes()).unwrap_err();
        assert_eq!(error.code(), code, "{from} -> {to}: {error}");
    }
}
