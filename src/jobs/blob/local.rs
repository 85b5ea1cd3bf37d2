//! Blobs as local files, through object_store's file system backend with fsync on.

use std::fs;
use std::io::{self, Read};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use bytes::{Bytes, BytesMut};
use futures::{FutureExt, StreamExt, TryStreamExt};
use object_store::local::LocalFileSystem;
use object_store::path::Path as Key;
use object_store::{MultipartUpload, ObjectStore, ObjectStoreExt, PutPayload};
use sha2::{Digest, Sha256};
use tokio::task::JoinHandle;

use crate::jobs::faults::{self, Operation, Side};
use crate::jobs::presence::Anchor;
use crate::jobs::stamp::Stamp;

use super::checked::{Checked, aside};
use super::sending::{Proof, pieces};
use super::{BlobBody, BlobError, BlobFuture, BlobInfo, BlobStore};

/// Bytes gathered before they are hashed and written.
const PART: usize = 1 << 20;
/// Bytes that are hashed sooner than another thread would begin to.
const SMALL: usize = 64 << 10;

/// A folder of blobs.
///
/// A blob is written to a staging file (`NAME#N`), fsynced, renamed into place, and its folder fsynced. Once it is open,
/// another folder at the same path is none of it.
pub struct LocalBlobs {
    files: LocalFileSystem,
    root: PathBuf,
    anchor: Arc<Anchor>,
    checked: Arc<Checked>,
}

impl LocalBlobs {
    /// Opens the folder, creates it if it is missing, and removes half-written files of a process that died.
    ///
    /// Blocks; no other process may use the folder.
    pub fn open(root: &Path) -> Result<Self, BlobError> {
        crate::jobs::folder::create(root).map_err(BlobError::Folder)?;
        let root = &fs::canonicalize(root).map_err(BlobError::Folder)?;
        let removed = remove_staged(root).map_err(BlobError::Folder)?;
        if removed > 0 {
            tracing::info!(files = removed, "removed half-written files");
        }
        let files = LocalFileSystem::new_with_prefix(root)?.with_fsync(true).with_automatic_cleanup(true);
        let anchor = Anchor::folder("the folder of meshes and results", root).map_err(BlobError::Folder)?;
        Ok(Self { files, root: root.to_owned(), anchor: Arc::new(anchor), checked: Checked::new() })
    }
}

impl LocalBlobs {
    /// Tells a blob that is gone from a folder that is: of a disk that was taken away nothing is known.
    async fn is_there(&self) -> Result<(), BlobError> {
        let anchor = self.anchor.clone();
        aside(move || Ok(anchor.check())).await.map_err(BlobError::Folder)??;
        Ok(())
    }

    /// That a blob is gone, unless its folder is.
    async fn seen(&self, error: BlobError) -> BlobError {
        match error {
            BlobError::NotFound { .. } => self.is_there().await.err().unwrap_or(error),
            error => error,
        }
    }

    /// Makes the folder of a blob: object_store would make the root again too where that was taken away.
    async fn make_folder(&self, key: &str) -> Result<(), BlobError> {
        let (root, file) = (self.root.clone(), self.path(key)?);
        aside(move || make_below(&root, &file)).await.map_err(BlobError::Folder)
    }

    async fn write(&self, key: &str, body: BlobBody<'_>, limit: u64) -> Result<BlobInfo, BlobError> {
        let [create, ..] = points(key);
        point(create, Side::Before)?;
        self.is_there().await?;
        self.make_folder(key).await?;
        // Dropping the upload removes its staging file.
        let upload =
            self.files.put_multipart(&Key::from(key)).await.map_err(|error| classified(key, error))?;
        point(create, Side::After)?;
        let mut writer = Writer { key, upload, hash: Sha256::new(), size: 0, part: BytesMut::new() };
        let kept = match writer.write(body, limit).await {
            // It may have been written beside the store.
            Ok(()) => self.is_there().await,
            failed => failed,
        };
        if let Err(error) = kept {
            // Its folder's sync may have failed with the file in its place.
            self.files.delete(&Key::from(key)).await.ok();
            return Err(error);
        }
        Ok(BlobInfo { size: writer.size, sha256: hex(writer.hash) })
    }

    fn path(&self, key: &str) -> Result<PathBuf, BlobError> {
        self.files.path_to_filesystem(&Key::from(key)).map_err(|error| classified(key, error))
    }

    /// What is in a blob, and its file's stamp.
    async fn found(&self, key: &str) -> Result<(Stamp, BlobInfo), BlobError> {
        match self.checked.info(self.path(key)?, looked_at).await {
            Ok(found) => Ok(found),
            Err(error) => Err(self.seen(unread(key, error)).await),
        }
    }
}

/// Makes the folders of `file` below `root`, which is there or else this fails, and sees that they stay.
fn make_below(root: &Path, file: &Path) -> io::Result<()> {
    let folders = file.ancestors().skip(1).take_while(|folder| *folder != root);
    for folder in folders.collect::<Vec<_>>().into_iter().rev() {
        match fs::create_dir(folder) {
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
            made => {
                made?;
                fs::File::open(folder.parent().unwrap_or(root))?.sync_all()?;
            }
        }
    }
    Ok(())
}

/// Why a blob's file could not be read.
fn unread(key: &str, error: io::Error) -> BlobError {
    let key = || key.to_owned();
    match error.kind() {
        io::ErrorKind::NotFound => BlobError::NotFound { key: key() },
        io::ErrorKind::InvalidData => BlobError::Changed { key: key() },
        _ => BlobError::Folder(error),
    }
}

/// Why a file could not be written.
pub(super) fn unwritten(error: io::Error) -> BlobError {
    match error.kind() {
        io::ErrorKind::StorageFull => BlobError::Full,
        _ => BlobError::Folder(error),
    }
}

/// Removes object_store's staging files and folders that are empty; the number of files removed.
fn remove_staged(folder: &Path) -> io::Result<usize> {
    let mut removed = 0;
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        if entry.file_type()?.is_dir() {
            removed += remove_staged(&entry.path())?;
            if fs::read_dir(entry.path())?.next().is_none() {
                fs::remove_dir(entry.path())?;
            }
        } else if entry.file_name().as_encoded_bytes().contains(&b'#') {
            fs::remove_file(entry.path())?;
            removed += 1;
        }
    }
    Ok(removed)
}

/// Tells a missing blob and a full disk from other failures.
fn classified(key: &str, error: object_store::Error) -> BlobError {
    if matches!(error, object_store::Error::NotFound { .. }) {
        return BlobError::NotFound { key: key.to_owned() };
    }
    let mut cause: Option<&(dyn std::error::Error + 'static)> = Some(&error);
    while let Some(inner) = cause {
        let kind = inner.downcast_ref::<io::Error>().map(io::Error::kind);
        if matches!(kind, Some(io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded)) {
            return BlobError::Full;
        }
        cause = inner.source();
    }
    BlobError::Storage(error)
}

/// Reads a file through, a piece at a time.
fn looked_at(path: &Path) -> io::Result<BlobInfo> {
    // At a pipe, which is no result, it would wait for ever.
    if !fs::metadata(path)?.is_file() {
        return Err(io::Error::new(io::ErrorKind::InvalidData, "it is no regular file"));
    }
    let (mut file, mut hash) = (fs::File::open(path)?, Sha256::new());
    let (mut piece, mut size) = (vec![0; SMALL], 0);
    loop {
        match file.read(&mut piece)? {
            0 => return Ok(BlobInfo { size, sha256: hex(hash) }),
            bytes => {
                hash.update(&piece[..bytes]);
                size += bytes as u64;
            }
        }
    }
}

pub(super) fn hex(hash: Sha256) -> String {
    hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Passes a point.
fn point(operation: Operation, side: Side) -> Result<(), BlobError> {
    faults::pass(operation, side).map_err(unwritten)
}

/// The points of a blob's creation, of its writes, and of its commit.
fn points(key: &str) -> [Operation; 3] {
    if key.ends_with("/input") {
        [Operation::InputCreate, Operation::InputWrite, Operation::InputCommit]
    } else {
        [Operation::ResultCreate, Operation::ResultWrite, Operation::ResultCommit]
    }
}

/// An upload under way: gathers parts, hashes and writes them off the async threads.
struct Writer<'a> {
    key: &'a str,
    upload: Box<dyn MultipartUpload>,
    hash: Sha256,
    size: u64,
    part: BytesMut,
}

impl Writer<'_> {
    async fn flush(&mut self) -> Result<(), BlobError> {
        let part = self.part.split().freeze();
        if part.is_empty() {
            return Ok(());
        }
        let hashing = self.hashing(part.clone());
        let [_, write, _] = points(self.key);
        point(write, Side::Before)?;
        self.upload
            .put_part(PutPayload::from_bytes(part))
            .await
            .map_err(|error| classified(self.key, error))?;
        point(write, Side::After)?;
        if let Some(hashing) = hashing {
            self.hash = hashing.await.map_err(|error| BlobError::Folder(io::Error::other(error)))?;
        }
        Ok(())
    }

    /// Hashes a part; a small one at once, a large one beside its write.
    fn hashing(&mut self, part: Bytes) -> Option<JoinHandle<Sha256>> {
        if part.len() <= SMALL {
            self.hash.update(&part);
            return None;
        }
        let mut hash = std::mem::take(&mut self.hash);
        Some(tokio::task::spawn_blocking(move || {
            hash.update(&part);
            hash
        }))
    }

    async fn write(&mut self, mut body: BlobBody<'_>, limit: u64) -> Result<(), BlobError> {
        while let Some(bytes) = body.next().await {
            let bytes = bytes.map_err(BlobError::Upload)?;
            self.size += bytes.len() as u64;
            if self.size > limit {
                return Err(BlobError::TooLarge { limit });
            }
            self.part.extend_from_slice(&bytes);
            if self.part.len() >= PART {
                self.flush().await?;
            }
        }
        self.flush().await?;
        let [_, _, commit] = points(self.key);
        point(commit, Side::Before)?;
        self.upload.complete().await.map_err(|error| classified(self.key, error))?;
        point(commit, Side::After)
    }
}

impl BlobStore for LocalBlobs {
    fn put<'a>(&'a self, key: &'a str, body: BlobBody<'a>, limit: u64) -> BlobFuture<'a, BlobInfo> {
        async move {
            match self.write(key, body, limit).await {
                // What was being written is gone, by nobody's order.
                Err(error @ BlobError::NotFound { .. }) => {
                    self.is_there().await?;
                    Err(BlobError::Folder(io::Error::other(error)))
                }
                written => written,
            }
        }
        .boxed()
    }

    fn open<'a>(
        &'a self,
        key: &'a str,
        of: &'a BlobInfo,
        range: Option<Range<u64>>,
    ) -> BlobFuture<'a, BlobBody<'static>> {
        async move {
            let path = self.path(key)?;
            let (range, proof) = match range {
                None => (0..of.size, Proof::digest(&of.sha256)),
                Some(range) => {
                    let (stamp, found) = self.found(key).await?;
                    if found != *of {
                        return Err(BlobError::Changed { key: key.to_owned() });
                    }
                    (range, Proof::Stamp(stamp))
                }
            };
            let changed = key.to_owned();
            let pieces = match pieces(&path, range, proof).await {
                Ok(pieces) => pieces,
                Err(error) => return Err(self.seen(unread(key, error)).await),
            };
            Ok(pieces.map_err(move |error| io::Error::other(unread(&changed, error))).boxed())
        }
        .boxed()
    }

    fn info<'a>(&'a self, key: &'a str) -> BlobFuture<'a, BlobInfo> {
        async move { Ok(self.found(key).await?.1) }.boxed()
    }

    fn read<'a>(&'a self, key: &'a str) -> BlobFuture<'a, Bytes> {
        async move {
            let whole = async { self.files.get(&Key::from(key)).await?.bytes().await };
            match whole.await {
                Ok(bytes) => Ok(bytes),
                Err(error) => Err(self.seen(classified(key, error)).await),
            }
        }
        .boxed()
    }

    fn delete<'a>(&'a self, key: &'a str) -> BlobFuture<'a, ()> {
        async move {
            point(Operation::FileDelete, Side::Before)?;
            self.is_there().await?;
            match self.files.delete(&Key::from(key)).await {
                Ok(()) => point(Operation::FileDelete, Side::After),
                Err(object_store::Error::NotFound { .. }) => self.is_there().await,
                Err(error) => Err(classified(key, error)),
            }
        }
        .boxed()
    }

    fn list<'a>(&'a self, folder: &'a str) -> BlobFuture<'a, Vec<String>> {
        async move {
            self.is_there().await?;
            let prefix = Key::from(folder);
            let listed = self.files.list(if folder.is_empty() { None } else { Some(&prefix) });
            let objects: Vec<_> = listed.try_collect().await.map_err(|error| classified("", error))?;
            // One that was taken away meanwhile looks empty.
            self.is_there().await?;
            Ok(objects.into_iter().map(|object| object.location.to_string()).collect())
        }
        .boxed()
    }

    fn check(&self) -> BlobFuture<'_, ()> {
        async move {
            self.is_there().await?;
            let probe = self.root.join("probe#check");
            let written = tokio::task::spawn_blocking(move || crate::jobs::folder::try_write(&probe));
            match written.await {
                Ok(written) => written.map_err(unwritten),
                Err(error) => Err(BlobError::Folder(io::Error::other(error))),
            }
        }
        .boxed()
    }
}
