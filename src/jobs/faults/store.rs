//! A store whose commits pass their points.

use std::collections::HashSet;
use std::io;
use std::sync::Arc;

use futures::FutureExt;
use futures::future::BoxFuture;

use super::{Operation, Side, pass};
use crate::jobs::store::{JobStore, ListQuery, Page, Recovered, RetentionStore, StoreError, StoreFuture};
use crate::jobs::{Counts, Job, JobFailure, JobId, Lease, StoredArtifact};

/// A store in which commits can be made to fail. A new commit of the interface does not compile before it is here.
pub struct FaultyStore(pub Arc<dyn JobStore>);

/// A commit between its points.
pub(super) fn commit<'a, T: Send + 'a>(
    operation: Operation,
    commit: StoreFuture<'a, T>,
) -> StoreFuture<'a, T> {
    async move {
        pass(operation, Side::Before).map_err(failed)?;
        let done = commit.await?;
        pass(operation, Side::After).map_err(failed)?;
        Ok(done)
    }
    .boxed()
}

pub(super) fn failed(error: io::Error) -> StoreError {
    match error.kind() {
        io::ErrorKind::StorageFull => StoreError::Full(sqlx::Error::Io(error)),
        _ => StoreError::Unavailable(sqlx::Error::Io(error)),
    }
}

impl RetentionStore for FaultyStore {
    fn newest_created(&self) -> StoreFuture<'_, Option<i64>> {
        self.0.newest_created()
    }

    fn ended_before(&self, time: i64, limit: u32) -> StoreFuture<'_, Vec<JobId>> {
        self.0.ended_before(time, limit)
    }

    fn inputs_before(&self, time: i64, limit: u32) -> StoreFuture<'_, Vec<(JobId, String)>> {
        self.0.inputs_before(time, limit)
    }

    fn input_removed(&self, id: JobId, now: i64) -> StoreFuture<'_, ()> {
        commit(Operation::StoreInputRemoved, self.0.input_removed(id, now))
    }

    fn note_expired(&self, id: JobId, now: i64) -> StoreFuture<'_, ()> {
        commit(Operation::StoreNoteExpired, self.0.note_expired(id, now))
    }

    fn expired(&self, id: JobId) -> StoreFuture<'_, Option<Option<String>>> {
        self.0.expired(id)
    }

    fn ended_by(&self, now: i64) -> StoreFuture<'_, ()> {
        commit(Operation::StoreEndedBy, self.0.ended_by(now))
    }

    fn forget_expired(&self, time: i64) -> StoreFuture<'_, ()> {
        commit(Operation::StoreForgetExpired, self.0.forget_expired(time))
    }
}

impl JobStore for FaultyStore {
    fn insert<'a>(&'a self, job: &'a Job) -> StoreFuture<'a, ()> {
        commit(Operation::StoreInsert, self.0.insert(job))
    }

    fn get(&self, id: JobId) -> StoreFuture<'_, Option<Job>> {
        self.0.get(id)
    }

    fn by_key<'a>(&'a self, key: &'a str) -> StoreFuture<'a, Option<Job>> {
        self.0.by_key(key)
    }

    fn list(&self, query: ListQuery) -> StoreFuture<'_, Page> {
        self.0.list(query)
    }

    fn claim<'a>(&'a self, lease: &'a Lease, now: i64) -> StoreFuture<'a, Option<Job>> {
        async move {
            pass(Operation::StoreClaim, Side::Before).map_err(failed)?;
            let claimed = self.0.claim(lease, now).await?;
            // One that got nothing has committed nothing.
            if claimed.is_some() {
                pass(Operation::StoreClaim, Side::After).map_err(failed)?;
            }
            Ok(claimed)
        }
        .boxed()
    }

    fn progress<'a>(
        &'a self,
        id: JobId,
        lease: &'a Lease,
        percent: u8,
        stage: Option<&'a str>,
        now: i64,
    ) -> StoreFuture<'a, bool> {
        commit(Operation::StoreProgress, self.0.progress(id, lease, percent, stage, now))
    }

    fn succeed<'a>(
        &'a self,
        id: JobId,
        lease: &'a Lease,
        artifacts: &'a [StoredArtifact],
        now: i64,
    ) -> StoreFuture<'a, bool> {
        commit(Operation::StoreSucceed, self.0.succeed(id, lease, artifacts, now))
    }

    fn fail<'a>(
        &'a self,
        id: JobId,
        lease: &'a Lease,
        failure: &'a JobFailure,
        now: i64,
    ) -> StoreFuture<'a, bool> {
        commit(Operation::StoreFail, self.0.fail(id, lease, failure, now))
    }

    fn release<'a>(&'a self, id: JobId, lease: &'a Lease, now: i64) -> StoreFuture<'a, bool> {
        commit(Operation::StoreRelease, self.0.release(id, lease, now))
    }

    fn unclaim<'a>(&'a self, lease: &'a Lease, now: i64) -> StoreFuture<'a, bool> {
        commit(Operation::StoreUnclaim, self.0.unclaim(lease, now))
    }

    fn retry(&self, id: JobId, now: i64) -> StoreFuture<'_, bool> {
        commit(Operation::StoreRetry, self.0.retry(id, now))
    }

    fn dismiss(&self, id: JobId, now: i64) -> StoreFuture<'_, bool> {
        commit(Operation::StoreDismiss, self.0.dismiss(id, now))
    }

    fn begin_purge(&self, id: JobId, now: i64) -> StoreFuture<'_, bool> {
        commit(Operation::StoreBeginPurge, self.0.begin_purge(id, now))
    }

    fn purging(&self) -> StoreFuture<'_, Vec<JobId>> {
        self.0.purging()
    }

    fn delete(&self, id: JobId) -> StoreFuture<'_, bool> {
        commit(Operation::StoreDelete, self.0.delete(id))
    }

    fn recover(&self, max_crashes: u32, now: i64) -> StoreFuture<'_, Recovered> {
        commit(Operation::StoreRecover, self.0.recover(max_crashes, now))
    }

    fn counts(&self) -> StoreFuture<'_, Counts> {
        self.0.counts()
    }

    fn waiting(&self) -> StoreFuture<'_, u64> {
        self.0.waiting()
    }

    fn oldest_waiting(&self) -> StoreFuture<'_, Option<i64>> {
        self.0.oldest_waiting()
    }

    fn active_of<'a>(&'a self, owner: &'a str) -> StoreFuture<'a, u64> {
        self.0.active_of(owner)
    }

    fn newest(&self) -> StoreFuture<'_, Option<JobId>> {
        self.0.newest()
    }

    fn blob_keys<'a>(&'a self, ids: &'a [JobId]) -> StoreFuture<'a, HashSet<String>> {
        self.0.blob_keys(ids)
    }

    fn check(&self) -> StoreFuture<'_, ()> {
        self.0.check()
    }

    fn close(&self) -> BoxFuture<'_, ()> {
        self.0.close()
    }
}
