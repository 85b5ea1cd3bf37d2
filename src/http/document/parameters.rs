//! Parameters of the operations; the method's come from its table.

use serde_json::{Value, json};
use utoipa::IntoParams;
use utoipa::openapi::Required;
use utoipa::openapi::path::{Parameter, ParameterBuilder, ParameterIn, ParameterStyle};
use utoipa::openapi::schema::{ArrayBuilder, KnownFormat, Object, ObjectBuilder, Schema, SchemaFormat, Type};

use super::super::idempotency::{IDEMPOTENCY_KEY, KEY_PATTERN};
use super::super::limits::Limits;
use super::super::parameters::{CLIENT_REFERENCE, DRY_RUN, NAME, PRESET, PRIORITY, UNITS};
use super::super::prefer::PREFER;
use crate::centerline::{FARTHEST, POINTS, ParameterKind, ParameterSpec, PointsSpec, Preset, TABLE};
use crate::jobs::{JobStatus, Priority, TRACEPARENT};
use crate::mesh::Units;
use crate::output::OutputFormat;

/// A list of parameters as a type that an operation can name.
macro_rules! parameters {
    ($($(#[$doc:meta])* $name:ident => $list:expr;)+) => {$(
        $(#[$doc])*
        pub struct $name;

        impl IntoParams for $name {
            fn into_params(_: impl Fn() -> Option<ParameterIn>) -> Vec<Parameter> {
                $list
            }
        }
    )+};
}

parameters! {
    /// The id in a job's path.
    JobPath => vec![job_id()];
    /// What a submission takes in its query.
    SubmitQuery => job_parameters()
        .into_iter()
        .map(|(name, schema)| query(&name, schema))
        .chain(POINTS.iter().map(points_query))
        .collect();
    /// Filters and paging of the list.
    ListParameters => list();
    /// Paging of the webhooks that were given up.
    DeadParameters => vec![
        query("limit", limit("Webhooks on a page")),
        query("cursor", webhook().description(Some("Where the page begins: follow `Link` rather than make one")).build()),
    ];
    /// The id in a webhook's path.
    WebhookPath => vec![
        path_id("The webhook's id, as its messages and the list have it", webhook().build(), "msg_5f2b0c9a3d1e4f60718293a4b5c6d7e8"),
    ];
    /// By which a client finds its request again.
    OriginHeaders => vec![
        header(
            IDEMPOTENCY_KEY.as_str(),
            "Sent again with the same mesh and parameters, it answers with the first job, as long as that is kept",
            ObjectBuilder::new().schema_type(Type::String).pattern(Some(KEY_PATTERN)).build(),
            json!("2f6f1b0e-6f0c-4b57-9a53-0d6f1b7a8c21"),
        ),
        header(
            "Content-Digest",
            "The SHA-256 of a raw body (RFC 9530), which is held against it; other algorithms are not looked at",
            text(),
            json!("sha-256=:47DEQpj8HBSa+/TImW+5JCeuQeRkm5NMpJWZG3hSuFU=:"),
        ),
        header(
            "X-Request-ID",
            "Comes back in the job's status, where it has 1 to 128 visible ASCII characters",
            text(),
            json!("pacs-4711"),
        ),
        header(
            TRACEPARENT,
            "Where the operator has traces on, the job's belong to this one (W3C Trace Context, section 3.2)",
            text(),
            json!("00-4bf92f3577b34da6a3ce929d0e0e4736-00f067aa0ba902b7-01"),
        ),
    ];
    PreferHeader => vec![header(
        PREFER.as_str(),
        "`wait=N` answers once the job has ended, or after N seconds, at most 60 (RFC 7240)",
        text(),
        json!("wait=10"),
    )];
    AcceptHeader => vec![header(
        "Accept",
        "Media types with their q-values; JSON where it is missing",
        text(),
        json!(OutputFormat::Glb.media_type()),
    )];
    ChangeHeader => vec![header(
        PREFER.as_str(),
        "`wait=N` answers once the status is another than that of `If-None-Match` (without one: than now), or after N \
         seconds, at most 60 (RFC 7240)",
        text(),
        json!("wait=10"),
    )];
    LastEventHeader => vec![header(
        "Last-Event-ID",
        "The id of the last event that the client got: what it says is not told again",
        text(),
        json!("9f86d081884c7d659a2feaa0c55ad015"),
    )];
    IfMatchHeader => vec![header(
        "If-Match",
        "The status' `ETag`s for which to do it: 412 when the job's is another",
        text(),
        json!(ETAG),
    )];
    IfNoneMatchHeader => vec![if_none_match()];
    /// Conditions and ranges of a result.
    ConditionHeaders => vec![
        header("If-Match", "The result's `ETag`s for which to send it: 412 when it has another", text(), json!(ETAG)),
        if_none_match(),
        header("Range", "One range of bytes; several are answered whole", text(), json!("bytes=0-1023")),
        header(
            "Accept-Encoding",
            "`gzip` or `zstd` for JSON and glTF compressed; each coding has an `ETag` and ranges of its own",
            text(),
            json!("zstd, gzip;q=0.5"),
        ),
        header("If-Range", "The `ETag` for which `Range` applies", text(), json!(ETAG)),
    ];
}

/// An entity tag in examples.
pub const ETAG: &str = "\"9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08\"";

/// Text without control characters.
const NO_CONTROL: &str = "^[^\\u0000-\\u001f\\u007f-\\u009f]*$";

/// Name and schema of everything that a job can be asked with, in the query or in a form.
pub fn job_parameters() -> Vec<(String, Object)> {
    let units = words(Units::ALL.iter().map(|units| units.name()), Units::default().name());
    let presets = words(Preset::NAMES.into_iter(), Preset::default().name());
    let name = ObjectBuilder::new().schema_type(Type::String).max_length(Some(Limits::default().name_chars));
    let mut list = vec![
        (
            UNITS.to_owned(),
            units.description(Some("Unit of the mesh's coordinates; the result keeps it")).build(),
        ),
        (
            NAME.to_owned(),
            name.min_length(Some(1))
                .pattern(Some(NO_CONTROL))
                .description(Some("For the result's `source.name`; the file name of a form's part by default"))
                .build(),
        ),
        (
            PRESET.to_owned(),
            presets
                .description(Some(
                    "`default` is scaled to the local radius and edge length; `paper` has the paper's constants",
                ))
                .build(),
        ),
        (
            CLIENT_REFERENCE.to_owned(),
            reference("The client's own word for the job; comes back in its status, and the list may be asked for it"),
        ),
    ];
    let priorities = words(Priority::ALL.iter().map(|priority| priority.name()), Priority::default().name());
    let urgent = "`urgent` jobs run before those that did not come ten minutes before them";
    list.push((PRIORITY.to_owned(), priorities.description(Some(urgent)).build()));
    list.push((
        DRY_RUN.to_owned(),
        ObjectBuilder::new()
            .schema_type(Type::Boolean)
            .default(Some(json!(false)))
            .description(Some("`true` makes no job: the mesh is read, and what is wrong with it is answered"))
            .build(),
    ));
    list.extend(TABLE.iter().map(|spec| (spec.name.to_owned(), row(spec))));
    list
}

/// A parameter of points: one as a text, many as a list of texts.
pub fn points_schema(spec: &PointsSpec) -> Schema {
    /// A number, as JSON and many languages write it; of so few digits that it is surely within the bound.
    const NUMBER: &str =
        "[-+]?([0-9]{1,20}(\\.[0-9]{0,40})?|\\.[0-9]{1,40})([eE](\\+?(10|[0-9])|-[0-9]{1,2}))?";
    let pattern = format!("^ *{NUMBER}( *, *{NUMBER}){{2}} *$");
    let description = Some(points_description(spec));
    let point = ObjectBuilder::new()
        .schema_type(Type::String)
        .pattern(Some(pattern))
        .examples([json!("1.5,-20,3e1")]);
    if spec.most == 1 {
        return Schema::Object(point.description(description).build());
    }
    Schema::Array(
        ArrayBuilder::new().items(point).max_items(Some(spec.most)).description(description).build(),
    )
}

fn points_description(spec: &PointsSpec) -> String {
    format!("{}. As x,y,z in the mesh's coordinates, each within {FARTHEST:e} of 0", spec.doc)
}

/// The same in the query, where a list is the name given more than once.
fn points_query(spec: &PointsSpec) -> Parameter {
    ParameterBuilder::new()
        .name(spec.name)
        .parameter_in(ParameterIn::Query)
        .required(Required::False)
        .description(Some(points_description(spec)))
        .style(Some(ParameterStyle::Form))
        .explode(Some(true))
        .schema(Some(points_schema(spec)))
        .build()
}

/// A row of the method's table.
fn row(spec: &ParameterSpec) -> Object {
    let value = spec.default.unwrap_or(spec.paper);
    let preset = match spec.default {
        None => "; the preset `paper` alone uses it, with another it is a warning of the result".to_owned(),
        Some(default) if default == spec.paper => String::new(),
        Some(_) => format!("; {} with the preset `paper`", spec.paper),
    };
    let (object, description) = match spec.kind {
        ParameterKind::Number { min, max } => (
            ObjectBuilder::new()
                .schema_type(Type::Number)
                .format(Some(SchemaFormat::KnownFormat(KnownFormat::Double)))
                .minimum(Some(min))
                .maximum(Some(max))
                .default(Some(json!(value))),
            format!("{}. Unit: {}. Default: {}{preset}", spec.doc, spec.unit, value),
        ),
        ParameterKind::Flag => (
            ObjectBuilder::new().schema_type(Type::Boolean).default(Some(json!(value != 0.0))),
            spec.doc.to_owned(),
        ),
    };
    object.description(Some(description)).build()
}

fn list() -> Vec<Parameter> {
    let statuses = ObjectBuilder::new()
        .schema_type(Type::String)
        .enum_values(Some(JobStatus::ALL.iter().map(|status| status.name())))
        .description(Some("Only jobs in this state"));
    let cursor = uuid().description(Some("Where the page begins: follow `Link` rather than make one"));
    vec![
        query("status", statuses.build()),
        query(
            CLIENT_REFERENCE,
            reference(
                "Only jobs that were submitted with this word. A proxy may log it, as it stands in the URL",
            ),
        ),
        query("limit", limit("Jobs on a page")),
        query("cursor", cursor.build()),
    ]
}

/// A client's own word for a job.
fn reference(description: &str) -> Object {
    ObjectBuilder::new()
        .schema_type(Type::String)
        .min_length(Some(1))
        .max_length(Some(Limits::default().reference_chars))
        .pattern(Some(NO_CONTROL))
        .description(Some(description))
        .build()
}

fn limit(description: &str) -> Object {
    let limits = Limits::default();
    ObjectBuilder::new()
        .schema_type(Type::Integer)
        .minimum(Some(1_u32))
        .maximum(Some(limits.page_most))
        .default(Some(json!(limits.page_default)))
        .description(Some(description))
        .build()
}

/// A webhook's id.
fn webhook() -> ObjectBuilder {
    ObjectBuilder::new().schema_type(Type::String).pattern(Some("^msg_[0-9a-f]{32}$"))
}

fn job_id() -> Parameter {
    let example = "019aa8b6-7a42-7d52-8d53-2f8ad3a2b9c1";
    path_id("The job's id, as its submission answered it", uuid().build(), example)
}

fn path_id(description: &str, schema: Object, example: &str) -> Parameter {
    ParameterBuilder::new()
        .name("id")
        .parameter_in(ParameterIn::Path)
        .required(Required::True)
        .description(Some(description))
        .schema(Some(schema))
        .example(Some(json!(example)))
        .build()
}

fn if_none_match() -> Parameter {
    header("If-None-Match", "`ETag`s that the client has: 304 when one fits", text(), json!(ETAG))
}

fn query(name: &str, mut schema: Object) -> Parameter {
    let description = schema.description.take();
    ParameterBuilder::new()
        .name(name)
        .parameter_in(ParameterIn::Query)
        .required(Required::False)
        .description(description)
        .schema(Some(schema))
        .build()
}

fn header(name: &str, description: &str, schema: Object, example: Value) -> Parameter {
    ParameterBuilder::new()
        .name(name)
        .parameter_in(ParameterIn::Header)
        .required(Required::False)
        .description(Some(description))
        .schema(Some(schema))
        .example(Some(example))
        .build()
}

fn text() -> Object {
    ObjectBuilder::new().schema_type(Type::String).build()
}

/// The text of a job's id, a UUID version 7 (RFC 9562).
const JOB_ID: &str = "^[0-9a-f]{8}-[0-9a-f]{4}-7[0-9a-f]{3}-[89ab][0-9a-f]{3}-[0-9a-f]{12}$";

fn uuid() -> ObjectBuilder {
    ObjectBuilder::new()
        .schema_type(Type::String)
        .format(Some(SchemaFormat::KnownFormat(KnownFormat::Uuid)))
        .pattern(Some(JOB_ID))
}

fn words(list: impl Iterator<Item = &'static str>, default: &str) -> ObjectBuilder {
    ObjectBuilder::new().schema_type(Type::String).enum_values(Some(list)).default(Some(json!(default)))
}
