//! VTP, VTK's XML PolyData (*The VTK User's Guide*, "XML File Formats"; written by VTK to this day).
//!
//! Own reader on `quick-xml`: the crate for it reads neither compressed nor raw appended files
//! as VTK 9 writes them. [`super::vtp_structure`] reads the structure, [`super::vtp_data`] the numbers.

use super::surface::Surface;
use super::vtp_data::Decoder;
use super::vtp_structure::{FORMAT, Piece, with_pieces};
use super::{Limits, ReadError};
use crate::mesh::TriangleMesh;

pub(super) fn read(bytes: &[u8], limits: &Limits) -> Result<TriangleMesh, ReadError> {
    with_pieces(bytes, limits, |pieces, decoder| {
        let mut surface = Surface::new(FORMAT, limits);
        for piece in pieces {
            add_piece(&mut surface, decoder, piece)?;
        }
        let has_lines = pieces.iter().any(|piece| piece.lines.count > 0);
        surface.finish(if has_lines { ", only lines" } else { "" })
    })
}

fn add_piece(surface: &mut Surface<'_>, decoder: &Decoder<'_>, piece: &Piece<'_>) -> Result<(), ReadError> {
    let first = surface.vertices();
    piece.each_point(decoder, surface, Surface::declare_vertices, Surface::vertex)?;
    piece.polygons.each(decoder, first, surface, Surface::declare_faces, Surface::polygon)?;
    piece.strips.each(decoder, first, surface, Surface::declare_faces, Surface::strip)
}
