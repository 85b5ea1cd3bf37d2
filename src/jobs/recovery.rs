//! What a start does with the traces of the process before it.

use std::collections::BTreeMap;

use super::blob::BlobStore;
use super::store::{JobStore, StoreError};
use super::{JobError, JobId};

/// Jobs looked up at once.
const CHUNK: usize = 500;

/// Puts interrupted jobs back and removes files that no job owns. Nothing else may use either store.
pub(super) async fn recover(
    store: &dyn JobStore,
    blobs: &dyn BlobStore,
    max_crashes: u32,
    now: i64,
) -> Result<(), JobError> {
    let recovered = store.recover(max_crashes, now).await?;
    if recovered.requeued + recovered.failed > 0 {
        tracing::warn!(
            requeued = recovered.requeued,
            failed = recovered.failed,
            "the last process did not stop in order"
        );
    }
    finish_purges(store, blobs).await?;
    let removed = remove_orphans(store, blobs).await?;
    if removed > 0 {
        tracing::info!(files = removed, "removed files without a job");
    }
    Ok(())
}

/// Ends the purges that were begun; one that cannot be ended now is tried again later.
pub(super) async fn finish_purges(store: &dyn JobStore, blobs: &dyn BlobStore) -> Result<(), StoreError> {
    for id in store.purging().await? {
        match purge(store, blobs, id).await {
            Ok(()) => tracing::info!(%id, "purged"),
            Err(error) => tracing::error!(%id, %error, "the purge cannot be ended now"),
        }
    }
    Ok(())
}

/// Removes a job's files, then its row, which says until then that they may be there.
pub(super) async fn purge(store: &dyn JobStore, blobs: &dyn BlobStore, id: JobId) -> Result<(), JobError> {
    for key in blobs.list(&id.to_string()).await? {
        blobs.delete(&key).await?;
    }
    store.delete(id).await?;
    Ok(())
}

/// Removes every blob that no row names; the number removed.
async fn remove_orphans(store: &dyn JobStore, blobs: &dyn BlobStore) -> Result<usize, JobError> {
    let mut owners: BTreeMap<JobId, Vec<String>> = BTreeMap::new();
    for key in blobs.list("").await? {
        let owner = key.split('/').next().and_then(|first| first.parse().ok());
        // Files of another shape are not ours to remove.
        if let Some(owner) = owner {
            owners.entry(owner).or_default().push(key);
        }
    }
    let mut removed = 0;
    let owners: Vec<(JobId, Vec<String>)> = owners.into_iter().collect();
    for chunk in owners.chunks(CHUNK) {
        let ids: Vec<JobId> = chunk.iter().map(|(id, _)| *id).collect();
        let owned = match store.blob_keys(&ids).await {
            Ok(owned) => owned,
            Err(error @ StoreError::Corrupt { .. }) => {
                tracing::error!(%error, "files are left alone whose owners cannot be read");
                continue;
            }
            Err(error) => return Err(error.into()),
        };
        for key in chunk.iter().flat_map(|(_, keys)| keys).filter(|key| !owned.contains(*key)) {
            match blobs.delete(key).await {
                Ok(()) => removed += 1,
                Err(error) => {
                    tracing::error!(%error, "a file without a job cannot be removed; the next start tries again")
                }
            }
        }
    }
    Ok(removed)
}
