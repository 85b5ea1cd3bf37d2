//! Schemas of members that a Rust type alone does not tell.

use utoipa::openapi::schema::{ArrayBuilder, KnownFormat, ObjectBuilder, SchemaFormat, Type};

use crate::mesh::Units;

use super::SCHEMA;

/// The document's own name.
pub(super) fn name_schema() -> ObjectBuilder {
    ObjectBuilder::new().schema_type(Type::String).enum_values(Some([SCHEMA]))
}

/// The units that there are.
pub(super) fn units_schema() -> ObjectBuilder {
    ObjectBuilder::new()
        .schema_type(Type::String)
        .enum_values(Some(Units::ALL.map(Units::name)))
        .description(Some("Unit of the input's coordinates, and so of every length here."))
}

/// Three numbers: utoipa forgets the length of `[f64; 3]`.
pub(super) fn position_schema() -> ArrayBuilder {
    let number = ObjectBuilder::new()
        .schema_type(Type::Number)
        .format(Some(SchemaFormat::KnownFormat(KnownFormat::Double)));
    ArrayBuilder::new()
        .items(number)
        .min_items(Some(3))
        .max_items(Some(3))
        .description(Some("x, y and z in the input's unit and frame"))
}

/// A branch's points.
pub(super) fn points_schema() -> ArrayBuilder {
    ArrayBuilder::new()
        .items(position_schema())
        .min_items(Some(2))
        .description(Some("At least two; the first and the last are the nodes' positions."))
}
