//! The OpenAPI document: what the operations declare, and what a macro cannot say of them.

mod body;
mod examples;
mod parameters;
mod problems;
mod responses;

use utoipa::OpenApi;
use utoipa::openapi::path::{Operation, PathItem};
use utoipa::openapi::security::{HttpAuthScheme, HttpBuilder, SecurityRequirement, SecurityScheme};
use utoipa::openapi::{Info, License, RefOr, Tag};

use super::{limits, problem, representation, router};
use crate::jobs::JobFailure;
use crate::output::ResultDocument;

pub use parameters::{
    AcceptHeader, ChangeHeader, ConditionHeaders, DeadParameters, IfMatchHeader, IfNoneMatchHeader, JobPath,
    LastEventHeader, ListParameters, OriginHeaders, PreferHeader, SubmitQuery, WebhookPath,
};
pub use problems::{
    DeadProblems, DeleteProblems, JobProblems, LimitsProblems, ListProblems, MetricsProblems, PlainProblems,
    ReadyProblems, ResendProblems, ResultProblems, RetryProblems, SubmitProblems,
};
pub use responses::{
    AnyResult, Created, Dead, Deleted, Document, Events, GlbResult, GltfResult, Healthy, JsonResult,
    LimitsAnswer, List, Metrics, Resent, Retried, Status, VtpResult,
};

/// The security scheme of API keys and tokens.
const KEY: &str = "key";

// Tags.
pub const JOBS: &str = "jobs";
pub const RESULTS: &str = "results";
pub const SERVICE: &str = "service";
pub const WEBHOOKS: &str = "webhooks";

/// The schemas that the hand-made parts refer to.
#[derive(OpenApi)]
#[openapi(components(schemas(
    representation::StatusDocument,
    representation::ListDocument,
    problem::Details,
    ResultDocument,
    super::operations::health::Health,
    super::operations::limits::LimitsDocument,
    super::inspection::Inspection,
    super::operations::webhooks::DeadWebhook,
    super::operations::webhooks::DeadWebhooks
)))]
struct Schemas;

/// The document before any operation is in it.
pub fn base() -> utoipa::openapi::OpenApi {
    let mut document = Schemas::openapi();
    document.info = info();
    // Either none, where the operator made no key and set no issuer, or one.
    document.security = Some(vec![SecurityRequirement::default(), SecurityRequirement::new(KEY, [""; 0])]);
    document.tags = Some(vec![
        tag(JOBS, "Meshes in, jobs out"),
        tag(RESULTS, "Centerlines"),
        tag(SERVICE, "The service itself"),
        tag(WEBHOOKS, "What the operator's targets could not be told"),
    ]);
    if let Some(components) = &mut document.components {
        let scheme = HttpBuilder::new()
            .scheme(HttpAuthScheme::Bearer)
            .description(Some("An API key, or a JWT of the issuer that the operator set"));
        components.add_security_scheme(KEY, SecurityScheme::Http(scheme.build()));
        components.schemas.insert(body::PARAMETERS.to_owned(), RefOr::T(body::parameters_schema()));
    }
    document
}

/// The whole document.
pub fn document() -> utoipa::openapi::OpenApi {
    let mut document = router::routes().into_openapi();
    for (path, item) in &mut document.paths.paths {
        if let (Some(post), "/v1/jobs") = (&mut item.post, path.as_str()) {
            post.request_body = Some(RefOr::T(body::mesh()));
        }
        add_head(item);
    }
    document
}

/// The document as it is served and committed.
pub fn yaml() -> String {
    // Strings, numbers and maps with string keys: always expressible in YAML.
    document().to_yaml().unwrap_or_default()
}

/// Whatever can be got answers HEAD too: the same, without a body.
fn add_head(item: &mut PathItem) {
    let Some(get) = &item.get else { return };
    let mut head: Operation = get.clone();
    head.operation_id =
        head.operation_id.map(|id| id.replacen("get", "head", 1).replacen("list", "headList", 1));
    head.summary = head.summary.map(|summary| format!("{summary}: the headers only"));
    head.description = None;
    head.responses.responses.remove("206");
    head.responses.responses.remove("416");
    for response in head.responses.responses.values_mut() {
        if let RefOr::T(response) = response {
            response.content.clear();
        }
    }
    item.head = Some(head);
}

fn tag(name: &str, description: &str) -> Tag {
    let mut tag = Tag::new(name);
    tag.description = Some(description.to_owned());
    tag
}

fn info() -> Info {
    let mut info = Info::new("Rosaline", env!("CARGO_PKG_VERSION"));
    info.license = Some({
        let mut license = License::new("Apache License 2.0");
        license.identifier = Some("Apache-2.0".to_owned());
        license
    });
    info.description = Some(description());
    info
}

fn description() -> String {
    let limits = limits::Limits::default();
    let mut text = format!(
        "Centerlines of blood vessels from their surface meshes.\n\n\
         Post a mesh, follow its job, get the centerline. A job is durable once it is answered with 201.\n\n\
         Errors are problem details (RFC 9457) whose `type` is `{prefix}` and one of the words below; a failed \
         job's `error` has the words of the method's own failures too (`no-triangles`, `all-degenerate`, \
         `far-out`, `not-finite`, `out-of-range`, `out-of-scale`, `off-surface`, `not-tubular`, `undersampled`), or one of the queue's: \
         {failures}. A word never changes its meaning. What cannot be read as HTTP (400), or has an address (414) or headers \
         (431) that are too long, is answered without a body.\n\n\
         | word | status | title |\n| --- | --- | --- |\n",
        prefix = problem::TYPE_PREFIX,
        failures = JobFailure::CODES.map(|code| format!("`{code}`")).join(", "),
    );
    for kind in problem::ALL {
        text.push_str(&format!("| {} | {} | {} |\n", kind.word, kind.status.as_u16(), kind.title));
    }
    text.push_str(&format!(
        "\nUnless the operator sets other limits, an upload may have {} bytes, a mesh {} vertices and {} triangles; `/v1/limits` \
         has those in force.",
        limits.upload_bytes, limits.mesh.vertices, limits.mesh.triangles
    ));
    text
}
