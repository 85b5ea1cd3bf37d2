//! Size of a mesh: diagonal, area, volume.

use nalgebra::Vector3;
use rayon::prelude::*;

use super::TriangleMesh;

/// Triangles that one thread takes at a time.
const RUN: usize = 1 << 14;

/// Diagonal of the bounding box of the vertices in use.
pub fn diagonal(mesh: &TriangleMesh) -> f64 {
    if mesh.triangles.is_empty() {
        return 0.0;
    }
    let [low, high] = bounds(mesh);
    let (span, most) = (high - low, (high - low).amax());
    // The square of what is very long overflows.
    if span.norm().is_finite() { span.norm() } else { ((span / most).norm() * most).max(most) }
}

/// Least and greatest coordinates of the vertices in use.
pub fn bounds(mesh: &TriangleMesh) -> [Vector3<f64>; 2] {
    let nothing = [Vector3::repeat(f64::INFINITY), Vector3::repeat(f64::NEG_INFINITY)];
    let widened = |[low, high]: [Vector3<f64>; 2], v: &u32| {
        let place = &mesh.vertices[*v as usize].coords;
        [low.inf(place), high.sup(place)]
    };
    let of_run = |run: &[[u32; 3]]| run.iter().flatten().fold(nothing, widened);
    let runs = mesh.triangles.par_chunks(RUN).map(of_run);
    runs.reduce(|| nothing, |a, b| [a[0].inf(&b[0]), a[1].sup(&b[1])])
}

/// Volume by the divergence theorem, about the first vertex so that frames far off lose no digits.
pub fn signed_volume(mesh: &TriangleMesh) -> f64 {
    let Some(&origin) = mesh.vertices.first() else { return 0.0 };
    let of = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|v| mesh.vertices[v as usize] - origin);
        a.dot(&b.cross(&c))
    };
    sum(mesh, of) / 6.0
}

pub fn area(mesh: &TriangleMesh, triangle: &[u32; 3]) -> f64 {
    let [a, b, c] = triangle.map(|v| mesh.vertices[v as usize]);
    0.5 * (b - a).cross(&(c - a)).norm()
}

/// Area of all triangles, in squared units of the input.
pub fn total_area(mesh: &TriangleMesh) -> f64 {
    sum(mesh, |triangle| area(mesh, triangle))
}

/// Over all triangles; in runs, so that it is the same on any number of threads.
fn sum(mesh: &TriangleMesh, of: impl Fn(&[u32; 3]) -> f64 + Sync) -> f64 {
    let of_run = |run: &[[u32; 3]]| run.iter().map(&of).sum::<f64>();
    mesh.triangles.par_chunks(RUN).map(of_run).collect::<Vec<f64>>().into_iter().sum()
}
