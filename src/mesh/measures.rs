//! Size of a mesh: diagonal, area, volume.

use nalgebra::Vector3;

use super::TriangleMesh;

/// Diagonal of the bounding box of the vertices in use.
pub fn diagonal(mesh: &TriangleMesh) -> f64 {
    let [low, high] = bounds(mesh);
    if mesh.triangles.is_empty() { 0.0 } else { (high - low).norm() }
}

/// Least and greatest coordinates of the vertices in use.
pub fn bounds(mesh: &TriangleMesh) -> [Vector3<f64>; 2] {
    let mut low = Vector3::repeat(f64::INFINITY);
    let mut high = Vector3::repeat(f64::NEG_INFINITY);
    for &v in mesh.triangles.iter().flatten() {
        low = low.inf(&mesh.vertices[v as usize].coords);
        high = high.sup(&mesh.vertices[v as usize].coords);
    }
    [low, high]
}

/// Volume by the divergence theorem, about the first vertex so that frames far off lose no digits.
pub fn signed_volume(mesh: &TriangleMesh) -> f64 {
    let Some(&origin) = mesh.vertices.first() else { return 0.0 };
    let of = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|v| mesh.vertices[v as usize] - origin);
        a.dot(&b.cross(&c))
    };
    mesh.triangles.iter().map(of).sum::<f64>() / 6.0
}

pub fn area(mesh: &TriangleMesh, triangle: &[u32; 3]) -> f64 {
    let [a, b, c] = triangle.map(|v| mesh.vertices[v as usize]);
    0.5 * (b - a).cross(&(c - a)).norm()
}

/// Area of all triangles, in squared units of the input.
pub fn total_area(mesh: &TriangleMesh) -> f64 {
    mesh.triangles.iter().map(|triangle| area(mesh, triangle)).sum()
}
