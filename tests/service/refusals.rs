//! Bad input: each kind is refused with a problem, leaves nothing behind, and the service lives on.

use std::io::{Read, Write};

use reqwest::multipart::{Form, Part};
use serde_json::{Value, json};

use crate::meshes;
use crate::service::{Service, problem};

/// Posts bytes that must be refused with one of the statuses for bad input; status and kind.
async fn refused(service: &Service, what: &str, bytes: Vec<u8>) -> (u16, String) {
    let response = service.submit("?name=doe_jane.stl", bytes).await;
    let status = response.status().as_u16();
    assert!([400, 413, 415, 422].contains(&status), "{what}: {status} {}", response.text().await.unwrap());
    assert_eq!(response.headers()["content-type"], "application/problem+json", "{what}");
    let body: Value = response.json().await.unwrap();
    assert_eq!(body["status"], status);
    assert!(!body.to_string().contains("doe"), "{body}");
    (status, body["type"].as_str().unwrap().replace("urn:rosaline:problem:", ""))
}

/// No job, no file, still at work.
async fn assert_unharmed(service: &Service) {
    let list: Value = service.get("/v1/jobs").send().await.unwrap().json().await.unwrap();
    assert_eq!(list["jobs"], json!([]));
    service.assert_no_files().await;
    let job = service.accepted("", meshes::small()).await;
    assert_eq!(service.ended(&job).await["status"], "successful");
    assert!(!service.log().contains("doe"), "{}", service.log());
}

const PLY: &str = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
    element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n";
const VTK: &str = "# vtk DataFile Version 3.0\nx\nASCII\nDATASET POLYDATA\nPOINTS 3 float\n0 0 0 1 0 0 0 1 0\n\
    POLYGONS 1 4\n3 0 1 2\n";
const OFF: &str = "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n";
const OBJ: &str = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";
const STL: &str = "solid x\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\n\
    endfacet\nendsolid x\n";
const VTP: &str = "<?xml version=\"1.0\"?>\n<VTKFile type=\"PolyData\" version=\"1.0\" byte_order=\"LittleEndian\" \
    header_type=\"UInt32\"><PolyData><Piece NumberOfPoints=\"3\" NumberOfPolys=\"1\"><Points><DataArray \
    type=\"Float32\" NumberOfComponents=\"3\" format=\"ascii\">0 0 0 1 0 0 0 1 0</DataArray></Points><Polys>\
    <DataArray type=\"Int32\" Name=\"connectivity\" format=\"ascii\">0 1 2</DataArray><DataArray type=\"Int32\" \
    Name=\"offsets\" format=\"ascii\">3</DataArray></Polys></Piece></PolyData></VTKFile>\n";

/// A glTF of one triangle.
fn gltf() -> Value {
    json!({
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "buffers": [{"byteLength": 36}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3",
            "min": [0, 0, 0], "max": [1, 1, 0]}],
    })
}

/// Its GLB, with these coordinates.
fn glb(gltf: &Value, positions: [f32; 9]) -> Vec<u8> {
    let mut text = gltf.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let binary: Vec<u8> = positions.iter().flat_map(|number| number.to_le_bytes()).collect();
    let mut file = b"glTF".to_vec();
    let length = |bytes: &[u8]| u32::try_from(bytes.len()).unwrap().to_le_bytes();
    let total = 12 + 8 + u32::try_from(text.len()).unwrap() + 8 + u32::try_from(binary.len()).unwrap();
    for part in [&2_u32.to_le_bytes()[..], &total.to_le_bytes(), &length(&text), b"JSON", &text] {
        file.extend_from_slice(part);
    }
    for part in [&length(&binary)[..], b"BIN\0", &binary] {
        file.extend_from_slice(part);
    }
    file
}

const TRIANGLE: [f32; 9] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0];

#[tokio::test]
async fn what_is_no_mesh_is_refused() {
    let service = Service::start(&[]);
    let png = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR".iter().copied().chain([7; 5000]).collect();
    assert_eq!(refused(&service, "PNG", png).await, (415, "unsupported-format".to_owned()));
    assert_eq!(refused(&service, "nothing", Vec::new()).await, (400, "empty".to_owned()));
    assert_eq!(refused(&service, "prose", b"Dear radiologist,".repeat(9)).await.0, 415);
    assert_eq!(refused(&service, "zeros", vec![0; 300]).await.0 / 100, 4);
    assert_unharmed(&service).await;
}

#[tokio::test]
async fn json_that_is_no_gltf_is_named() {
    let service = Service::start(&[]);
    let job = service.accepted("", meshes::small()).await;
    service.ended(&job).await;
    let result = service.get(&format!("{job}/results/centerline.json")).send().await.unwrap();
    let result = result.bytes().await.unwrap();
    for (query, body, found) in [
        ("", result.clone(), "a centerline, the result of an extraction"),
        ("?dry_run=true", result, "a centerline, the result of an extraction"),
        ("", "{\"patient\": \"doe\"}".into(), "JSON other than glTF"),
    ] {
        let problem = problem(service.submit(query, body).await, 415, "unsupported-format").await;
        let detail = problem["detail"].as_str().unwrap();
        assert!(detail.starts_with(&format!("this is {found}")) && !detail.contains("doe"), "{detail}");
    }
}

#[tokio::test]
async fn every_format_cut_short_is_refused() {
    let service = Service::start(&[]);
    let stl = meshes::small();
    let whole = [
        ("PLY", PLY.as_bytes().to_vec()),
        ("VTK", VTK.as_bytes().to_vec()),
        ("OFF", OFF.as_bytes().to_vec()),
        ("ASCII STL", STL.as_bytes().to_vec()),
        ("VTP", VTP.as_bytes().to_vec()),
        ("GLB", glb(&gltf(), TRIANGLE)),
        ("glTF", gltf().to_string().into_bytes()),
        ("binary STL", stl),
    ];
    for (format, bytes) in whole {
        let short = bytes[..bytes.len() * 4 / 5].to_vec();
        let (status, word) = refused(&service, format, short).await;
        assert!(status == 400 || status == 422, "{format}: {status} {word}");
    }
    assert_unharmed(&service).await;
}

#[tokio::test]
async fn lying_counts_are_refused_before_memory_is_taken_for_them() {
    let service = Service::start(&[]);
    let mut stl = meshes::small();
    stl[80..84].copy_from_slice(&20_000_000_u32.to_le_bytes());
    let mut gigabyte = gltf();
    gigabyte["buffers"][0]["byteLength"] = json!(1 << 30);
    gigabyte["bufferViews"][0]["byteLength"] = json!(1 << 30);
    gigabyte["accessors"][0]["count"] = json!((1 << 30) / 12);
    let mut outside = gltf();
    outside["bufferViews"][0]["byteOffset"] = json!(1_000_000);
    let mut long = glb(&gltf(), TRIANGLE);
    long[8..12].copy_from_slice(&(1_u32 << 30).to_le_bytes());
    for (what, bytes) in [
        ("binary STL", stl),
        ("GLB of 1 GB", glb(&gigabyte, TRIANGLE)),
        ("GLB with a view outside its buffer", glb(&outside, TRIANGLE)),
        ("GLB with a wrong length", long),
        ("PLY vertices", PLY.replace("vertex 3", "vertex 1000000000").into_bytes()),
        ("PLY faces", PLY.replace("face 1", "face 1000000000").into_bytes()),
        ("VTK points", VTK.replace("POINTS 3", "POINTS 1000000000").into_bytes()),
        ("VTK polygons", VTK.replace("POLYGONS 1 4", "POLYGONS 1000000000 4000000000").into_bytes()),
        ("OFF", OFF.replace("3 1 0", "1000000000 1000000000 0").into_bytes()),
        ("VTP", VTP.replace("NumberOfPoints=\"3\"", "NumberOfPoints=\"1000000000\"").into_bytes()),
    ] {
        refused(&service, what, bytes).await;
    }
    assert_unharmed(&service).await;
}

#[tokio::test]
async fn coordinates_that_are_no_numbers_are_refused() {
    let service = Service::start(&[]);
    let mut stl = meshes::small();
    stl[96..100].copy_from_slice(&f32::NAN.to_le_bytes());
    let mut positions = TRIANGLE;
    positions[4] = f32::INFINITY;
    let text = |whole: &str, from: &str, to: &str| whole.replace(from, to).into_bytes();
    for (what, bytes) in [
        ("binary STL", stl),
        ("ASCII STL", text(STL, "vertex 1 0 0", "vertex nan 0 0")),
        ("PLY", text(PLY, "1 0 0\n", "nan 0 0\n")),
        ("OBJ", text(OBJ, "v 1 0 0", "v nan 0 0")),
        ("OFF", text(OFF, "1 0 0\n", "nan 0 0\n")),
        ("VTK", text(VTK, "1 0 0 0", "nan 0 0 0")),
        ("VTP", text(VTP, ">0 0 0 1", ">0 0 0 nan")),
        ("GLB", glb(&gltf(), positions)),
    ] {
        let (status, word) = refused(&service, what, bytes).await;
        assert!(word == "non-finite-coordinate" || word == "malformed", "{what}: {status} {word}");
    }
    assert_unharmed(&service).await;
}

#[tokio::test]
async fn faces_of_missing_vertices_are_refused() {
    let service = Service::start(&[]);
    let mut indexed = gltf();
    indexed["meshes"][0]["primitives"][0]["indices"] = json!(1);
    indexed["accessors"].as_array_mut().unwrap().push(json!({
        "bufferView": 0, "componentType": 5125, "count": 3, "type": "SCALAR",
    }));
    let text = |whole: &str, from: &str, to: &str| whole.replace(from, to).into_bytes();
    for (what, bytes) in [
        ("PLY", text(PLY, "3 0 1 2", "3 0 1 9")),
        ("PLY negative", text(PLY, "3 0 1 2", "3 0 1 -9")),
        ("OBJ", text(OBJ, "f 1 2 3", "f 1 2 9")),
        ("OFF", text(OFF, "3 0 1 2", "3 0 1 9")),
        ("VTK", text(VTK, "3 0 1 2", "3 0 1 9")),
        ("VTP", text(VTP, ">0 1 2<", ">0 1 9<")),
        ("GLB", glb(&indexed, [0.0, 9.0, 9.0, 9.0, 9.0, 9.0, 9.0, 9.0, 9.0])),
    ] {
        assert_eq!(refused(&service, what, bytes).await, (422, "index-out-of-range".to_owned()), "{what}");
    }
    assert_unharmed(&service).await;
}

#[tokio::test]
async fn gltf_with_outside_files_is_refused() {
    let service = Service::start(&[]);
    let mut external = gltf();
    for uri in ["http://127.0.0.1:1/x.bin", "../../etc/passwd", "file:///etc/passwd"] {
        external["buffers"][0]["uri"] = json!(uri);
        refused(&service, uri, external.to_string().into_bytes()).await;
    }
    assert_unharmed(&service).await;
}

#[tokio::test]
async fn other_content_types_are_refused_with_the_list_of_those_that_are_taken() {
    let service = Service::start(&[]);
    for content_type in
        ["image/png", "application/x-www-form-urlencoded", "text/plain", "nonsense", "model/vrml"]
    {
        let request = service.post("/v1/jobs").header("content-type", content_type);
        let response = request.body(meshes::small()).send().await.unwrap();
        assert!(response.headers()["accept"].to_str().unwrap().contains("model/stl"));
        let body = problem(response, 415, "unsupported-media-type").await;
        assert_eq!(body["accepted"].as_array().unwrap().len(), 8);
    }
    let request = service.post("/v1/jobs").header("content-type", "Model/STL; charset=binary");
    assert_eq!(request.body(meshes::small()).send().await.unwrap().status(), 201);
    assert_eq!(service.post("/v1/jobs").body(meshes::small()).send().await.unwrap().status(), 201);
}

#[tokio::test]
async fn wrong_parameters_are_refused_by_name() {
    let service = Service::start(&[]);
    for (query, word, parameter) in [
        ("omgea=0.8", "unknown-parameter", "omgea"),
        ("omega=1.5", "invalid-parameter", "omega"),
        ("omega=NaN", "invalid-parameter", "omega"),
        ("omega=", "invalid-parameter", "omega"),
        ("smoothing=maybe", "invalid-parameter", "smoothing"),
        ("units=furlong", "invalid-parameter", "units"),
        ("preset=best", "invalid-parameter", "preset"),
        ("mu=0.5&mu=0.6", "invalid-parameter", "mu"),
        ("name=a%0Ab", "invalid-parameter", "name"),
    ] {
        let response = service.submit(&format!("?{query}"), meshes::small()).await;
        assert_eq!(problem(response, 400, word).await["parameter"], parameter, "{query}");
    }
    assert_unharmed(&service).await;
}

#[tokio::test]
async fn wrong_forms_are_refused() {
    let service = Service::start(&[]);
    let mesh = || Part::bytes(meshes::small()).file_name("doe_jane.stl");
    let text = |text: &'static str| Part::text(text);
    for (form, status, word) in [
        (Form::new().part("parameters", text("{}")), 400, "malformed-request"),
        (Form::new().part("mesh", mesh()).part("parameters", text("[]")), 400, "malformed-request"),
        (Form::new().part("mesh", mesh()).part("parameters", text("{")), 400, "malformed-request"),
        (Form::new().part("mesh", mesh()).part("mesh", mesh()), 400, "malformed-request"),
        (Form::new().part("mesh", mesh()).part("other", text("x")), 400, "malformed-request"),
        (
            Form::new().part("mesh", mesh()).part("parameters", text("{\"omega\": 9}")),
            400,
            "invalid-parameter",
        ),
        (
            Form::new().part("parameters", text("{\"omgea\": 1}")).part("mesh", mesh()),
            400,
            "unknown-parameter",
        ),
        (Form::new().part("mesh", Part::bytes(b"\x89PNG\r\n\x1a\n".to_vec())), 415, "unsupported-format"),
        (
            Form::new().part("mesh", mesh()).part("parameters", Part::bytes(vec![b' '; 100_000])),
            413,
            "upload-too-large",
        ),
    ] {
        let response = service.post("/v1/jobs").multipart(form).send().await.unwrap();
        problem(response, status, word).await;
    }
    for (content_type, body, todo) in [
        ("multipart/form-data", "--x\r\n", "send multipart/form-data; boundary="),
        ("multipart/form-data; boundary=x", "--y\r\n", "as HTTP libraries make it"),
        ("multipart/form-data; boundary=x", "--x\r\nno head\r\n\r\n--x--\r\n", "as HTTP libraries make it"),
    ] {
        let request = service.post("/v1/jobs").header("content-type", content_type).body(body);
        let problem = problem(request.send().await.unwrap(), 400, "malformed-request").await;
        assert!(problem["detail"].as_str().unwrap().contains(todo), "{problem}");
    }
    assert_unharmed(&service).await;
}

#[tokio::test]
async fn other_paths_methods_and_ids_are_problems_too() {
    let service = Service::start(&[]);
    for path in ["/", "/v1", "/v1/job", "/v1/jobs/x/y", "/v1/jobs/"] {
        problem(service.get(path).send().await.unwrap(), 404, "not-found").await;
    }
    for id in ["x", "019aa8b6-7a42-7d52-8d53-2f8ad3a2b9c1", "%ff", "..%2f..%2fjobs.sqlite"] {
        problem(service.get(&format!("/v1/jobs/{id}")).send().await.unwrap(), 404, "job-not-found").await;
        problem(service.delete(&format!("/v1/jobs/{id}")).send().await.unwrap(), 404, "job-not-found").await;
    }
    for (path, allowed) in [("/v1/jobs", "POST,GET,HEAD"), ("/healthz", "GET,HEAD")] {
        let response = service.client.put(format!("{}{path}", service.url)).send().await.unwrap();
        assert_eq!(response.headers()["allow"], allowed);
        problem(response, 405, "method-not-allowed").await;
    }
    service.assert_alive().await;
}

/// RFC 9112, section 3.2.
#[tokio::test]
async fn a_request_needs_one_host() {
    let service = Service::start(&[]);
    let answer = |head: &str| {
        let mut stream = std::net::TcpStream::connect(service.address()).unwrap();
        stream.write_all(format!("{head}Connection: close\r\n\r\n").as_bytes()).unwrap();
        let mut text = String::new();
        stream.read_to_string(&mut text).unwrap();
        text
    };
    for path in ["/healthz", "/v1/jobs", "/nowhere", "/openapi.yaml"] {
        for hosts in ["", "Host: a\r\nHost: a\r\n", "Host: a/b\r\n"] {
            let text = answer(&format!("GET {path} HTTP/1.1\r\n{hosts}"));
            assert!(text.starts_with("HTTP/1.1 400 "), "{path} {hosts}: {text}");
            assert!(
                text.contains("urn:rosaline:problem:malformed-request") && text.contains("Host"),
                "{text}"
            );
        }
    }
    // Also a browser's question whether it may ask.
    let preflight = "Origin: https://a.example\r\nAccess-Control-Request-Method: POST\r\n";
    for (hosts, status) in [("", "400"), ("Host: a\r\nHost: a\r\n", "400"), ("Host: a\r\n", "200")] {
        let text = answer(&format!("OPTIONS /v1/jobs HTTP/1.1\r\n{hosts}{preflight}"));
        assert!(text.split(' ').nth(1) == Some(status), "{hosts}: {text}");
    }
    for head in ["GET /healthz HTTP/1.1\r\nHost: a:1\r\n", "GET /healthz HTTP/1.0\r\n"] {
        let text = answer(head);
        assert!(text.split(' ').nth(1) == Some("200"), "{head}: {text}");
    }
}

/// What could only fail later, in the run, is refused at once.
#[tokio::test]
async fn points_that_cannot_be_reckoned_with_are_refused() {
    let service = Service::start(&[]);
    for point in ["1e308,0,0", "0,-1e31,0", "inf,0,0", "0,0,1e999"] {
        for name in ["include", "exclude", "root"] {
            let response = service.submit(&format!("?{name}={point}"), meshes::small()).await;
            let body = problem(response, 400, "invalid-parameter").await;
            assert_eq!(body["parameter"], name);
            assert!(body["detail"].as_str().unwrap().contains("within 1e30 of 0"), "{body}");
        }
        let parameters =
            Part::text(json!({"include": [point]}).to_string()).mime_str("application/json").unwrap();
        let form = Form::new().part("parameters", parameters).part("mesh", Part::bytes(meshes::small()));
        let response = service.post("/v1/jobs").multipart(form).send().await.unwrap();
        problem(response, 400, "invalid-parameter").await;
    }
    // What is within the numbers' bound and off this mesh as well; a little off it is the job's to judge.
    for (query, parameter, place) in [
        ("include=1e30,0,0", "include", "point 1"),
        ("exclude=1e30,-1e30,1e30", "exclude", "point 1"),
        ("root=1e30,1e30,1e30", "root", "point 1"),
        ("include=0,0,0&include=0,0,1e6", "include", "point 2"),
        ("include=0,0,1e6&dry_run=true", "include", "point 1"),
    ] {
        let response = service.submit(&format!("?{query}"), meshes::small()).await;
        let body = problem(response, 400, "invalid-parameter").await;
        let detail = body["detail"].as_str().unwrap();
        assert!(
            body["parameter"] == parameter && detail.starts_with(&format!("{place} of {parameter}")),
            "{body}"
        );
        assert!(detail.contains("give points on the surface"), "{body}");
    }
    assert_unharmed(&service).await;
}
