//! The lines of a VTP: centerlines as VMTK writes them, a polyline a cell, the radius as data of the points.

use nalgebra::Point3;

use super::surface::check_limit;
use super::vtp_data::Decoder;
use super::vtp_structure::{FORMAT, Piece, check_used_up, malformed, with_pieces};
use super::{Limits, ReadError};

/// Polylines over one list of points, in the file's unit and frame.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Polylines {
    pub points: Vec<Point3<f64>>,
    /// Of the largest inscribed sphere at each point (`MaximumInscribedSphereRadius`, or `Radius`).
    pub radii: Vec<f64>,
    /// The points of each line, by number.
    pub lines: Vec<Vec<usize>>,
}

/// Reads the polylines of a VTP; `limits.vertices` bounds their points.
///
/// # Errors
/// [`ReadError`] when the bytes are no VTP, hold no lines, or their points have no radius.
pub fn read_polylines(bytes: &[u8], limits: &Limits) -> Result<Polylines, ReadError> {
    with_pieces(bytes, limits, |pieces, decoder| {
        let mut sink = Sink { found: Polylines::default(), most: limits.vertices };
        for piece in pieces {
            sink.add_piece(piece, decoder)?;
        }
        if sink.found.lines.is_empty() {
            return Err(malformed("it has no lines"));
        }
        Ok(sink.found)
    })
}

struct Sink {
    found: Polylines,
    /// Points, and corners of lines, that are taken.
    most: usize,
}

impl Sink {
    fn add_piece(&mut self, piece: &Piece<'_>, decoder: &Decoder<'_>) -> Result<(), ReadError> {
        let first = self.found.points.len();
        piece.each_point(decoder, self, Self::declare_points, Self::point)?;
        piece.lines.each(decoder, first, self, Self::declare_lines, Self::line)?;
        if piece.points == 0 {
            return Ok(());
        }
        let missing = || malformed("its points have no MaximumInscribedSphereRadius or Radius");
        let array = piece.radii.as_ref().ok_or_else(missing)?;
        let data = decoder.decode(array, Some(piece.points))?;
        let mut values = data.values(decoder.order);
        for _ in 0..piece.points {
            let radius = values.real(array.scalar)?;
            if !(radius.is_finite() && radius >= 0.0) {
                return Err(malformed("a radius is no positive number"));
            }
            self.found.radii.push(radius);
        }
        check_used_up(&mut values)
    }

    fn declare_points(&mut self, more: usize, backed: usize) -> Result<(), ReadError> {
        check_limit(FORMAT, "vertices", self.found.points.len().saturating_add(more), self.most)?;
        self.found.points.reserve_exact(more.min(backed));
        Ok(())
    }

    fn point(&mut self, coordinates: [f64; 3]) -> Result<(), ReadError> {
        if coordinates.iter().any(|coordinate| !coordinate.is_finite()) {
            return Err(ReadError::NonFinite { format: FORMAT, vertex: self.found.points.len() });
        }
        self.found.points.push(Point3::from(coordinates));
        Ok(())
    }

    fn declare_lines(&mut self, more: usize, _: usize) -> Result<(), ReadError> {
        check_limit(FORMAT, "lines", self.found.lines.len().saturating_add(more), self.most)
    }

    fn line(&mut self, corners: &[i64]) -> Result<(), ReadError> {
        let count = self.found.points.len();
        let point = |&corner: &i64| usize::try_from(corner).ok().filter(|&point| point < count);
        let line: Option<Vec<usize>> = corners.iter().map(point).collect();
        self.found
            .lines
            .push(line.ok_or_else(|| malformed("a line goes through a point that is not there"))?);
        Ok(())
    }
}
