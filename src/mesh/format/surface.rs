//! What every reader fills: vertices and polygons, checked as they come.

use nalgebra::Point3;

use super::{Format, Limits, ReadError, polygon};
use crate::mesh::{TriangleMesh, Welder, weld};

/// Vertex indices are `u32`, and the welder's table holds up to 2^31 of them.
const MOST_VERTICES: usize = 1 << 31;

/// Fails when `found` (of `what`) exceeds `limit`.
pub(super) fn check_limit(
    format: Format,
    what: &'static str,
    found: usize,
    limit: usize,
) -> Result<(), ReadError> {
    if found > limit {
        return Err(ReadError::TooLarge { format, what, found: found as u64, limit: limit as u64 });
    }
    Ok(())
}

/// An indexed surface in the making: vertices first, then the polygons between them.
pub(super) struct Surface<'a> {
    format: Format,
    limits: &'a Limits,
    mesh: TriangleMesh,
    /// Polygons and strips so far; names them in errors.
    faces: usize,
    /// Of the polygon at hand.
    corners: Vec<u32>,
    points: Vec<Point3<f64>>,
}

impl<'a> Surface<'a> {
    pub(super) fn new(format: Format, limits: &'a Limits) -> Self {
        let mesh = TriangleMesh::default();
        Surface { format, limits, mesh, faces: 0, corners: Vec::new(), points: Vec::new() }
    }

    pub(super) fn format(&self) -> Format {
        self.format
    }

    /// How many vertices there are.
    pub(super) fn vertices(&self) -> usize {
        self.mesh.vertices.len()
    }

    /// Makes room for `more` vertices; `backed` is how many the file's bytes can hold at most.
    pub(super) fn declare_vertices(&mut self, more: usize, backed: usize) -> Result<(), ReadError> {
        let limit = self.limits.vertices.min(MOST_VERTICES);
        check_limit(self.format, "vertices", self.vertices().saturating_add(more), limit)?;
        self.mesh.vertices.reserve_exact(more.min(backed));
        Ok(())
    }

    /// As [`Self::declare_vertices`], for faces; each is taken for one triangle.
    pub(super) fn declare_faces(&mut self, more: usize, backed: usize) -> Result<(), ReadError> {
        let triangles = self.mesh.triangles.len().saturating_add(more);
        check_limit(self.format, "faces", triangles, self.limits.triangles)?;
        self.mesh.triangles.reserve(more.min(backed));
        Ok(())
    }

    #[inline]
    pub(super) fn vertex(&mut self, coordinates: [f64; 3]) -> Result<(), ReadError> {
        let vertex = self.vertices();
        if coordinates.iter().any(|coordinate| !coordinate.is_finite()) {
            return Err(ReadError::NonFinite { format: self.format, vertex });
        }
        check_limit(self.format, "vertices", vertex + 1, self.limits.vertices.min(MOST_VERTICES))?;
        self.mesh.vertices.push(Point3::from(coordinates));
        Ok(())
    }

    #[inline]
    pub(super) fn triangle(&mut self, corners: [i64; 3]) -> Result<(), ReadError> {
        let triangle = [self.index(corners[0])?, self.index(corners[1])?, self.index(corners[2])?];
        self.faces += 1;
        self.push(triangle)
    }

    /// Takes a polygon of any number of corners; fewer than three have no area and add nothing.
    pub(super) fn polygon(&mut self, corners: &[i64]) -> Result<(), ReadError> {
        if let &[a, b, c] = corners {
            return self.triangle([a, b, c]);
        }
        let mut indices = std::mem::take(&mut self.corners);
        let mut points = std::mem::take(&mut self.points);
        indices.clear();
        points.clear();
        for &corner in corners {
            let index = self.index(corner)?;
            indices.push(index);
            points.push(self.mesh.vertices[index as usize]);
        }
        let triangles = self.mesh.triangles.len() + corners.len().saturating_sub(2);
        check_limit(self.format, "triangles", triangles, self.limits.triangles)?;
        polygon::triangulate(&points, |triangle| {
            self.mesh.triangles.push(triangle.map(|corner| indices[corner]));
        });
        self.faces += 1;
        (self.corners, self.points) = (indices, points);
        Ok(())
    }

    /// Takes a triangle strip: every second triangle is wound the other way.
    pub(super) fn strip(&mut self, corners: &[i64]) -> Result<(), ReadError> {
        for (place, window) in corners.windows(3).enumerate() {
            let [a, b, c] = [self.index(window[0])?, self.index(window[1])?, self.index(window[2])?];
            self.push(if place % 2 == 0 { [a, b, c] } else { [b, a, c] })?;
        }
        self.faces += 1;
        Ok(())
    }

    /// The mesh, welded; `instead` says what the file has in place of polygons.
    pub(super) fn finish(self, instead: &'static str) -> Result<TriangleMesh, ReadError> {
        if self.mesh.triangles.is_empty() {
            return Err(ReadError::NoPolygons { format: self.format, instead });
        }
        Ok(weld(self.mesh))
    }

    #[inline]
    fn index(&self, index: i64) -> Result<u32, ReadError> {
        let vertices = self.vertices();
        match u32::try_from(index) {
            Ok(vertex) if (vertex as usize) < vertices => Ok(vertex),
            _ => Err(ReadError::IndexOutOfRange { format: self.format, face: self.faces, index, vertices }),
        }
    }

    #[inline]
    fn push(&mut self, triangle: [u32; 3]) -> Result<(), ReadError> {
        check_limit(self.format, "triangles", self.mesh.triangles.len() + 1, self.limits.triangles)?;
        self.mesh.triangles.push(triangle);
        Ok(())
    }
}

/// A triangle soup in the making: three coordinates a corner, welded as they come.
pub(super) struct Soup<'a> {
    format: Format,
    limits: &'a Limits,
    welder: Welder,
    triangles: Vec<[u32; 3]>,
    /// Triangles of the file before its first.
    before: usize,
}

impl<'a> Soup<'a> {
    /// `triangles` is backed by the size of the file, so that room for them can be made.
    pub(super) fn new(format: Format, limits: &'a Limits, triangles: usize) -> Self {
        Self::after(0, format, limits, triangles)
    }

    /// Of a part of a file that has so many triangles before it.
    pub(super) fn after(before: usize, format: Format, limits: &'a Limits, triangles: usize) -> Self {
        // A closed surface has half as many vertices as triangles.
        let welder = Welder::with_capacity(triangles / 2 + 2);
        Soup { format, limits, welder, triangles: Vec::with_capacity(triangles), before }
    }

    pub(super) fn triangle(&mut self, corners: [[f64; 3]; 3]) -> Result<(), ReadError> {
        let mut indices = [0; 3];
        for (place, corner) in corners.into_iter().enumerate() {
            if corner.iter().any(|coordinate| !coordinate.is_finite()) {
                let vertex = (self.before + self.triangles.len()) * 3 + place;
                return Err(ReadError::NonFinite { format: self.format, vertex });
            }
            indices[place] = self.welder.insert(Point3::from(corner));
        }
        self.triangles.push(indices);
        self.check()
    }

    /// Takes the triangles of the file's next part.
    pub(super) fn append(&mut self, next: Self) -> Result<(), ReadError> {
        let names: Vec<u32> =
            next.welder.into_vertices().into_iter().map(|point| self.welder.insert(point)).collect();
        self.triangles.extend(next.triangles.into_iter().map(|corners| corners.map(|v| names[v as usize])));
        self.check()
    }

    fn check(&self) -> Result<(), ReadError> {
        let most = self.limits.vertices.min(MOST_VERTICES);
        check_limit(self.format, "vertices", self.welder.len(), most)?;
        check_limit(self.format, "triangles", self.triangles.len(), self.limits.triangles)
    }

    pub(super) fn finish(self) -> Result<TriangleMesh, ReadError> {
        if self.triangles.is_empty() {
            return Err(ReadError::NoPolygons { format: self.format, instead: "" });
        }
        Ok(TriangleMesh { vertices: self.welder.into_vertices(), triangles: self.triangles })
    }
}
