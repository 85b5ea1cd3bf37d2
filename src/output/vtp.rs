//! VTK XML PolyData (VTK's file formats, "XML File Formats"), for ParaView, 3D Slicer and those who work with VMTK: one
//! polyline a branch, in the input's own unit and frame.
//!
//! Its points carry `MaximumInscribedSphereRadius`, the name that VMTK gives it, and `EquivalentRadius`; its lines
//! `BranchId`, `FromNode`, `ToNode` and `Length`. Numbers are text, in the shortest form that reads back to the same
//! `f64`: points of branches that meet are equal.

use std::fmt::{Debug, Write as _};

use super::json::check_finite;
use super::{BranchRecord, OutputError, ResultDocument};

/// Writes the branches as polylines. The rest of the document has no place there.
///
/// # Errors
/// [`OutputError::NotFinite`].
pub fn write_vtp(document: &ResultDocument) -> Result<Vec<u8>, OutputError> {
    check_finite(document)?;
    let branches = &document.branches;
    let points = || branches.iter().flat_map(|branch| &branch.points);
    let count = points().count();
    let mut text = format!(
        "<?xml version=\"1.0\"?>\n<VTKFile type=\"PolyData\" version=\"1.0\" byte_order=\"LittleEndian\" \
         header_type=\"UInt64\">\n<PolyData>\n<Piece NumberOfPoints=\"{count}\" NumberOfVerts=\"0\" \
         NumberOfLines=\"{}\" NumberOfStrips=\"0\" NumberOfPolys=\"0\">\n",
        branches.len()
    );
    text.push_str("<PointData Scalars=\"MaximumInscribedSphereRadius\">\n");
    array(
        &mut text,
        "Float64",
        "MaximumInscribedSphereRadius",
        branches.iter().flat_map(|branch| &branch.radii),
    );
    array(&mut text, "Float64", "EquivalentRadius", branches.iter().flat_map(equivalent_radii));
    text.push_str("</PointData>\n<CellData>\n");
    array(&mut text, "Int64", "BranchId", branches.iter().map(|branch| branch.id));
    array(&mut text, "Int64", "FromNode", branches.iter().map(|branch| branch.from));
    array(&mut text, "Int64", "ToNode", branches.iter().map(|branch| branch.to));
    array(&mut text, "Float64", "Length", branches.iter().map(|branch| branch.length));
    text.push_str("</CellData>\n<Points>\n");
    array(&mut text, "Float64\" NumberOfComponents=\"3", "Points", points().flatten());
    text.push_str("</Points>\n<Lines>\n");
    array(&mut text, "Int64", "connectivity", 0..count);
    let ends = branches.iter().scan(0, |end, branch| {
        *end += branch.points.len();
        Some(*end)
    });
    array(&mut text, "Int64", "offsets", ends);
    text.push_str("</Lines>\n</Piece>\n</PolyData>\n</VTKFile>\n");
    Ok(text.into_bytes())
}

/// Those of a branch; a document that knows spheres alone has circles for sections.
fn equivalent_radii(branch: &BranchRecord) -> &[f64] {
    if branch.equivalent_radii.is_empty() { &branch.radii } else { &branch.equivalent_radii }
}

/// One `DataArray`; its type may carry further attributes. `Debug` writes the smallest and largest numbers with an exponent.
fn array(text: &mut String, kind: &str, name: &str, values: impl Iterator<Item: Debug>) {
    let _ = write!(text, "<DataArray type=\"{kind}\" Name=\"{name}\" format=\"ascii\">");
    for (place, value) in values.enumerate() {
        let _ = write!(text, "{}{value:?}", if place == 0 { "" } else { " " });
    }
    text.push_str("</DataArray>\n");
}
