//! Vertex normals.

use nalgebra::Vector3;

use super::TriangleMesh;

/// Unit normals of the vertices: the mean of their triangles' normals, each weighted by its angle at the
/// vertex, so that the triangulation does not matter (Thürmer and Wüthrich 1998). Zero for a vertex without
/// triangles of an area.
pub fn vertex_normals(mesh: &TriangleMesh) -> Vec<Vector3<f64>> {
    let mut sums = vec![Vector3::zeros(); mesh.vertices.len()];
    for triangle in &mesh.triangles {
        let corners = triangle.map(|v| mesh.vertices[v as usize]);
        let Some(normal) = (corners[1] - corners[0]).cross(&(corners[2] - corners[0])).try_normalize(0.0)
        else {
            continue;
        };
        for k in 0..3 {
            let (a, b) = (corners[(k + 1) % 3] - corners[k], corners[(k + 2) % 3] - corners[k]);
            sums[triangle[k] as usize] += normal * a.angle(&b);
        }
    }
    sums.into_iter().map(|sum| sum.try_normalize(0.0).unwrap_or_else(Vector3::zeros)).collect()
}

#[cfg(test)]
mod tests {
    use nalgebra::Point3;

    use super::*;

    #[test]
    fn the_corner_of_a_cube_points_along_its_diagonal_however_its_sides_are_split() {
        let vertices = (0..8)
            .map(|i| Point3::new(f64::from(i & 1), f64::from(i >> 1 & 1), f64::from(i >> 2 & 1)))
            .collect();
        let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let triangles = quads.iter().flat_map(|q| [[q[0], q[1], q[2]], [q[0], q[2], q[3]]]).collect();
        let mesh = TriangleMesh { vertices, triangles };
        for (point, normal) in mesh.vertices.iter().zip(vertex_normals(&mesh)) {
            let diagonal = (point - Point3::new(0.5, 0.5, 0.5)).normalize();
            assert!((normal - diagonal).norm() < 1e-12, "{normal} at {point}");
        }
    }

    #[test]
    fn a_vertex_without_area_has_no_normal() {
        let mesh = TriangleMesh { vertices: vec![Point3::origin(); 3], triangles: vec![[0, 1, 2]] };
        assert!(vertex_normals(&mesh).iter().all(|normal| *normal == Vector3::zeros()));
    }
}
