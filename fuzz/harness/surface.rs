//! Surfaces in a form that small changes leave surfaces: an index is taken modulo the number of vertices.

use nalgebra::Point3;
use rosaline::centerline::{Parameters, Preset};
use rosaline::mesh::TriangleMesh;

/// Coordinates are whole numbers times one of these: units, and sizes at which squares under- and overflow.
const SCALES: [f64; 4] = [0.01, 1e-6, 1e18, 1e-25];

/// What one run of the method gets.
pub struct Case {
    pub mesh: TriangleMesh,
    pub parameters: Parameters,
}

impl Case {
    /// A byte of choices, the number of vertices, three `i16` a vertex, then three indices (`u16`) a triangle.
    pub fn decode(bytes: &[u8]) -> Option<Self> {
        let (&choice, rest) = bytes.split_first()?;
        let (count, rest) = rest.split_first_chunk::<2>()?;
        let count = usize::from(u16::from_le_bytes(*count)).min(rest.len() / 6);
        let (vertices, triangles) = rest.split_at(6 * count);
        let scale = SCALES[usize::from(choice & 3)];
        let vertices =
            triples(vertices).map(|xyz| Point3::from(xyz.map(|x| f64::from(x as i16) * scale))).collect();
        let index = |index: u16| u32::from(index) % count.max(1) as u32;
        let triangles = triples(triangles).map(|abc| abc.map(index)).collect();
        let mesh = TriangleMesh { vertices, triangles };
        let mut parameters = Parameters::of(if choice & 4 == 0 { Preset::Default } else { Preset::Paper });
        if choice & 8 != 0 {
            parameters.set("smoothing", "true").unwrap();
        }
        for (bit, name, place) in [(16, "root", 0), (32, "include", 1), (64, "exclude", 2)] {
            if let (true, Some(at)) = (choice & bit != 0, mesh.vertices.get(place)) {
                parameters.set(name, &format!("{},{},{}", at.x, at.y, at.z)).unwrap();
            }
        }
        Some(Self { mesh, parameters })
    }

    /// The bytes of a mesh whose coordinates are within ±327.
    pub fn encode(mesh: &TriangleMesh, choice: u8) -> Vec<u8> {
        let mut bytes = vec![choice & !3];
        bytes.extend((mesh.vertices.len() as u16).to_le_bytes());
        let coordinates = mesh.vertices.iter().flat_map(|vertex| [vertex.x, vertex.y, vertex.z]);
        bytes.extend(coordinates.flat_map(|x| ((x / SCALES[0]).round() as i16).to_le_bytes()));
        bytes.extend(mesh.triangles.iter().flatten().flat_map(|&index| (index as u16).to_le_bytes()));
        bytes
    }
}

fn triples(bytes: &[u8]) -> impl Iterator<Item = [u16; 3]> + '_ {
    bytes.chunks_exact(6).map(|six| [0, 2, 4].map(|at| u16::from_le_bytes([six[at], six[at + 1]])))
}
