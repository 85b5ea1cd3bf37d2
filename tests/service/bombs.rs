//! Uploads that unpack to far more than they are.

use std::io::{Read, Write};
use std::net::TcpStream;

use flate2::Compression;
use flate2::write::{GzEncoder, ZlibEncoder};
use rosaline::mesh::format::Limits;
use serde_json::Value;

use crate::meshes;
use crate::service::{Service, problem};

/// A VTP whose connectivity is this many blocks of a MiB of zeros, each a KiB in the file.
fn bomb(blocks: u32) -> Vec<u8> {
    const BLOCK: u32 = 1 << 20;
    let packed = |bytes: &[u8]| {
        let mut encoder = ZlibEncoder::new(Vec::new(), Compression::best());
        encoder.write_all(bytes).unwrap();
        encoder.finish().unwrap()
    };
    let array = |blocks: u32, block: u32, last: u32, part: &[u8]| {
        let sizes = vec![u32::try_from(part.len()).unwrap(); blocks as usize];
        let words = [blocks, block, last].into_iter().chain(sizes);
        let mut bytes: Vec<u8> = words.flat_map(u32::to_le_bytes).collect();
        (0..blocks).for_each(|_| bytes.extend_from_slice(part));
        bytes
    };
    let points: Vec<u8> =
        [0.0_f32, 0., 0., 1., 0., 0., 0., 1., 0.].iter().flat_map(|x| x.to_le_bytes()).collect();
    let ends: Vec<u8> = 3_i32.to_le_bytes().to_vec();
    let (points, ends) = (array(1, 36, 0, &packed(&points)), array(1, 4, 0, &packed(&ends)));
    let corners = array(blocks, BLOCK, 0, &packed(&vec![0; BLOCK as usize]));
    let tag = |kind: &str, name: &str, offset: usize| {
        format!("<DataArray type=\"{kind}\" Name=\"{name}\" format=\"appended\" offset=\"{offset}\"/>")
    };
    let head = format!(
        "<VTKFile type=\"PolyData\" byte_order=\"LittleEndian\" header_type=\"UInt32\" \
         compressor=\"vtkZLibDataCompressor\"><PolyData><Piece NumberOfPoints=\"3\" NumberOfPolys=\"1\"><Points>{}\
         </Points><Polys>{}{}</Polys></Piece></PolyData><AppendedData encoding=\"raw\">_",
        tag("Float32", "Points", 0),
        tag("Int32", "offsets", points.len()),
        tag("Int32", "connectivity", points.len() + ends.len()),
    );
    [head.as_bytes(), &points, &ends, &corners, b"</AppendedData></VTKFile>"].concat()
}

#[tokio::test]
async fn a_small_file_that_unpacks_to_gigabytes_is_refused_without_them() {
    let service = Service::start(&[]);
    let limits: Value = service.get("/v1/limits").send().await.unwrap().json().await.unwrap();
    let times = limits["expansion"].as_u64().unwrap();
    assert!(times < 200 && limits["expansion_free_bytes"].as_u64().unwrap() < 100 << 20, "{limits}");
    let file = bomb(1300);
    assert!(file.len() < 2 << 20, "{}", file.len());
    let before = service.peak_memory();
    let body = problem(service.submit("", file).await, 413, "too-large").await;
    assert!(body["detail"].as_str().unwrap().contains("decoded bytes"), "{body}");
    let grown = service.peak_memory() - before;
    assert!(grown < 64, "{grown} MiB");
    service.assert_no_files().await;
    // What any small file may unpack to is no bomb, whatever its ratio: here it is a fault of the file.
    problem(service.submit("", bomb(2)).await, 400, "malformed").await;
    service.accepted("", meshes::small()).await;
}

#[tokio::test]
async fn a_compressed_body_is_refused_with_what_to_send() {
    let service = Service::start(&[]);
    let mut encoder = GzEncoder::new(Vec::new(), Compression::fast());
    encoder.write_all(&meshes::small()).unwrap();
    let packed = encoder.finish().unwrap();
    for coding in ["gzip", "zstd", "identity, gzip", "x"] {
        let request = service.post("/v1/jobs").header("content-type", "model/stl");
        let response = request.header("content-encoding", coding).body(packed.clone()).send().await.unwrap();
        assert_eq!(response.headers()["accept-encoding"], "identity", "{coding}");
        problem(response, 415, "unsupported-coding").await;
    }
    let plain =
        service.post("/v1/jobs").header("content-type", "model/stl").header("content-encoding", "identity");
    assert_eq!(plain.body(meshes::small()).send().await.unwrap().status(), 201);
}

/// RFC 9112, section 6.1.
#[tokio::test]
async fn of_transfer_codings_one_chunked_is_read() {
    let service = Service::start(&[]);
    let mesh = meshes::small();
    let answer = |codings: &[&str]| {
        let fields: String =
            codings.iter().map(|coding| format!("Transfer-Encoding: {coding}\r\n")).collect();
        let head = "POST /v1/jobs HTTP/1.1\r\nHost: x\r\nConnection: close\r\nContent-Type: model/stl\r\n";
        let begin = format!("{head}{fields}\r\n{:x}\r\n", mesh.len());
        let mut stream = TcpStream::connect(service.address()).unwrap();
        stream.write_all(&[begin.as_bytes(), &mesh, b"\r\n0\r\n\r\n"].concat()).unwrap();
        let mut text = String::new();
        stream.read_to_string(&mut text).unwrap();
        text
    };
    for codings in [&["gzip, chunked"][..], &["chunked", "chunked"], &["gzip", "chunked"], &["x, chunked"]] {
        let text = answer(codings);
        let is_refused = text.starts_with("HTTP/1.1 501 ") && text.contains("problem:unsupported-transfer");
        assert!(is_refused, "{codings:?}: {text}");
    }
    assert!(answer(&["Chunked"]).starts_with("HTTP/1.1 201 "));
}

#[tokio::test]
async fn the_worst_meshes_take_no_more_than_the_doctor_counts() {
    const TRIANGLES: usize = 400_000;
    let most = TRIANGLES.to_string();
    let limit = ["--max-triangles", &most, "--validations", "1", "--workers", "1", "--threads", "1"];
    let most_vertices = Limits::of_triangles(TRIANGLES).vertices;
    let vertices: String =
        (0..most_vertices).map(|place| format!("v {} {} 0\n", place % 2, place / 2)).collect();
    let dense = |triangles: usize| format!("{vertices}{}", "f 1 2 3\n".repeat(triangles)).into_bytes();
    // As many triangles that share no vertex as there may be vertices for.
    let mut soup = [&[0; 80][..], &u32::try_from(most_vertices / 3).unwrap().to_le_bytes()].concat();
    for place in 0..most_vertices / 3 {
        let x = place as f32;
        let corners = [[x, 0.0, 0.0], [x, 1.0, 0.0], [x, 0.0, 1.0]];
        soup.extend(
            [0.0; 3].iter().chain(corners.iter().flatten()).flat_map(|number: &f32| number.to_le_bytes()),
        );
        soup.extend([0; 2]);
    }
    for (name, mesh) in [("dense", dense(TRIANGLES)), ("soup", soup)] {
        let service = Service::start(&limit);
        let before = service.peak_memory();
        let file = mesh.len() as u64 >> 20;
        let response = service.submit("?dry_run=true", mesh).await;
        assert_eq!(response.status(), 200, "{}", response.text().await.unwrap());
        let grown = service.peak_memory() - before;
        println!("{name}: {grown} MiB, of which the file {file}");
        // 250 bytes a triangle, the file, and what a request takes whatever is in it.
        assert!(grown <= ((250 * TRIANGLES as u64) >> 20) + file + 24, "{name}: {grown} MiB");
    }
    let service = Service::start(&limit);
    let limits: Value = service.get("/v1/limits").send().await.unwrap().json().await.unwrap();
    assert_eq!((&limits["triangles"], &limits["vertices"]), (&TRIANGLES.into(), &most_vertices.into()));
    problem(service.submit("", dense(TRIANGLES + 1)).await, 413, "too-large").await;
}
