//! The lines of the audit trail: audit messages of DICOM PS3.15, section A.5, as JSON.

use axum::http::{Method, StatusCode};
use serde_json::{Value, json};
use time::OffsetDateTime;
use time::format_description::well_known::Rfc3339;

use super::Peer;
use super::refusals::{LINES, Sender, Sum};
use crate::jobs::JobId;

/// What was done, as far as it is told.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Act {
    Import,
    Export,
    Query,
    Retry,
    Delete,
    /// A webhook is sent again.
    Resend,
    /// Somebody was not let in, or not allowed to.
    Refused,
}

impl Act {
    pub(super) fn of(method: &Method, path: &str, status: StatusCode) -> Option<Self> {
        if matches!(status, StatusCode::UNAUTHORIZED | StatusCode::FORBIDDEN) {
            return Some(Act::Refused);
        }
        match method.as_str() {
            "POST" if path.ends_with("/retry") => Some(Act::Retry),
            "POST" if path.ends_with("/resend") => Some(Act::Resend),
            "POST" => Some(Act::Import),
            "DELETE" => Some(Act::Delete),
            "GET" if matches!(path, "/v1/jobs" | "/v1/webhooks/dead") => Some(Act::Query),
            "GET" if path.contains("/results/") => Some(Act::Export),
            _ => None,
        }
    }

    /// The event's code and meaning in DICOM's dictionary (PS3.16, CID 400), and its action code.
    fn codes(self) -> (&'static str, &'static str, &'static str) {
        match self {
            Act::Import => ("110107", "Import", "C"),
            Act::Export => ("110106", "Export", "R"),
            Act::Query => ("110112", "Query", "E"),
            Act::Retry => ("110103", "DICOM Instances Accessed", "U"),
            Act::Delete => ("110103", "DICOM Instances Accessed", "D"),
            Act::Resend => ("110106", "Export", "E"),
            Act::Refused => ("110113", "Security Alert", "E"),
        }
    }
}

/// One request and its answer.
pub(in crate::http) struct Occurrence<'a> {
    pub(in crate::http) method: &'a Method,
    pub(in crate::http) path: &'a str,
    pub(in crate::http) status: StatusCode,
    /// The principal; none where there is no authentication, or it failed.
    pub(in crate::http) user: Option<&'a str>,
    pub(in crate::http) peer: Option<Peer>,
    pub(in crate::http) job: Option<JobId>,
}

impl Occurrence<'_> {
    /// The line.
    pub(super) fn message(&self, act: Act) -> Value {
        let objects = self.job.map_or(json!([]), |job| {
            json!([{
                "ParticipantObjectID": job.to_string(),
                "ParticipantObjectTypeCode": "2",
                "ParticipantObjectTypeCodeRole": "20",
                "ParticipantObjectIDTypeCode": {"originalText": "job"},
            }])
        });
        let address = self.peer.map(|Peer(address)| address.to_string());
        message(act, &[self.status], self.user, address, objects)
    }
}

/// What every line has.
fn message(
    act: Act,
    statuses: &[StatusCode],
    user: Option<&str>,
    address: Option<String>,
    objects: Value,
) -> Value {
    let (code, meaning, action) = act.codes();
    // 0 success, 4 minor failure, 8 serious failure (RFC 3881, section 5.1.4).
    let outcome = match statuses.iter().map(StatusCode::as_u16).max().unwrap_or_default() {
        ..400 => 0,
        400..500 => 4,
        _ => 8,
    };
    let statuses: Vec<&str> = statuses.iter().map(StatusCode::as_str).collect();
    let mut message = json!({
        "EventIdentification": {
            "EventID": {"csd-code": code, "codeSystemName": "DCM", "originalText": meaning},
            "EventActionCode": action,
            "EventDateTime": moment(OffsetDateTime::now_utc()),
            "EventOutcomeIndicator": outcome,
            "EventOutcomeDescription": statuses.join(", "),
        },
        "ActiveParticipant": [{
            "UserID": user.unwrap_or("anonymous"),
            "UserIsRequestor": true,
        }],
        "AuditSourceIdentification": {"AuditSourceID": "rosaline", "AuditSourceTypeCode": "4"},
        "ParticipantObjectIdentification": objects,
    });
    if let Some(address) = address {
        message["ActiveParticipant"][0]["NetworkAccessPointID"] = json!(address);
        // 2: an IP address.
        message["ActiveParticipant"][0]["NetworkAccessPointTypeCode"] = json!("2");
    }
    message
}

fn moment(time: OffsetDateTime) -> String {
    time.format(&Rfc3339).unwrap_or_default()
}

/// The line of refusals that were summed up: an alert's subject with its description, as PS3.15, section A.5.3.11, has it.
pub(super) fn of_sum(sender: &Sender, sum: &Sum) -> Value {
    let what = format!(
        "{} further requests were refused from {} to {}, after {} that have a line each",
        sum.count,
        moment(sum.first),
        moment(sum.last),
        LINES
    );
    let objects = json!([{
        "ParticipantObjectID": "rosaline",
        "ParticipantObjectTypeCode": "2",
        "ParticipantObjectIDTypeCode": {"csd-code": "110182", "codeSystemName": "DCM", "originalText": "Node ID"},
        "ParticipantObjectDetail": [
            {"type": "Alert Description", "value": what},
            {"type": "Count", "value": sum.count.to_string()},
        ],
    }]);
    let statuses: Vec<StatusCode> = sum.statuses.iter().copied().collect();
    message(Act::Refused, &statuses, sender.user(), sender.address(), objects)
}
