//! Pages of jobs, and those of one client.

use super::*;
use crate::jobs::store::listing;

#[tokio::test]
async fn pages_are_newest_first_and_hold_every_job_once() {
    let fixture = Fixture::new().await;
    let mut ids = Vec::new();
    for place in 0..25 {
        let job = fixture.insert().await;
        if place % 5 == 0 {
            assert!(fixture.store.dismiss(job.id, 2_000).await.unwrap());
        }
        ids.push(job.id);
    }
    for (status, limit) in [(None, 7), (Some(JobStatus::Dismissed), 2), (None, 25), (None, 1), (None, 100)] {
        let mut query = ListQuery { status, limit, ..ListQuery::default() };
        let mut seen = Vec::new();
        loop {
            let page = fixture.store.list(query.clone()).await.unwrap();
            assert!(page.jobs.len() <= limit as usize);
            seen.extend(page.jobs.iter().map(|job| job.id));
            // A job that comes in meanwhile belongs to no later page.
            let Some(next) = page.next else { break };
            query.before = Some(next);
        }
        let expected = ids.iter().enumerate().filter(|(place, _)| status.is_none() || place % 5 == 0);
        let expected: Vec<JobId> = expected.map(|(_, id)| *id).rev().collect();
        assert_eq!(seen, expected, "{status:?} by {limit}");
    }
    let counts = fixture.store.counts().await.unwrap();
    assert_eq!(counts, Counts { accepted: 20, dismissed: 5, ..Counts::default() });
}

#[tokio::test]
async fn a_client_finds_its_jobs_by_its_own_word() {
    let fixture = Fixture::new().await;
    let mut ids = Vec::new();
    for (word, owner) in [("case 7", "a"), ("case 8", "a"), ("case 7", "b"), ("case 7", "a")] {
        let mut job = fixture.insert().await;
        job.id = fixture.ids.next();
        job.spec.origin.client_reference = Some(word.to_owned());
        job.spec.owner = Some(owner.to_owned());
        fixture.store.insert(&job).await.unwrap();
        ids.push(job.id);
    }
    fixture.store.dismiss(ids[0], 2_000).await.unwrap();
    let found = async |query: ListQuery| {
        let query = ListQuery { client_reference: Some("case 7".to_owned()), limit: 10, ..query };
        let jobs = fixture.store.list(query).await.unwrap().jobs;
        jobs.iter().map(|job| job.id).collect::<Vec<_>>()
    };
    assert_eq!(found(ListQuery::default()).await, [ids[3], ids[2], ids[0]]);
    assert_eq!(found(ListQuery { before: Some(ids[3]), ..ListQuery::default() }).await, [ids[2], ids[0]]);
    assert_eq!(
        found(ListQuery { owner: Some("a".to_owned()), ..ListQuery::default() }).await,
        [ids[3], ids[0]]
    );
    let status = Some(JobStatus::Dismissed);
    assert_eq!(found(ListQuery { status, ..ListQuery::default() }).await, [ids[0]]);
    let plan = format!("EXPLAIN QUERY PLAN {}", listing::OF_CLIENT);
    let mut connection = sqlx::AnyConnection::connect(&url(&fixture.dir)).await.unwrap();
    let none = None::<String>;
    let plan =
        sqlx::query(sqlx::AssertSqlSafe(plan)).bind("~").bind(10).bind(&none).bind(&none).bind("case 7");
    let plan: String = plan.fetch_one(&mut connection).await.unwrap().get("detail");
    assert!(plan.contains("jobs_client_reference"), "{plan}");
}
