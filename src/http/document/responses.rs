//! What the operations answer when all is well.

use std::collections::BTreeMap;

use serde_json::Value;
use utoipa::IntoResponses;
use utoipa::openapi::header::{Header, HeaderBuilder};
use utoipa::openapi::link::{Link, LinkBuilder};
use utoipa::openapi::schema::{ObjectBuilder, Type};
use utoipa::openapi::{Content, ContentBuilder, Ref, RefOr, Response, ResponseBuilder, Schema};

use super::body::binary;
use super::examples;
use crate::output::OutputFormat;

const JSON: &str = "application/json";

/// A list of responses by status as a type that an operation can name.
macro_rules! responses {
    ($($(#[$doc:meta])* $name:ident => [$(($status:literal, $response:expr)),+ $(,)?];)+) => {$(
        $(#[$doc])*
        pub struct $name;

        impl IntoResponses for $name {
            fn responses() -> BTreeMap<String, RefOr<Response>> {
                BTreeMap::from([$(($status.to_owned(), RefOr::T($response.build()))),+])
            }
        }
    )+};
}

responses! {
    Created => [
        ("200", ResponseBuilder::new()
            .description("Of a dry run: the mesh as a job would find it; there is none")
            .content(JSON, content("Inspection", Some(examples::inspection())))),
        ("201", created()),
    ];
    Retried => [("200", job("The job waits again", examples::accepted())
        .header("Retry-After", seconds("Seconds after which to ask for its status")))];
    Events => [
        ("200", ResponseBuilder::new()
            .description("The job's changes; each event's data is a `JobStatus`")
            .content("text/event-stream", Content::new(Some(ObjectBuilder::new().schema_type(Type::String))))),
        ("204", ResponseBuilder::new().description("The job has ended and the client knows how")),
    ];
    Status => [
        ("200", status()),
        ("304", ResponseBuilder::new()
            .description("The client has this status already")
            .header("ETag", header("Strong entity tag"))),
    ];
    Deleted => [
        ("200", job("The job was active and is dismissed now", examples::dismissed())),
        ("204", ResponseBuilder::new().description("The job had ended; it is gone with its files")),
    ];
    List => [("200", list())];
    /// By `Accept`.
    AnyResult => [
        ("200", negotiated(result("The whole centerline", &OutputFormat::ALL))),
        ("206", negotiated(partial(&OutputFormat::ALL))),
        ("304", not_modified()),
    ];
    JsonResult => [
        ("200", result("The whole centerline", &[OutputFormat::Json])),
        ("206", partial(&[OutputFormat::Json])),
        ("304", not_modified()),
    ];
    GltfResult => [
        ("200", result("The whole centerline", &[OutputFormat::Gltf])),
        ("206", partial(&[OutputFormat::Gltf])),
        ("304", not_modified()),
    ];
    GlbResult => [
        ("200", result("The whole centerline", &[OutputFormat::Glb])),
        ("206", partial(&[OutputFormat::Glb])),
        ("304", not_modified()),
    ];
    VtpResult => [
        ("200", result("The whole centerline", &[OutputFormat::Vtp])),
        ("206", partial(&[OutputFormat::Vtp])),
        ("304", not_modified()),
    ];
    Healthy => [("200", ResponseBuilder::new()
        .description("All is well")
        .content(JSON, content("Health", Some(examples::health()))))];
    Metrics => [("200", ResponseBuilder::new()
        .description("Prometheus' text format")
        .content("text/plain", Content::new(Some(ObjectBuilder::new().schema_type(Type::String)))))];
    Dead => [("200", ResponseBuilder::new()
        .description("One page of webhooks that were given up")
        .header("Link", header("`<...>; rel=\"next\"` where there are older ones (RFC 8288)"))
        .content(JSON, content("DeadWebhooks", None)))];
    Resent => [("202", ResponseBuilder::new().description("It is to be tried again"))];
    LimitsAnswer => [("200", ResponseBuilder::new()
        .description("The limits in force")
        .content(JSON, content("Limits", None)))];
    Document => [
        ("200", ResponseBuilder::new()
            .description("The OpenAPI document")
            .header("ETag", header("Strong entity tag"))
            .content("application/yaml", Content::new(Some(ObjectBuilder::new().schema_type(Type::Object))))),
        ("304", ResponseBuilder::new().description("The client has it already")),
    ];
}

/// A header of text.
pub fn header(description: &str) -> Header {
    HeaderBuilder::new()
        .schema(Some(ObjectBuilder::new().schema_type(Type::String)))
        .description(Some(description))
        .build()
}

/// A header of seconds.
fn seconds(description: &str) -> Header {
    HeaderBuilder::new()
        .schema(Some(ObjectBuilder::new().schema_type(Type::Integer)))
        .description(Some(description))
        .build()
}

fn content(schema: &str, example: Option<Value>) -> Content {
    ContentBuilder::new().schema(Some(Ref::from_schema_name(schema))).example(example).build()
}

fn job(description: &str, example: Value) -> ResponseBuilder {
    ResponseBuilder::new().description(description).content(JSON, content("JobStatus", Some(example)))
}

fn created() -> ResponseBuilder {
    job(
        "The job is durable and will run; with `Prefer: wait` it may have ended already",
        examples::accepted(),
    )
    .header("Location", header("The job's path"))
    .header("Retry-After", seconds("Of an active job: seconds after which to ask for its status"))
    .header("Preference-Applied", header("The wait that was granted"))
    .link("status", link("getJob"))
    .link("result", link("getCenterline"))
    .link("cancellation", link("deleteJob"))
}

/// An operation on the job that was answered.
fn link(operation: &str) -> Link {
    LinkBuilder::new().operation_id(operation).parameter("id", "$response.body#/id").build()
}

fn status() -> ResponseBuilder {
    job("The job's status", examples::successful())
        .header("ETag", header("Strong entity tag"))
        .header("Preference-Applied", header("The wait that was granted"))
        .header("Retry-After", seconds("Of an active job: seconds after which to ask again"))
}

fn list() -> ResponseBuilder {
    ResponseBuilder::new()
        .description("One page of jobs")
        .header("Link", header("`<...>; rel=\"next\"` where there are older jobs (RFC 8288)"))
        .content(JSON, content("JobList", Some(examples::page())))
}

/// A result in these formats.
fn result(description: &str, formats: &[OutputFormat]) -> ResponseBuilder {
    let mut response = ResponseBuilder::new()
        .description(description)
        .header("ETag", header("Strong entity tag"))
        .header("Cache-Control", header("A result never changes"))
        .header("Accept-Ranges", header("`bytes`"))
        .header("Content-Encoding", header("The coding that was chosen by `Accept-Encoding`"))
        .header("Vary", header("`accept-encoding`, and `accept` where that chose the form"));
    for format in formats {
        let content = match format {
            OutputFormat::Json => content("ResultDocument", Some(examples::centerline())),
            OutputFormat::Gltf => Content::new(Some(
                ObjectBuilder::new().schema_type(Type::Object).description(Some("glTF 2.0")),
            )),
            OutputFormat::Glb => Content::new(Some(binary())),
            OutputFormat::Vtp => Content::new(Some(
                ObjectBuilder::new().schema_type(Type::String).description(Some("VTK XML PolyData")),
            )),
        };
        response = response.content(format.media_type(), content);
    }
    response
}

fn partial(formats: &[OutputFormat]) -> ResponseBuilder {
    let mut response = ResponseBuilder::new()
        .description("The part that `Range` asked for")
        .header("Content-Range", header("Which bytes these are"))
        .header("ETag", header("Strong entity tag of the whole"));
    for format in formats {
        // A part of JSON is no JSON.
        response = response.content(format.media_type(), Content::new(None::<RefOr<Schema>>));
    }
    response
}

fn negotiated(response: ResponseBuilder) -> ResponseBuilder {
    response.header("Content-Location", header("The path of this form of the result"))
}

fn not_modified() -> ResponseBuilder {
    ResponseBuilder::new()
        .description("The client has it already")
        .header("ETag", header("Strong entity tag"))
        .header("Cache-Control", header("A result never changes"))
}
