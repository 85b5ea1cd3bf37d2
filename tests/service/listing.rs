//! The list of jobs.

use serde_json::Value;

use crate::meshes;
use crate::service::{Service, problem};
use crate::submission::assert_fits;

/// Ids of all pages, following `Link`.
async fn ids(service: &Service, first: &str) -> Vec<Vec<String>> {
    let (mut pages, mut next) = (Vec::new(), Some(first.to_owned()));
    while let Some(path) = next {
        let response = service.get(&path).send().await.unwrap();
        assert_eq!(response.status(), 200);
        let link = response.headers().get("link").map(|link| link.to_str().unwrap().to_owned());
        let body: Value = response.json().await.unwrap();
        assert_fits("JobList", &body);
        let page: Vec<String> = body["jobs"]
            .as_array()
            .unwrap()
            .iter()
            .map(|job| job["id"].as_str().unwrap().to_owned())
            .collect();
        next = link
            .map(|link| link.strip_prefix('<').unwrap().strip_suffix(">; rel=\"next\"").unwrap().to_owned());
        assert_eq!(body["links"].get(0).map(|link| link["href"].as_str().unwrap().to_owned()), next);
        pages.push(page);
    }
    pages
}

#[tokio::test]
async fn pages_follow_each_other_newest_first() {
    let service = Service::start(&[]);
    let mut jobs = Vec::new();
    for _ in 0..5 {
        jobs.push(service.accepted("", meshes::small()).await.replace("/v1/jobs/", ""));
    }
    for job in &jobs {
        service.ended(&format!("/v1/jobs/{job}")).await;
    }
    jobs.reverse();
    let pages = ids(&service, "/v1/jobs?limit=2").await;
    assert_eq!(pages.iter().map(Vec::len).collect::<Vec<_>>(), [2, 2, 1]);
    assert_eq!(pages.concat(), jobs);
    assert_eq!(ids(&service, "/v1/jobs?limit=5").await, [jobs.clone()]);
    assert_eq!(ids(&service, "/v1/jobs?status=successful&limit=3").await.concat(), jobs);
    assert_eq!(ids(&service, "/v1/jobs?status=failed").await.concat(), [""; 0]);
}

#[tokio::test]
async fn a_client_finds_its_jobs_by_its_own_word() {
    let service = Service::start(&[]);
    let mut jobs = Vec::new();
    for word in ["case%207%26%C3%BC", "case%208", "case%207%26%C3%BC", "case%207%26%C3%BC"] {
        let job = service.accepted(&format!("?client_reference={word}"), meshes::small()).await;
        jobs.push(job.replace("/v1/jobs/", ""));
    }
    jobs.reverse();
    jobs.remove(2);
    let pages = ids(&service, "/v1/jobs?client_reference=case+7%26%C3%BC&limit=2").await;
    assert_eq!(pages, [jobs[..2].to_vec(), jobs[2..].to_vec()]);
    assert_eq!(ids(&service, "/v1/jobs?client_reference=case").await.concat(), [""; 0]);
    assert!(!service.log().contains("case"), "{}", service.log());
}

#[tokio::test]
async fn a_wrong_question_is_refused() {
    let service = Service::start(&[]);
    for (query, word, parameter) in [
        ("limit=0", "invalid-parameter", "limit"),
        ("limit=many", "invalid-parameter", "limit"),
        ("status=done", "invalid-parameter", "status"),
        ("cursor=abc", "invalid-parameter", "cursor"),
        ("page=2", "unknown-parameter", "page"),
    ] {
        let response = service.get(&format!("/v1/jobs?{query}")).send().await.unwrap();
        assert_eq!(problem(response, 400, word).await["parameter"], parameter);
    }
}
