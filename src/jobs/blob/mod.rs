//! The blob store: inputs and results as files, by key.

mod checked;
mod local;
mod sending;
#[cfg(test)]
mod tests;

use std::io;
use std::ops::Range;

use bytes::Bytes;
use futures::future::BoxFuture;
use futures::stream::BoxStream;

use super::Displaced;
pub use local::LocalBlobs;

/// Why the blob store did not do as asked.
#[derive(Debug, thiserror::Error)]
pub enum BlobError {
    #[error("there is no blob {key}")]
    NotFound { key: String },
    #[error(
        "the blob {key} is not what was stored; put a copy of its file back, or delete its job and post the mesh again"
    )]
    Changed { key: String },
    #[error("the upload is larger than the limit of {limit} bytes")]
    TooLarge { limit: u64 },
    #[error("the upload broke off: {0}")]
    Upload(io::Error),
    #[error("the disk under the data folder is full; free space on it")]
    Full,
    #[error("the blob store failed: {0}")]
    Storage(#[from] object_store::Error),
    #[error("the blob folder cannot be used: {0}")]
    Folder(io::Error),
    #[error(transparent)]
    Displaced(#[from] Displaced),
}

/// What a blob method answers.
pub type BlobFuture<'a, T> = BoxFuture<'a, Result<T, BlobError>>;

/// Bytes of a blob, as they come.
pub type BlobBody<'a> = BoxStream<'a, io::Result<Bytes>>;

/// A blob that was stored.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BlobInfo {
    /// Bytes.
    pub size: u64,
    /// SHA-256 of the bytes, lower-case hex.
    pub sha256: String,
}

/// Named immutable byte strings. Keys are relative paths of plain ASCII segments.
pub trait BlobStore: Send + Sync + 'static {
    /// Stores `body` under `key`. When the future is ready the blob is whole and durable; until then, and
    /// after an error or a drop, there is none. Memory use does not grow with the body.
    ///
    /// # Errors
    /// [`BlobError::TooLarge`] as soon as the body passes `limit` bytes.
    fn put<'a>(&'a self, key: &'a str, body: BlobBody<'a>, limit: u64) -> BlobFuture<'a, BlobInfo>;

    /// The bytes of the blob that `of` tells of, or of a `range` within it. Where others are there, also from some moment
    /// on, the stream fails before its end: a whole that is wrong is never given whole, nor is a byte of a part that is.
    ///
    /// # Errors
    /// [`BlobError::Changed`] where that is known at once.
    fn open<'a>(
        &'a self,
        key: &'a str,
        of: &'a BlobInfo,
        range: Option<Range<u64>>,
    ) -> BlobFuture<'a, BlobBody<'static>>;

    /// Size and SHA-256 of the bytes that are there now. They may be those found before where nothing says that the blob
    /// has changed since.
    fn info<'a>(&'a self, key: &'a str) -> BlobFuture<'a, BlobInfo>;

    /// A whole blob in memory.
    fn read<'a>(&'a self, key: &'a str) -> BlobFuture<'a, Bytes>;

    /// Removes a blob; one that is not there is no error, a store that is not there is.
    fn delete<'a>(&'a self, key: &'a str) -> BlobFuture<'a, ()>;

    /// The keys of every blob under `folder`; the empty one holds them all.
    fn list<'a>(&'a self, folder: &'a str) -> BlobFuture<'a, Vec<String>>;

    /// Fails unless a blob can be written.
    fn check(&self) -> BlobFuture<'_, ()>;
}
