//! From a triangle soup to closed, oriented, manifold surfaces, one a component.
//!
//! Every stage after this one may rely on it: each vertex has one fan of triangles, each
//! half-edge an opposite, normals point out of the lumen, and openings are closed by a cap.

use rayon::prelude::*;

use super::TriangleMesh;
use super::components::{Order, leave_cavities_out, split_components};
use super::corner_table::{CornerTable, NONE, next, previous};
use super::edge_groups::EdgeGroups;
use super::flat_caps;
use super::matching::{MatchReport, match_half_edges};
use super::measures::{area, diagonal, signed_volume, total_area};
use super::openings::cap;
use super::outlying::outlying;
use super::snapping::snap;

pub use super::openings::Opening;
pub use super::sites::Sites;

/// A mesh whose triangles have no more has no area, in squared diagonals.
pub(super) const NO_AREA: f64 = 1e-14;

/// Longest diagonal: squares of areas are compared in double precision.
const HUGE: f64 = 1e75;

/// Why a triangle soup is not a surface.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PreparationError {
    #[error("the mesh has no triangles")]
    NoTriangles,
    #[error("all {triangles} triangles have no area")]
    AllDegenerate { triangles: usize },
    #[error("the rest of the mesh has no size beside {0} vertices, so far out do they lie")]
    FarOut(Sites),
    #[error("{0} vertices have a coordinate that is not a finite number")]
    NotFinite(Sites),
    #[error("{0} triangles name a vertex that is not there")]
    OutOfRange(Sites),
    #[error("the surface's diagonal is {diagonal:e}: squares of areas would overflow")]
    OutOfScale { diagonal: f64 },
}

/// One connected, closed, oriented, manifold surface.
#[derive(Debug, Clone, Default)]
pub struct Surface {
    /// Its vertices and triangles; those that cap openings come last.
    pub mesh: TriangleMesh,
    pub corners: CornerTable,
    /// In the order of their caps.
    pub openings: Vec<Opening>,
}

impl Surface {
    /// Handles of the closed surface (Euler's formula).
    pub fn genus(&self) -> usize {
        let (v, f) = (self.mesh.vertices.len() as i64, self.mesh.triangles.len() as i64);
        let euler = v - 3 * f / 2 + f;
        ((2 - euler) / 2).max(0) as usize
    }

    /// Cuts that the mesh leaves open.
    pub fn open_cuts(&self) -> usize {
        self.openings.iter().filter(|opening| !opening.was_closed).count()
    }

    /// Diagonal of the bounding box, in the input's unit.
    pub fn diagonal(&self) -> f64 {
        diagonal(&self.mesh)
    }

    /// Area of the wall, caps included, in squared units of the input.
    pub fn area(&self) -> f64 {
        total_area(&self.mesh)
    }

    /// Enclosed volume, in cubed units of the input.
    pub fn volume(&self) -> f64 {
        signed_volume(&self.mesh)
    }
}

/// The input as surfaces, and what was done to it.
#[derive(Debug, Clone, Default)]
pub struct Prepared {
    /// In the order of each component's first triangle.
    pub components: Vec<Surface>,
    pub report: PreparationReport,
}

/// Counts for the result's summary and warnings.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct PreparationReport {
    pub vertices: usize,
    pub triangles: usize,
    pub diagonal: f64,
    /// Vertices of a mesh in pieces that became one with another next to them.
    pub snapped_vertices: Sites,
    /// Triangles left out.
    pub degenerate: Sites,
    /// Triangles left out.
    pub duplicates: Sites,
    /// Vertices doubled.
    pub split_vertices: Sites,
    /// Holes in the wall that were closed, each by a vertex of its rim.
    pub holes: Sites,
    /// Closed surfaces inside another that were left out, each by a vertex.
    pub cavities: Sites,
    pub inverted_components: usize,
    pub matching: MatchReport,
}

/// Makes closed manifold surfaces of a welded triangle list.
///
/// A mesh that rounding took apart is joined, degenerate and duplicate triangles go, orientation is made consistent and
/// outward, edges and vertices where surfaces touch come apart, openings are capped, holes in the wall closed, surfaces
/// inside another left out. O(n log n).
pub fn prepare(mesh: &TriangleMesh) -> Result<Prepared, PreparationError> {
    prepare_while(mesh, || Ok(()))
}

/// The same, as long as `go_on` is no error: it is asked between the steps, each a few passes over the mesh.
///
/// # Errors
/// Those of [`prepare`], and that of `go_on`.
pub fn prepare_while<E: From<PreparationError> + Send>(
    mesh: &TriangleMesh,
    go_on: impl Fn() -> Result<(), E> + Sync,
) -> Result<Prepared, E> {
    if mesh.triangles.is_empty() {
        return Err(PreparationError::NoTriangles.into());
    }
    check(mesh)?;
    go_on()?;
    let mut report = PreparationReport {
        vertices: mesh.vertices.len(),
        triangles: mesh.triangles.len(),
        ..Default::default()
    };
    let (mut soup, kept) = with_area(mesh, &mut report)?;
    go_on()?;
    let plain = EdgeGroups::plain_pairs_of(&soup);
    go_on()?;
    let mut opposite = plain.unwrap_or_else(|| matched(&mut soup, kept, &mut report));
    go_on()?;
    let names;
    (report.split_vertices, names) = split_fans(&mut soup, &opposite);
    go_on()?;
    let (openings, holes, order) = close(&mut soup, &mut opposite, &go_on)?;
    report.holes = holes.renamed(&names);
    go_on()?;
    let parts = split_components(&soup, &opposite, openings, order, &go_on)?;
    go_on()?;
    let components = leave_cavities_out(parts, &names, &mut report);
    Ok(Prepared { components, report })
}

/// The triangles with three different corners, near vertices of a mesh in pieces made one; and which triangles of the
/// mesh they are.
fn with_area(
    mesh: &TriangleMesh,
    report: &mut PreparationReport,
) -> Result<(TriangleMesh, Vec<u32>), PreparationError> {
    let snapped = snap(mesh);
    let given = snapped.as_ref().map_or(&mesh.triangles, |(triangles, _)| triangles);
    report.snapped_vertices = snapped.as_ref().map_or_else(Sites::default, |(_, moved)| *moved);
    let degenerate = |t: &u32| {
        let [a, b, c] = given[*t as usize];
        a == b || b == c || c == a
    };
    report.degenerate = (0..given.len() as u32).filter(degenerate).collect();
    let kept: Vec<u32> = (0..given.len() as u32).filter(|t| !degenerate(t)).collect();
    let triangles = kept.iter().map(|&t| given[t as usize]).collect();
    let soup = TriangleMesh { vertices: mesh.vertices.clone(), triangles };
    report.diagonal = diagonal(&soup);
    let diagonal = report.diagonal;
    let is_huge = diagonal > HUGE;
    if is_huge || soup.triangles.iter().all(|t| area(&soup, t) <= NO_AREA * diagonal * diagonal) {
        let (far, triangles) = (outlying(mesh), mesh.triangles.len());
        return Err(match far.count {
            0 if is_huge => PreparationError::OutOfScale { diagonal },
            0 => PreparationError::AllDegenerate { triangles },
            _ => PreparationError::FarOut(far),
        });
    }
    Ok((soup, kept))
}

/// Leaves out triangles that came before, and matches the half-edges of the others; `kept`: which triangles of the mesh
/// those of the soup are.
fn matched(soup: &mut TriangleMesh, mut kept: Vec<u32>, report: &mut PreparationReport) -> Vec<u32> {
    let repeated = repeated(&soup.triangles);
    report.duplicates = repeated.iter().map(|&t| kept[t as usize]).collect();
    if !repeated.is_empty() {
        let mut stays = vec![true; kept.len()];
        repeated.iter().for_each(|&t| stays[t as usize] = false);
        let numbers = (0..kept.len()).filter(|&t| stays[t]);
        (kept, soup.triangles) = numbers.map(|t| (kept[t], soup.triangles[t])).unzip();
    }
    let (opposite, matching) = match_half_edges(soup);
    report.matching = MatchReport {
        flipped: matching.flipped.renamed(&kept),
        non_manifold_edges: matching.non_manifold_edges.renamed(&kept),
        conflicting_edges: matching.conflicting_edges.renamed(&kept),
    };
    opposite
}

/// Opens flat caps, caps all openings, and puts the vertices in order: the openings, the holes of the wall, the order.
fn close<E: Send>(
    soup: &mut TriangleMesh,
    opposite: &mut Vec<u32>,
    go_on: &(impl Fn() -> Result<(), E> + Sync),
) -> Result<(Vec<Opening>, Sites, Order), E> {
    // Of a mesh that needs no cap the vertices are put in order while flat caps are looked for.
    let is_closed = !opposite.contains(&NONE);
    let (seen, against) = (&*soup, &**opposite);
    let order = || is_closed.then(|| Order::of(seen, against, go_on)).transpose();
    let (caps, order) = rayon::join(|| flat_caps::find(seen, against), order);
    let order = order?.filter(|_| caps.triangles.is_empty());
    go_on()?;
    let rims = caps.take_out(soup, opposite);
    let (openings, holes) = cap(soup, opposite, &rims);
    go_on()?;
    let order = order.map_or_else(|| Order::of(soup, opposite, go_on), Ok)?;
    Ok((openings, holes, order))
}

/// Coordinates are finite and indices in range: a reader sees to that, another caller may not.
fn check(mesh: &TriangleMesh) -> Result<(), PreparationError> {
    let finite = |v: &u32| mesh.vertices[*v as usize].iter().all(|c| c.is_finite());
    let vertices: Sites = (0..mesh.vertices.len() as u32).filter(|v| !finite(v)).collect();
    if vertices.count > 0 {
        return Err(PreparationError::NotFinite(vertices));
    }
    let known = |t: &u32| mesh.triangles[*t as usize].iter().all(|&v| (v as usize) < mesh.vertices.len());
    let triangles: Sites = (0..mesh.triangles.len() as u32).filter(|t| !known(t)).collect();
    if triangles.count > 0 {
        return Err(PreparationError::OutOfRange(triangles));
    }
    Ok(())
}

/// The triangles whose corners are those of one before; ascending.
fn repeated(triangles: &[[u32; 3]]) -> Vec<u32> {
    let key = |(t, corners): (usize, &[u32; 3])| {
        let mut key = *corners;
        key.sort_unstable();
        (key, t as u32)
    };
    let mut sorted: Vec<([u32; 3], u32)> = triangles.iter().enumerate().map(key).collect();
    sorted.par_sort_unstable();
    let twins = sorted.windows(2).filter(|pair| pair[0].0 == pair[1].0);
    let mut repeated: Vec<u32> = twins.map(|pair| pair[1].1).collect();
    repeated.sort_unstable();
    repeated
}

/// Gives each fan of triangles around a vertex a vertex of its own; returns the vertices that were doubled, and each
/// vertex's number before.
pub(super) fn split_fans(mesh: &mut TriangleMesh, opposite: &[u32]) -> (Sites, Vec<u32>) {
    let mut names: Vec<u32> = (0..mesh.vertices.len() as u32).collect();
    let mut owner = vec![NONE; mesh.vertices.len()];
    let mut seen = vec![false; 3 * mesh.triangles.len()];
    let mut doubled = Sites::default();
    for start in 0..3 * mesh.triangles.len() as u32 {
        if seen[start as usize] {
            continue;
        }
        let v = mesh.triangles[(start / 3) as usize][(start % 3) as usize];
        let mut name = v;
        if owner[v as usize] != NONE {
            name = mesh.vertices.len() as u32;
            mesh.vertices.push(mesh.vertices[v as usize]);
            names.push(v);
            doubled.add(v);
        } else {
            owner[v as usize] = start;
        }
        let triangles = &mut mesh.triangles;
        for_each_in_fan(opposite, start, |h| {
            seen[h as usize] = true;
            triangles[(h / 3) as usize][(h % 3) as usize] = name;
        });
    }
    (doubled, names)
}

/// Calls `visit` with each half-edge that starts at the same corner of one fan as `start`.
fn for_each_in_fan(opposite: &[u32], start: u32, mut visit: impl FnMut(u32)) {
    visit(start);
    let mut h = opposite[previous(start) as usize];
    while h != NONE && h != start {
        visit(h);
        h = opposite[previous(h) as usize];
    }
    if h == NONE {
        h = opposite[start as usize];
        while h != NONE {
            h = next(h);
            visit(h);
            h = opposite[h as usize];
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Point3, Vector3};

    use super::*;

    /// A cube of edge 1, as two triangles a side.
    fn cube() -> TriangleMesh {
        let vertices = (0..8)
            .map(|i| Point3::new(f64::from(i & 1), f64::from(i >> 1 & 1), f64::from(i >> 2 & 1)))
            .collect();
        let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let triangles = quads.iter().flat_map(|q| [[q[0], q[1], q[2]], [q[0], q[2], q[3]]]).collect();
        TriangleMesh { vertices, triangles }
    }

    fn check_manifold(surface: &Surface) {
        let table = &surface.corners;
        for h in 0..table.half_edges() as u32 {
            let o = table.opposite(h);
            assert_eq!(table.opposite(o), h);
            assert_eq!((table.origin(h), table.target(h)), (table.target(o), table.origin(o)));
        }
        let fans: usize = (0..table.vertices() as u32).map(|v| table.star(v).count()).sum();
        assert_eq!(fans, table.half_edges(), "every vertex has one fan");
    }

    #[test]
    fn a_cube_is_closed_and_has_its_volume() {
        let prepared = prepare(&cube()).unwrap();
        let [surface] = &prepared.components[..] else { panic!("one component") };
        check_manifold(surface);
        assert!((surface.volume() - 1.0).abs() < 1e-12);
        assert_eq!((surface.genus(), surface.openings.len()), (0, 0));
    }

    #[test]
    fn an_inverted_cube_is_turned_outward() {
        let mut mesh = cube();
        mesh.triangles.iter_mut().for_each(|t| t.swap(0, 1));
        let prepared = prepare(&mesh).unwrap();
        check_manifold(&prepared.components[0]);
        assert!(prepared.components[0].volume() > 0.0);
        assert_eq!(prepared.report.inverted_components, 1);
    }

    #[test]
    fn an_open_cube_is_capped() {
        let mut mesh = cube();
        mesh.triangles.truncate(10);
        let prepared = prepare(&mesh).unwrap();
        let surface = &prepared.components[0];
        check_manifold(surface);
        assert_eq!((surface.openings.len(), surface.openings[0].rim.len()), (1, 4));
        assert!((surface.volume() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn cubes_that_touch_at_a_vertex_are_two_components() {
        let mut mesh = cube();
        let shift = Vector3::repeat(1.0);
        mesh.vertices.extend(cube().vertices.iter().map(|p| p + shift));
        // Vertex 7 of the first is vertex 0 of the second.
        let second = cube().triangles.into_iter().map(|t| t.map(|v| if v == 0 { 7 } else { v + 8 }));
        mesh.triangles.extend(second);
        let prepared = prepare(&mesh).unwrap();
        assert_eq!(prepared.components.len(), 2);
        assert_eq!((prepared.report.split_vertices.count, prepared.report.split_vertices.first[0]), (1, 7));
        prepared.components.iter().for_each(check_manifold);
    }

    #[test]
    fn duplicates_and_degenerates_go() {
        let mut mesh = cube();
        mesh.triangles.extend([[0, 2, 3], [2, 3, 0], [1, 1, 2]]);
        let prepared = prepare(&mesh).unwrap();
        let report = &prepared.report;
        assert_eq!((report.duplicates.count, report.duplicates.list()), (2, "12, 13".to_owned()));
        assert_eq!((report.degenerate.count, report.degenerate.list()), (1, "14".to_owned()));
        assert!((prepared.components[0].volume() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn nothing_and_flat_nothing_are_errors() {
        assert_eq!(prepare(&TriangleMesh::default()).unwrap_err(), PreparationError::NoTriangles);
        let line = TriangleMesh { vertices: vec![Point3::origin(); 3], triangles: vec![[0, 1, 2]] };
        assert_eq!(prepare(&line).unwrap_err(), PreparationError::AllDegenerate { triangles: 1 });
    }
}
