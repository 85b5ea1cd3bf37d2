//! A reader holds the mesh that it makes, and no second copy of the file: what a file holds beside the surface takes no
//! memory, and a binary STL, which holds nothing beside it, takes less than its own size beyond the mesh.
#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

#[expect(dead_code, reason = "only one surface is needed")]
#[path = "common/meshes.rs"]
mod meshes;

use rosaline::mesh::TriangleMesh;
use rosaline::mesh::format::{Hint, Limits, read};

/// The most bytes that reading holds at once, its result included.
fn held(file: &[u8], mesh: &TriangleMesh) -> u64 {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let mut found = None;
    let count = || {
        allocation_counter::measure(|| found = Some(read(file, Hint::default(), &Limits::default()).unwrap()))
    };
    let counted = pool.install(count);
    let (found, _) = found.unwrap();
    assert_eq!(
        (found.vertices.len(), found.triangles.len()),
        (mesh.vertices.len(), mesh.triangles.len()),
        "the file holds the mesh"
    );
    counted.bytes_max
}

fn coordinates(mesh: &TriangleMesh) -> impl Iterator<Item = [u8; 12]> {
    let bytes = |coordinate: f64| (coordinate as f32).to_le_bytes();
    mesh.vertices.iter().map(move |p| {
        let [x, y, z] = [bytes(p.x), bytes(p.y), bytes(p.z)];
        std::array::from_fn(|i| [x, y, z][i / 4][i % 4])
    })
}

fn indices(mesh: &TriangleMesh) -> impl Iterator<Item = u8> {
    mesh.triangles.iter().flatten().flat_map(|index| index.to_le_bytes())
}

/// Binary PLY whose vertices have so many more numbers.
fn ply(mesh: &TriangleMesh, more: usize) -> Vec<u8> {
    let properties: String = (0..more).map(|k| format!("property float q{k}\n")).collect();
    let mut file = format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty float x\nproperty float y\n\
         property float z\n{properties}element face {}\nproperty list uchar int vertex_indices\nend_header\n",
        mesh.vertices.len(),
        mesh.triangles.len()
    )
    .into_bytes();
    for vertex in coordinates(mesh) {
        file.extend(vertex);
        file.extend(std::iter::repeat_n([0, 0, 128, 63], more).flatten());
    }
    for triangle in &mesh.triangles {
        file.push(3);
        file.extend(triangle.iter().flat_map(|index| index.to_le_bytes()));
    }
    file
}

/// GLB with so many more numbers a vertex in an attribute of its own.
fn glb(mesh: &TriangleMesh, more: usize) -> Vec<u8> {
    let vertices: Vec<u8> = coordinates(mesh).flatten().collect();
    let indices: Vec<u8> = indices(mesh).collect();
    let unused = vec![0; 4 * more * mesh.vertices.len()];
    let views = [(0, vertices.len()), (vertices.len(), indices.len())];
    let views = views
        .map(|(from, length)| serde_json::json!({"buffer": 0, "byteOffset": from, "byteLength": length}));
    let mut json = serde_json::json!({
        "asset": {"version": "2.0"},
        "buffers": [{"byteLength": vertices.len() + indices.len() + unused.len()}],
        "bufferViews": views,
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "type": "VEC3", "count": mesh.vertices.len()},
            {"bufferView": 1, "componentType": 5125, "type": "SCALAR", "count": 3 * mesh.triangles.len()},
        ],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "nodes": [{"mesh": 0}],
    })
    .to_string();
    while !json.len().is_multiple_of(4) {
        json.push(' ');
    }
    let length = |bytes: usize| (bytes as u32).to_le_bytes();
    let body = [vertices, indices, unused].concat();
    let mut file = b"glTF\x02\0\0\0".to_vec();
    file.extend(length(28 + json.len() + body.len()));
    file.extend([&length(json.len())[..], b"JSON", json.as_bytes()].concat());
    file.extend([&length(body.len())[..], b"BIN\0"].concat());
    file.extend(body);
    file
}

/// VTP with raw appended data, packed by zlib, and so many more numbers a vertex, not to be packed.
fn vtp(mesh: &TriangleMesh, more: usize) -> Vec<u8> {
    let offsets = (1..=mesh.triangles.len() as u32).flat_map(|cell| (3 * cell).to_le_bytes());
    let mut random = 1_u32;
    let mut noise = || {
        random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        random.to_be_bytes()
    };
    let unused = (0..more * mesh.vertices.len()).flat_map(|_| noise()).collect();
    let arrays = [coordinates(mesh).flatten().collect(), indices(mesh).collect(), offsets.collect(), unused];
    let mut data = Vec::new();
    let starts = arrays.map(|array: Vec<u8>| {
        let start = data.len();
        data.extend(packed(&array));
        start
    });
    let [points, connectivity, offsets, unused] = starts;
    let mut file = format!(
        "<VTKFile type=\"PolyData\" byte_order=\"LittleEndian\" compressor=\"vtkZLibDataCompressor\"><PolyData>\
         <Piece NumberOfPoints=\"{}\" NumberOfPolys=\"{}\">\
         <PointData><DataArray type=\"Float32\" Name=\"q\" format=\"appended\" offset=\"{unused}\"/></PointData>\
         <Points><DataArray type=\"Float32\" format=\"appended\" offset=\"{points}\"/></Points>\
         <Polys><DataArray type=\"Int32\" Name=\"connectivity\" format=\"appended\" offset=\"{connectivity}\"/>\
         <DataArray type=\"Int32\" Name=\"offsets\" format=\"appended\" offset=\"{offsets}\"/></Polys>\
         </Piece></PolyData><AppendedData encoding=\"raw\">_",
        mesh.vertices.len(),
        mesh.triangles.len(),
    )
    .into_bytes();
    file.extend(data);
    file.extend(b"</AppendedData></VTKFile>");
    file
}

/// Blocks of 32 KiB, as VTK packs them.
fn packed(array: &[u8]) -> Vec<u8> {
    let pack = |block: &[u8]| {
        let mut encoder = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::fast());
        std::io::Write::write_all(&mut encoder, block).unwrap();
        encoder.finish().unwrap()
    };
    let blocks: Vec<Vec<u8>> = array.chunks(32768).map(pack).collect();
    let mut words = vec![blocks.len(), 32768, array.len() % 32768];
    words.extend(blocks.iter().map(Vec::len));
    words
        .into_iter()
        .flat_map(|word| (word as u32).to_le_bytes())
        .chain(blocks.into_iter().flatten())
        .collect()
}

#[test]
fn what_a_file_holds_beside_the_surface_takes_no_memory() {
    /// Numbers a vertex that are not the surface's: the file becomes three times as large.
    const MORE: usize = 20;
    let mesh = meshes::tube(3000, 40);
    type Writer = fn(&TriangleMesh, usize) -> Vec<u8>;
    let writers: [(&str, Writer); 3] = [("PLY", ply), ("GLB", glb), ("VTP", vtp)];
    for (name, writer) in writers {
        let (plain, padded) = (writer(&mesh, 0), writer(&mesh, MORE));
        let more = padded.len() - plain.len();
        assert!(more > plain.len(), "{name}: {more} more than {}", plain.len());
        let (least, most) = (held(&plain, &mesh), held(&padded, &mesh));
        println!("{name}: {least} bytes held for {}, {most} for {}", plain.len(), padded.len());
        assert!(
            most < least + more as u64 / 50,
            "{name}: {most} bytes held, {least} without {more} of the file"
        );
    }
}

#[test]
fn a_binary_stl_takes_less_than_its_size_beyond_the_mesh() {
    let mesh = meshes::tube(6000, 40);
    let file = meshes::stl(&mesh);
    let result = 24 * mesh.vertices.len() + 12 * mesh.triangles.len();
    let beyond = held(&file, &mesh) - result as u64;
    println!("{beyond} bytes beyond the mesh for {}", file.len());
    assert!(beyond < file.len() as u64 * 3 / 4, "{beyond} bytes beyond the mesh for {}", file.len());
}
