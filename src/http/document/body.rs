//! The body of a submission.

use serde_json::json;
use utoipa::openapi::encoding::EncodingBuilder;
use utoipa::openapi::request_body::{RequestBody, RequestBodyBuilder};
use utoipa::openapi::schema::{
    AdditionalProperties, KnownFormat, Object, ObjectBuilder, Schema, SchemaFormat, Type,
};
use utoipa::openapi::{Content, ContentBuilder, Ref, Required};

use super::super::upload::{FORM_TYPE, MESH_TYPES};
use super::parameters::{job_parameters, points_schema};
use crate::centerline::POINTS;

/// The schema of a form's part `parameters`.
pub const PARAMETERS: &str = "JobParameters";

/// Bytes of some format.
pub fn binary() -> Object {
    ObjectBuilder::new()
        .schema_type(Type::String)
        .format(Some(SchemaFormat::KnownFormat(KnownFormat::Binary)))
        .build()
}

/// A mesh as raw bytes, or in a form.
pub fn mesh() -> RequestBody {
    let mut body = RequestBodyBuilder::new()
        .description(Some(
            "STL (binary or ASCII), OBJ, PLY, glTF, GLB, VTP, legacy VTK polydata or OFF; the content decides. \
             VTP and OFF go as `application/octet-stream`, VTP as `model/vtk` too.",
        ))
        .required(Some(Required::True));
    for media_type in MESH_TYPES {
        body = body.content(media_type, Content::new(Some(binary())));
    }
    body.content(FORM_TYPE, form()).build()
}

fn form() -> Content {
    let schema = ObjectBuilder::new()
        .schema_type(Type::Object)
        .property("mesh", binary())
        .property("parameters", Ref::from_schema_name(PARAMETERS))
        .required("mesh")
        .additional_properties(Some(AdditionalProperties::<Schema>::FreeForm(false)));
    ContentBuilder::new()
        .schema(Some(schema))
        .encoding(
            "parameters",
            EncodingBuilder::new().content_type(Some("application/json".to_owned())).build(),
        )
        .build()
}

/// The query's parameters as one object.
pub fn parameters_schema() -> Schema {
    let mut object = ObjectBuilder::new()
        .schema_type(Type::Object)
        .description(Some("How to extract; whatever is left out takes the preset's value."))
        .additional_properties(Some(AdditionalProperties::<Schema>::FreeForm(false)))
        .examples([json!({"units": "mm", "preset": "default", "omega": 0.75})]);
    for (name, schema) in job_parameters() {
        object = object.property(name, schema);
    }
    for spec in POINTS {
        object = object.property(spec.name, points_schema(spec));
    }
    Schema::Object(object.build())
}
