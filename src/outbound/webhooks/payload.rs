//! What a target is told of a job's end: nothing of the mesh, its name or its result.

use serde::Serialize;
use time::OffsetDateTime;
use time::format_description::well_known::Rfc3339;

use crate::jobs::Delivery;

/// The body of a message, with the members of Standard Webhooks ("Payload structure").
#[derive(Serialize)]
struct Payload<'a> {
    #[serde(rename = "type")]
    kind: String,
    /// When the job ended.
    timestamp: String,
    data: Ended<'a>,
}

#[derive(Serialize)]
struct Ended<'a> {
    id: String,
    status: &'static str,
    created: String,
    started: Option<String>,
    finished: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    client_reference: Option<&'a str>,
    /// The word of the problem that a failed job's status has; its detail may quote the mesh.
    #[serde(skip_serializing_if = "Option::is_none")]
    error: Option<&'a str>,
    /// The job's path.
    href: String,
}

/// The body of a delivery, the same at every try, but for the client's reference: it may be patient data, and goes with a
/// job that is purged between two tries.
pub(super) fn body(delivery: &Delivery) -> serde_json::Result<String> {
    serde_json::to_string(&Payload {
        kind: format!("job.{}", delivery.status.name()),
        timestamp: rfc3339(delivery.finished),
        data: Ended {
            id: delivery.job.to_string(),
            status: delivery.status.name(),
            created: rfc3339(delivery.created),
            started: delivery.started.map(rfc3339),
            finished: rfc3339(delivery.finished),
            client_reference: delivery.client_reference.as_deref(),
            error: delivery.error.as_ref().map(|failure| failure.code.as_ref()),
            href: format!("/v1/jobs/{}", delivery.job),
        },
    })
}

/// Milliseconds since the epoch; times that no calendar has become the epoch.
fn rfc3339(millis: i64) -> String {
    let time = OffsetDateTime::from_unix_timestamp_nanos(i128::from(millis) * 1_000_000);
    time.unwrap_or(OffsetDateTime::UNIX_EPOCH).format(&Rfc3339).unwrap_or_default()
}
