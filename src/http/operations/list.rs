//! `GET /v1/jobs`

use axum::Json;
use axum::extract::{Request, State};
use axum::http::{HeaderValue, header};
use axum::response::{IntoResponse, Response};
use percent_encoding::{NON_ALPHANUMERIC, utf8_percent_encode};

use super::super::App;
use super::super::access::Caller;
use super::super::document::{self, ListProblems};
use super::super::limits::Limits;
use super::super::parameters::{CLIENT_REFERENCE, query_pairs, reference};
use super::super::problem::{INVALID_PARAMETER, Problem, UNKNOWN_PARAMETER};
use super::super::representation::{Link, ListDocument, StatusDocument};
use crate::jobs::JobId;
use crate::jobs::store::ListQuery;

/// Jobs, newest first
///
/// One page; the `Link` with `rel="next"` (and the link `next` in the body) leads to the next one until there
/// are no older jobs.
#[utoipa::path(
    get,
    path = "/v1/jobs",
    operation_id = "listJobs",
    tag = document::JOBS,
    params(document::ListParameters),
    responses(document::List, ListProblems)
)]
pub async fn list(State(app): State<App>, caller: Caller, request: Request) -> Result<Response, Problem> {
    let owner = caller.bound_to().map(str::to_owned);
    let query = ListQuery { owner, ..read(&query_pairs(request.uri())?, app.limits())? };
    let page = app.jobs().list(query.clone()).await?;
    let next = page.next.map(|cursor| next_path(&query, cursor));
    let document = ListDocument {
        jobs: page.jobs.iter().map(StatusDocument::from).collect(),
        links: next.iter().map(|path| Link::new("next", path.clone())).collect(),
    };
    let mut response = Json(document).into_response();
    response.headers_mut().insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
    if let Some(link) = next.and_then(|path| HeaderValue::try_from(format!("<{path}>; rel=\"next\"")).ok()) {
        response.headers_mut().insert(header::LINK, link);
    }
    Ok(response)
}

fn read(pairs: &[(String, String)], limits: &Limits) -> Result<ListQuery, Problem> {
    let mut query = ListQuery { limit: limits.page_default, ..ListQuery::default() };
    for (place, (name, value)) in pairs.iter().enumerate() {
        let invalid =
            |detail: String| Problem::new(&INVALID_PARAMETER, detail).with("parameter", name.as_str());
        if pairs[..place].iter().any(|(other, _)| other == name) {
            return Err(invalid(format!("{name} is given twice; give it once")));
        }
        match name.as_str() {
            "status" => {
                let status = value.parse();
                query.status =
                    Some(status.map_err(|error: crate::jobs::UnknownStatus| invalid(error.to_string()))?);
            }
            CLIENT_REFERENCE => query.client_reference = Some(reference(value, limits)?),
            "limit" => {
                let limit = value.parse().ok().filter(|limit| (1..=limits.page_most).contains(limit));
                let expected = || invalid(format!("limit is a number from 1 to {}", limits.page_most));
                query.limit = limit.ok_or_else(expected)?;
            }
            "cursor" => {
                let cursor: Result<JobId, _> = value.parse();
                let expected = |_| invalid("the cursor is not one that a page of this list gave".to_owned());
                query.before = Some(cursor.map_err(expected)?);
            }
            _ => {
                let detail = "there is no such parameter; the known ones are status, client_reference, limit and cursor";
                let shown: String = name.chars().take(40).collect();
                return Err(Problem::new(&UNKNOWN_PARAMETER, detail).with("parameter", shown));
            }
        }
    }
    Ok(query)
}

fn next_path(query: &ListQuery, cursor: JobId) -> String {
    let status = query.status.map(|status| format!("status={status}&")).unwrap_or_default();
    let word = query.client_reference.iter();
    let word: String = word
        .map(|word| format!("{CLIENT_REFERENCE}={}&", utf8_percent_encode(word, NON_ALPHANUMERIC)))
        .collect();
    format!("/v1/jobs?{status}{word}limit={}&cursor={cursor}", query.limit)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::jobs::JobStatus;

    const ID: &str = "019aa8b6-7a42-7d52-8d53-2f8ad3a2b9c1";

    fn query(pairs: &[(&str, &str)]) -> Result<ListQuery, u16> {
        let pairs: Vec<_> = pairs.iter().map(|(name, value)| (name.to_string(), value.to_string())).collect();
        read(&pairs, &Limits::default()).map_err(|problem| problem.status().as_u16())
    }

    #[test]
    fn a_query_is_read_and_carried_to_the_next_page() {
        let read = query(&[("status", "failed"), ("limit", "3"), ("cursor", ID)]).unwrap();
        assert_eq!(read.status, Some(JobStatus::Failed));
        assert_eq!(read.before, ID.parse().ok());
        assert_eq!(
            next_path(&read, ID.parse().unwrap()),
            format!("/v1/jobs?status=failed&limit=3&cursor={ID}")
        );
        assert_eq!(query(&[]).unwrap().limit, Limits::default().page_default);
        let read = query(&[("client_reference", "case 7&ü"), ("limit", "3")]).unwrap();
        assert_eq!(read.client_reference.as_deref(), Some("case 7&ü"));
        assert_eq!(
            next_path(&read, ID.parse().unwrap()),
            format!("/v1/jobs?client_reference=case%207%26%C3%BC&limit=3&cursor={ID}")
        );
    }

    #[test]
    fn what_cannot_be_read_is_refused() {
        for pair in [
            ("status", "done"),
            ("limit", "0"),
            ("limit", "501"),
            ("limit", "x"),
            ("cursor", "x"),
            ("client_reference", ""),
            ("page", "2"),
        ] {
            assert_eq!(query(&[pair]), Err(400), "{pair:?}");
        }
        assert_eq!(query(&[("limit", "3"), ("limit", "3")]), Err(400));
    }
}
