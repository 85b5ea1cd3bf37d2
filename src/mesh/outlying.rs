//! Vertices so far out that the rest of a mesh has no size beside them: a coordinate that was damaged, as a rule.

use nalgebra::Point3;

use super::TriangleMesh;
use super::measures::{area, diagonal};
use super::preparation::NO_AREA;
use super::sites::Sites;

/// From how many times as far from the middle as half of the vertices a vertex is out of place.
const FAR: f64 = 1e6;

/// Such vertices of a mesh without an area to speak of; none where they are not what it has none for. O(n log n).
pub(super) fn outlying(mesh: &TriangleMesh) -> Sites {
    let mut used: Vec<u32> = mesh.triangles.iter().flatten().copied().collect();
    used.sort_unstable();
    used.dedup();
    // No single vertex moves a median, however far out it is.
    let middle = [0, 1, 2].map(|k| median(used.iter().map(|&v| mesh.vertices[v as usize][k])));
    let reach = |v: u32| (mesh.vertices[v as usize] - Point3::from(middle)).norm();
    let most = FAR * median(used.iter().map(|&v| reach(v)));
    let is_near = |corners: &&[u32; 3]| corners.iter().all(|&v| reach(v) <= most);
    let triangles = mesh.triangles.iter().filter(is_near).copied().collect();
    let rest = TriangleMesh { vertices: mesh.vertices.clone(), triangles };
    let least = NO_AREA * diagonal(&rest).powi(2);
    if rest.triangles.iter().all(|corners| area(&rest, corners) <= least) {
        return Sites::default();
    }
    used.into_iter().filter(|&v| reach(v) > most).collect()
}

/// The middle one of these, 0 where there are none.
fn median(numbers: impl Iterator<Item = f64>) -> f64 {
    let mut numbers: Vec<f64> = numbers.collect();
    let middle = numbers.len() / 2;
    if numbers.is_empty() { 0.0 } else { *numbers.select_nth_unstable_by(middle, f64::total_cmp).1 }
}

#[cfg(test)]
mod tests {
    use super::super::preparation::{PreparationError, prepare};
    use super::*;

    /// A strip of unit squares, two triangles each.
    fn strip(squares: u32) -> TriangleMesh {
        let corner = |v: u32| Point3::new(f64::from(v / 2), f64::from(v % 2), 0.0);
        let square = |at: u32| [[2 * at, 2 * at + 2, 2 * at + 1], [2 * at + 1, 2 * at + 2, 2 * at + 3]];
        let vertices = (0..2 * squares + 2).map(corner).collect();
        TriangleMesh { vertices, triangles: (0..squares).flat_map(square).collect() }
    }

    #[test]
    fn a_vertex_beside_which_the_rest_has_no_size_is_named() {
        for far in [1e30, -1e17, 1e300] {
            let mut mesh = strip(10);
            mesh.vertices[7].y = far;
            let error = prepare(&mesh).unwrap_err();
            assert_eq!(error, PreparationError::FarOut([7].into_iter().collect()), "{far}");
        }
        let mut two = strip(10);
        two.vertices[3].x = 1e30;
        two.vertices[21].z = -1e29;
        assert_eq!(prepare(&two).unwrap_err(), PreparationError::FarOut([3, 21].into_iter().collect()));
    }

    #[test]
    fn a_mesh_that_is_flat_without_them_too_has_no_area() {
        let mut flat = strip(10);
        flat.vertices.iter_mut().for_each(|vertex| vertex.y = 0.0);
        let error = PreparationError::AllDegenerate { triangles: 20 };
        assert_eq!(prepare(&flat).unwrap_err(), error);
        flat.vertices[7].x = 1e30;
        assert_eq!(prepare(&flat).unwrap_err(), error);
    }
}
