//! A job as the client sees it.

use serde::Serialize;
use time::OffsetDateTime;
use time::format_description::well_known::{Iso8601, iso8601};
use utoipa::ToSchema;
use utoipa::openapi::schema::{Object, ObjectBuilder, Type};

use super::problem::{Details, Problem};
use crate::jobs::{Job, JobStatus, Priority};

/// RFC 3339 in UTC with milliseconds, as the store keeps them.
const RFC3339_MILLIS: iso8601::EncodedConfig = iso8601::Config::DEFAULT
    .set_time_precision(iso8601::TimePrecision::Second { decimal_digits: std::num::NonZeroU8::new(3) })
    .encode();

/// A job's status.
#[derive(Debug, Serialize, ToSchema)]
#[schema(title = "JobStatus", as = JobStatus)]
pub struct StatusDocument {
    #[schema(format = Uuid, example = "019aa8b6-7a42-7d52-8d53-2f8ad3a2b9c1")]
    id: String,
    #[schema(schema_with = status_schema)]
    status: &'static str,
    /// Percent of the work that is done; 100 once the job is successful.
    #[schema(minimum = 0, maximum = 100, example = 100)]
    progress: u8,
    /// The stage at work, or at which the job failed or was cancelled; null before and after.
    #[schema(required, example = "connection")]
    stage: Option<String>,
    /// When the job was accepted.
    #[schema(format = DateTime, example = "2026-11-22T05:25:58.123Z")]
    created: String,
    /// When its last run began.
    #[schema(required, format = DateTime)]
    started: Option<String>,
    /// When anything of it last changed in the store.
    #[schema(format = DateTime)]
    updated: String,
    /// When it ended, well or not.
    #[schema(required, format = DateTime)]
    finished: Option<String>,
    /// Why it failed; null unless it did.
    #[schema(required, value_type = Option<Details>)]
    error: Option<Problem>,
    #[schema(schema_with = priority_schema)]
    priority: &'static str,
    /// The submission's `X-Request-ID`, where it had one.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(example = "pacs-4711")]
    request_id: Option<String>,
    /// The submission's `client_reference`, where it had one.
    #[serde(skip_serializing_if = "Option::is_none")]
    client_reference: Option<String>,
    links: Vec<Link>,
}

/// Where to go from here.
#[derive(Debug, Serialize, ToSchema)]
pub struct Link {
    /// `self`, `results` (of a successful job, one for each format) or `next`.
    #[schema(example = "self")]
    rel: &'static str,
    #[schema(example = "/v1/jobs/019aa8b6-7a42-7d52-8d53-2f8ad3a2b9c1")]
    href: String,
    /// Media type of the target.
    #[serde(rename = "type")]
    #[schema(example = "application/json")]
    kind: &'static str,
}

/// One page of jobs, newest first.
#[derive(Debug, Serialize, ToSchema)]
#[schema(title = "JobList", as = JobList)]
pub struct ListDocument {
    pub jobs: Vec<StatusDocument>,
    /// `next`, where there are older jobs.
    pub links: Vec<Link>,
}

fn status_schema() -> Object {
    ObjectBuilder::new()
        .schema_type(Type::String)
        .enum_values(Some(JobStatus::ALL.iter().map(|status| status.name())))
        .description(Some(
            "`accepted` waits for a worker; `successful`, `failed` and `dismissed` (cancelled) are final.",
        ))
        .build()
}

fn priority_schema() -> Object {
    ObjectBuilder::new()
        .schema_type(Type::String)
        .enum_values(Some(Priority::ALL.iter().map(|priority| priority.name())))
        .description(Some("How soon it was asked to run."))
        .build()
}

impl Link {
    pub fn new(rel: &'static str, href: String) -> Self {
        Self { rel, href, kind: "application/json" }
    }
}

/// The path of a job.
pub fn job_path(job: &Job) -> String {
    format!("/v1/jobs/{}", job.id)
}

impl From<&Job> for StatusDocument {
    fn from(job: &Job) -> Self {
        let path = job_path(job);
        let mut links = vec![Link::new("self", path.clone())];
        if job.status == JobStatus::Successful {
            links.extend(job.forms().map(|format| Link {
                rel: "results",
                href: format!("{path}/results/centerline.{}", format.extension()),
                kind: format.media_type(),
            }));
        }
        Self {
            id: job.id.to_string(),
            status: job.status.name(),
            progress: job.progress,
            stage: job.stage.clone(),
            created: rfc3339(job.created),
            started: job.started.map(rfc3339),
            updated: rfc3339(job.updated),
            finished: job.finished.map(rfc3339),
            error: job.error.as_ref().map(|failure| Problem::from(failure).about(job.id)),
            priority: job.spec.priority.name(),
            request_id: job.spec.origin.request_id.clone(),
            client_reference: job.spec.origin.client_reference.clone(),
            links,
        }
    }
}

/// Milliseconds since the epoch as RFC 3339; times that no calendar has become the epoch.
pub(super) fn rfc3339(millis: i64) -> String {
    let time = OffsetDateTime::from_unix_timestamp_nanos(i128::from(millis) * 1_000_000);
    time.unwrap_or(OffsetDateTime::UNIX_EPOCH).format(&Iso8601::<RFC3339_MILLIS>).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::jobs::{Coding, JobError, JobId, JobSpec, StoredArtifact, StoredInput};
    use crate::output::OutputFormat;

    #[test]
    fn a_job_of_an_older_version_links_to_the_forms_that_it_has() {
        let input = StoredInput { key: "k".to_owned(), size: 84, sha256: "ab".repeat(32) };
        let id = "019aa8b6-7a42-7d52-8d53-2f8ad3a2b9c1".parse::<JobId>().unwrap();
        let mut job =
            Job { status: JobStatus::Successful, ..Job::accepted(id, input, JobSpec::default(), 0) };
        let artifact = |format, coding| StoredArtifact {
            format,
            coding,
            key: "k".to_owned(),
            size: 7,
            sha256: "cd".repeat(32),
        };
        job.artifacts = vec![
            artifact(OutputFormat::Glb, Coding::Identity),
            artifact(OutputFormat::Json, Coding::Identity),
            artifact(OutputFormat::Json, Coding::Gzip),
        ];
        let links = StatusDocument::from(&job).links;
        let hrefs: Vec<&str> = links.iter().filter_map(|link| link.href.rsplit('/').next()).collect();
        assert_eq!(hrefs[1..], ["centerline.json", "centerline.glb"]);
        let problem = Problem::from(JobError::NoSuchResult { id, format: OutputFormat::Vtp });
        assert_eq!(problem.status(), 404);
    }

    #[test]
    fn times_are_rfc_3339_with_milliseconds() {
        assert_eq!(rfc3339(0), "1970-01-01T00:00:00.000Z");
        assert_eq!(rfc3339(1_763_789_158_007), "2025-11-22T05:25:58.007Z");
        assert_eq!(rfc3339(i64::MAX), "1970-01-01T00:00:00.000Z");
    }
}
