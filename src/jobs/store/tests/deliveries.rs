//! What is to be told of jobs' ends: written with the end, claimed by one, kept until it is told or given up.

use super::*;
use crate::jobs::{LONGEST_WAIT, Listener, Told};

fn listener(name: &str, owner: Option<&str>, ends: &[JobStatus]) -> Listener {
    Listener { name: name.to_owned(), owner: owner.map(str::to_owned), ends: ends.to_vec() }
}

const ENDS: [JobStatus; 3] = [JobStatus::Successful, JobStatus::Failed, JobStatus::Dismissed];
const FAR: i64 = 1_000_000;

impl Fixture {
    async fn listening(listeners: &[Listener]) -> Self {
        let fixture = Self::new().await;
        fixture.store.set_listeners(listeners, 0).await.unwrap();
        fixture
    }

    async fn succeeded(&self) -> Job {
        self.insert().await;
        let (job, lease) = self.claim().await;
        assert!(self.store.succeed(job.id, &lease, &[], 3_000).await.unwrap());
        self.get(job.id).await
    }

    async fn next(&self, name: &str, now: i64) -> Option<(Delivery, Lease)> {
        let lease = Lease::new();
        let found = self.store.claim_delivery(name, &lease, now, now + 100).await.unwrap();
        assert_eq!(found.is_some(), found.as_ref().is_some_and(|found| found.listener == name));
        found.map(|delivery| (delivery, lease))
    }
}

#[tokio::test]
async fn every_end_of_a_job_is_written_once_for_each_who_listens_to_it() {
    let listeners = [
        listener("all", None, &ENDS),
        listener("failures", None, &[JobStatus::Failed]),
        listener("theirs", Some("pacs"), &ENDS),
    ];
    let fixture = Fixture::listening(&listeners).await;
    let mut job = fixture.insert().await;
    job.id = fixture.ids.next();
    job.spec.owner = Some("pacs".to_owned());
    job.spec.origin.client_reference = Some("case 7".to_owned());
    fixture.store.insert(&job).await.unwrap();
    // Put back and retried: no ends.
    let (first, lease) = fixture.claim().await;
    assert!(fixture.store.release(first.id, &lease, 2_000).await.unwrap());
    let (first, lease) = fixture.claim().await;
    let failure = JobFailure::new("not-tubular", 422, "title", "detail");
    assert!(fixture.store.fail(first.id, &lease, &failure, 2_500).await.unwrap());
    assert!(!fixture.store.fail(first.id, &lease, &failure, 2_600).await.unwrap());
    assert!(fixture.store.retry(first.id, 2_700).await.unwrap());
    assert!(fixture.store.dismiss(first.id, 2_800).await.unwrap());
    let (second, lease) = fixture.claim().await;
    assert_eq!(second.id, job.id);
    assert!(fixture.store.succeed(second.id, &lease, &[], 3_000).await.unwrap());
    fixture.store.begin_purge(second.id, 3_500).await.unwrap();

    let mut told = Vec::new();
    for name in ["all", "failures", "theirs"] {
        while let Some((delivery, lease)) = fixture.next(name, FAR).await {
            told.push((name, delivery.job, delivery.status, delivery.finished));
            let error = delivery.error.map(|failure| failure.code);
            assert_eq!(error.is_some(), delivery.status == JobStatus::Failed);
            let reference = delivery.client_reference.as_deref();
            assert_eq!(reference, (delivery.job == second.id).then_some("case 7"));
            assert!(fixture.store.settle_delivery(&delivery.id, &lease, &Told::Yes, FAR).await.unwrap());
        }
    }
    assert_eq!(
        told,
        [
            ("all", first.id, JobStatus::Failed, 2_500),
            ("all", first.id, JobStatus::Dismissed, 2_800),
            ("all", second.id, JobStatus::Successful, 3_000),
            ("failures", first.id, JobStatus::Failed, 2_500),
            ("theirs", second.id, JobStatus::Successful, 3_000),
        ]
    );
    assert_eq!(fixture.store.count_deliveries().await.unwrap(), DeliveryCounts::default());
}

#[tokio::test]
async fn a_job_that_is_given_up_at_a_start_is_told_too() {
    let fixture = Fixture::listening(&[listener("all", None, &ENDS)]).await;
    let job = fixture.insert().await;
    fixture.claim().await;
    assert_eq!(fixture.store.recover(1, 2_500).await.unwrap().failed, 1);
    let (delivery, _) = fixture.next("all", FAR).await.unwrap();
    assert_eq!((delivery.job, delivery.status), (job.id, JobStatus::Failed));
}

#[tokio::test]
async fn a_delivery_is_one_senders_until_its_lease_runs_out() {
    let fixture = Fixture::listening(&[listener("all", None, &ENDS)]).await;
    let store = &fixture.store;
    fixture.succeeded().await;
    assert!(!store.is_due("all", 2_999).await.unwrap() && store.is_due("all", 3_000).await.unwrap());
    assert!(fixture.next("all", 2_999).await.is_none());
    let (first, old) = fixture.next("all", 3_000).await.unwrap();
    assert!(fixture.next("all", 3_099).await.is_none());
    let (again, new) = fixture.next("all", 3_100).await.unwrap();
    assert_eq!((&again.id, again.attempts), (&first.id, 2));
    let later = Told::Later { after: 50, failure: "it answered 500".to_owned() };
    assert!(
        !store.settle_delivery(&first.id, &old, &Told::Yes, 3_100).await.unwrap(),
        "the old lease is void"
    );
    assert!(store.settle_delivery(&first.id, &new, &later, 3_100).await.unwrap());
    assert!(fixture.next("all", 3_149).await.is_none());
    let (third, lease) = fixture.next("all", 3_150).await.unwrap();
    assert_eq!((third.attempts, third.failure.as_deref()), (3, Some("it answered 500")));
    // The process dies; the next one need not wait for the lease.
    assert_eq!(store.release_deliveries(3_151).await.unwrap(), 1);
    assert!(!store.settle_delivery(&third.id, &lease, &Told::Yes, 3_152).await.unwrap());
    let (fourth, lease) = fixture.next("all", 3_152).await.unwrap();
    assert_eq!(fourth.id, first.id);
    // The longest wait is one.
    let longest = i64::try_from(LONGEST_WAIT.as_millis()).unwrap();
    let later = Told::Later { after: longest, failure: String::new() };
    assert!(store.settle_delivery(&fourth.id, &lease, &later, 4_000).await.unwrap());
    assert!(fixture.next("all", 4_000).await.is_none());
    // A clock that is set back by a day, or a year, delays nothing for that long.
    for back in [1, 365] {
        let (delivery, lease) = fixture.next("all", 4_000 + longest).await.unwrap();
        let later = Told::Later { after: 1_000, failure: String::new() };
        let now = 4_000 + back * 24 * 60 * 60 * 1000;
        assert!(store.settle_delivery(&delivery.id, &lease, &later, now).await.unwrap());
        let (delivery, lease) = fixture.next("all", 4_000).await.unwrap();
        assert!(store.settle_delivery(&delivery.id, &lease, &later, 4_000).await.unwrap());
    }
}

#[tokio::test]
async fn what_is_given_up_is_listed_sent_again_and_forgotten() {
    let fixture = Fixture::listening(&[listener("all", None, &ENDS)]).await;
    let store = &fixture.store;
    let mut ids = Vec::new();
    for died in [10, 20, 20, 30] {
        fixture.succeeded().await;
        let (delivery, lease) = fixture.next("all", FAR).await.unwrap();
        let never = Told::Never { failure: "it answered 410".to_owned() };
        assert!(store.settle_delivery(&delivery.id, &lease, &never, died).await.unwrap());
        ids.push(delivery.id);
    }
    assert_eq!(store.count_deliveries().await.unwrap(), DeliveryCounts { waiting: 0, dead: 4 });
    assert!(fixture.next("all", FAR).await.is_none());
    let mut listed = Vec::new();
    while let [delivery] = &store.dead(listed.last().map(String::as_str), 1).await.unwrap()[..] {
        listed.push(delivery.id.clone());
    }
    let whole: Vec<String> = store.dead(None, 10).await.unwrap().into_iter().map(|dead| dead.id).collect();
    assert_eq!(listed, whole);
    assert_eq!((&whole[0], &whole[3], whole.len()), (&ids[3], &ids[0], 4));
    assert!(store.revive(&ids[3], 50).await.unwrap() && !store.revive(&ids[3], 50).await.unwrap());
    let (again, _) = fixture.next("all", 50).await.unwrap();
    assert_eq!((&again.id, again.attempts, again.died), (&ids[3], 1, None));
    assert_eq!(store.forget_dead(20).await.unwrap(), 3);
    assert!(store.dead(None, 10).await.unwrap().is_empty());
}

#[tokio::test]
async fn a_target_that_goes_is_told_nothing_and_a_purged_jobs_reference_goes_with_it() {
    let fixture = Fixture::listening(&[listener("all", None, &ENDS)]).await;
    let store = &fixture.store;
    let mut job = fixture.insert().await;
    store.dismiss(job.id, 2_000).await.unwrap();
    let (delivery, _) = fixture.next("all", FAR).await.unwrap();
    store.settle_delivery(&delivery.id, &Lease::new(), &Told::Yes, 0).await.unwrap();
    job.id = fixture.ids.next();
    job.spec.origin.client_reference = Some("case 7".to_owned());
    store.insert(&job).await.unwrap();
    store.dismiss(job.id, 3_000).await.unwrap();
    store.delete(job.id).await.unwrap();
    let references = "SELECT COUNT(client_reference) || '' FROM webhook_deliveries";
    assert_eq!(fixture.ask(references).await, "0");
    // What is under way may still be told.
    store.set_listeners(&[listener("other", None, &ENDS)], 3_500).await.unwrap();
    assert_eq!(store.dead(None, 10).await.unwrap().len(), 1);
    store.release_deliveries(3_600).await.unwrap();
    store.set_listeners(&[listener("other", None, &ENDS)], 4_000).await.unwrap();
    let dead = store.dead(None, 10).await.unwrap();
    assert_eq!((dead.len(), dead[0].failure.as_deref()), (2, Some("its target is no longer set")));
    assert!(!store.revive(&dead[0].id, 5_000).await.unwrap(), "there is nobody to tell");
}

#[tokio::test]
async fn what_is_under_way_to_a_target_that_goes_is_given_up_when_it_fails() {
    let fixture = Fixture::listening(&[listener("all", None, &ENDS)]).await;
    let store = &fixture.store;
    fixture.succeeded().await;
    let (delivery, lease) = fixture.next("all", FAR).await.unwrap();
    store.set_listeners(&[], FAR).await.unwrap();
    assert_eq!(store.count_listeners().await.unwrap(), 0);
    let later = Told::Later { after: 50, failure: "it answered 500".to_owned() };
    assert!(store.settle_delivery(&delivery.id, &lease, &later, FAR + 1).await.unwrap());
    assert_eq!(store.count_deliveries().await.unwrap(), DeliveryCounts { waiting: 0, dead: 1 });
    let dead = store.dead(None, 1).await.unwrap().remove(0);
    assert_eq!((dead.died, dead.failure.as_deref()), (Some(FAR + 1), Some("it answered 500")));
    // It can be sent again once the target is back.
    store.set_listeners(&[listener("all", None, &ENDS)], FAR + 2).await.unwrap();
    assert!(store.revive(&delivery.id, FAR + 3).await.unwrap());
}
