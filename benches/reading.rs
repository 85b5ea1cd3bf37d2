//! Reading and welding: bytes of file per second, for the binary formats, over three sizes.
//!
//! `cargo bench --bench reading`

use std::f32::consts::TAU;
use std::hint::black_box;
use std::io::Write;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use rosaline::mesh::format::{Hint, Limits, read};

/// A torus of `across` by `around` vertices, two triangles for each.
struct Torus {
    vertices: Vec<[f32; 3]>,
    triangles: Vec<[u32; 3]>,
}

fn torus(vertices: u32) -> Torus {
    let across = 100;
    let around = vertices / across;
    let mut torus = Torus { vertices: Vec::new(), triangles: Vec::new() };
    for (i, j) in (0..around).flat_map(|i| (0..across).map(move |j| (i, j))) {
        let (s, t) = (TAU * i as f32 / around as f32, TAU * j as f32 / across as f32);
        let radius = 50.0 + 5.0 * t.cos();
        torus.vertices.push([radius * s.cos(), radius * s.sin(), 5.0 * t.sin()]);
        let at = |i: u32, j: u32| (i % around) * across + j % across;
        let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
        torus.triangles.extend([[a, b, c], [a, c, d]]);
    }
    torus
}

impl Torus {
    fn vertex_bytes(&self) -> Vec<u8> {
        self.vertices.iter().flatten().flat_map(|number| number.to_le_bytes()).collect()
    }

    fn index_bytes(&self) -> Vec<u8> {
        self.triangles.iter().flatten().flat_map(|index| index.to_le_bytes()).collect()
    }

    fn stl(&self) -> Vec<u8> {
        let mut bytes = vec![0; 80];
        bytes.extend((self.triangles.len() as u32).to_le_bytes());
        for triangle in &self.triangles {
            bytes.extend([0; 12]);
            for index in triangle {
                bytes.extend(self.vertices[*index as usize].iter().flat_map(|number| number.to_le_bytes()));
            }
            bytes.extend([0; 2]);
        }
        bytes
    }

    fn ply(&self) -> Vec<u8> {
        let mut bytes = format!(
            "ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty float x\nproperty float y\n\
             property float z\nelement face {}\nproperty list uchar int vertex_indices\nend_header\n",
            self.vertices.len(),
            self.triangles.len()
        )
        .into_bytes();
        bytes.extend(self.vertex_bytes());
        for triangle in &self.triangles {
            bytes.push(3);
            bytes.extend(triangle.iter().flat_map(|index| index.to_le_bytes()));
        }
        bytes
    }

    fn glb(&self) -> Vec<u8> {
        let (vertices, indices) = (self.vertex_bytes(), self.index_bytes());
        let mut json = serde_json::json!({
            "asset": {"version": "2.0"},
            "buffers": [{"byteLength": vertices.len() + indices.len()}],
            "bufferViews": [
                {"buffer": 0, "byteLength": vertices.len()},
                {"buffer": 0, "byteOffset": vertices.len(), "byteLength": indices.len()},
            ],
            "accessors": [
                {"bufferView": 0, "componentType": 5126, "type": "VEC3", "count": self.vertices.len()},
                {"bufferView": 1, "componentType": 5125, "type": "SCALAR", "count": 3 * self.triangles.len()},
            ],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
            "nodes": [{"mesh": 0}],
        })
        .to_string();
        while !json.len().is_multiple_of(4) {
            json.push(' ');
        }
        let length = |bytes: usize| (bytes as u32).to_le_bytes();
        let mut bytes = b"glTF\x02\0\0\0".to_vec();
        bytes.extend(length(28 + json.len() + vertices.len() + indices.len()));
        bytes.extend([&length(json.len())[..], b"JSON", json.as_bytes()].concat());
        bytes.extend([&length(vertices.len() + indices.len())[..], b"BIN\0"].concat());
        bytes.extend(vertices);
        bytes.extend(indices);
        bytes
    }

    /// Raw appended and zlib-compressed in blocks of 32 KiB, as VTK does it; and its decoded size.
    fn vtp(&self) -> (Vec<u8>, usize) {
        let connectivity = self.triangles.iter().flatten().flat_map(|&index| i64::from(index).to_le_bytes());
        let offsets = (1..=self.triangles.len() as i64).flat_map(|cell| (3 * cell).to_le_bytes());
        let arrays = [self.vertex_bytes(), connectivity.collect(), offsets.collect()];
        let mut data = Vec::new();
        let starts = arrays.each_ref().map(|array| {
            let start = data.len();
            data.extend(compressed(array));
            start
        });
        let mut bytes = format!(
            "<VTKFile type=\"PolyData\" byte_order=\"LittleEndian\" compressor=\"vtkZLibDataCompressor\"><PolyData>\
             <Piece NumberOfPoints=\"{}\" NumberOfPolys=\"{}\">\
             <Points><DataArray type=\"Float32\" format=\"appended\" offset=\"{}\"/></Points>\
             <Polys><DataArray type=\"Int64\" Name=\"connectivity\" format=\"appended\" offset=\"{}\"/>\
             <DataArray type=\"Int64\" Name=\"offsets\" format=\"appended\" offset=\"{}\"/></Polys>\
             </Piece></PolyData><AppendedData encoding=\"raw\">_",
            self.vertices.len(),
            self.triangles.len(),
            starts[0],
            starts[1],
            starts[2]
        )
        .into_bytes();
        bytes.extend(data);
        bytes.extend(b"</AppendedData></VTKFile>");
        (bytes, arrays.iter().map(Vec::len).sum())
    }
}

fn compressed(array: &[u8]) -> Vec<u8> {
    let blocks: Vec<Vec<u8>> = array
        .chunks(32768)
        .map(|block| {
            let mut encoder = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::new(5));
            // A vector takes everything.
            let _ = encoder.write_all(block);
            encoder.finish().unwrap_or_default()
        })
        .collect();
    let mut words = vec![blocks.len(), 32768, array.len() % 32768];
    words.extend(blocks.iter().map(Vec::len));
    let header = words.iter().flat_map(|&word| (word as u32).to_le_bytes());
    header.chain(blocks.into_iter().flatten()).collect()
}

fn reading(criterion: &mut Criterion) {
    for vertices in [10_000, 100_000, 1_000_000] {
        let torus = torus(vertices);
        let (vtp, decoded) = torus.vtp();
        let files = [
            ("stl", torus.stl(), None),
            ("ply", torus.ply(), None),
            ("glb", torus.glb(), None),
            ("vtp", vtp, Some(decoded)),
        ];
        let mut group = criterion.benchmark_group("reading");
        group.sample_size(10);
        for (name, bytes, decoded) in &files {
            group.throughput(Throughput::Bytes(decoded.unwrap_or(bytes.len()) as u64));
            group.bench_with_input(BenchmarkId::new(*name, vertices), bytes, |bencher, bytes| {
                bencher.iter(|| black_box(read(bytes, Hint::default(), &Limits::default())));
            });
        }
    }
}

criterion_group!(benches, reading);
criterion_main!(benches);
