//! What every blob store must do, tried on local files.

use std::fs;
use std::path::Path;
use std::time::Duration;

use futures::{StreamExt, TryStreamExt, stream};
use sha2::{Digest, Sha256};

use super::*;

fn body(chunks: Vec<Vec<u8>>) -> BlobBody<'static> {
    stream::iter(chunks.into_iter().map(|chunk| Ok(Bytes::from(chunk)))).boxed()
}

fn hex(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Every file below `folder`, staging files included.
fn files(folder: &Path) -> Vec<String> {
    let mut names = Vec::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            names.extend(files(&path));
        } else {
            names.push(path.display().to_string());
        }
    }
    names
}

async fn no_files(folder: &Path) -> bool {
    for _ in 0..100 {
        if files(folder).is_empty() {
            return true;
        }
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    false
}

#[tokio::test]
async fn bytes_come_back_with_their_size_and_hash() {
    let dir = tempfile::tempdir().unwrap();
    let store = LocalBlobs::open(&dir.path().join("blobs")).unwrap();
    let large: Vec<u8> = (0..3_500_000_u32).map(|place| (place % 251) as u8).collect();
    let chunked: Vec<Vec<u8>> = large.chunks(60_001).map(<[u8]>::to_vec).collect();
    for (key, chunks) in [("a/input", chunked), ("b/empty", vec![]), ("b/c/one", vec![vec![7]])] {
        let bytes = chunks.concat();
        let info = store.put(key, body(chunks), u64::MAX).await.unwrap();
        assert_eq!(info, BlobInfo { size: bytes.len() as u64, sha256: hex(&bytes) });
        assert_eq!(store.read(key).await.unwrap(), bytes);
    }
    let mut keys = store.list("").await.unwrap();
    keys.sort();
    assert_eq!(keys, ["a/input", "b/c/one", "b/empty"]);
    let mut keys_of_b = store.list("b").await.unwrap();
    keys_of_b.sort();
    assert_eq!(keys_of_b, ["b/c/one", "b/empty"]);
    assert!(store.list("c").await.unwrap().is_empty());
    let of = store.info("a/input").await.unwrap();
    for (range, wanted) in [(None, &large[..]), (Some(1_000_000..2_500_001), &large[1_000_000..2_500_001])] {
        let part = store.open("a/input", &of, range).await.unwrap();
        assert_eq!(part.try_collect::<Vec<Bytes>>().await.unwrap().concat(), wanted);
    }
    let other = BlobInfo { sha256: hex(b"other"), ..of.clone() };
    assert!(matches!(store.open("a/input", &other, Some(0..9)).await, Err(BlobError::Changed { .. })));
    for key in &keys {
        store.delete(key).await.unwrap();
        store.delete(key).await.unwrap();
        assert!(matches!(store.read(key).await, Err(BlobError::NotFound { .. })));
        assert!(matches!(store.open(key, &of, None).await, Err(BlobError::NotFound { .. })));
    }
    store.put("again/input", body(vec![vec![1]]), 1).await.unwrap();
    assert_eq!(store.list("").await.unwrap(), ["again/input"], "the folder outlives its last blob");
}

#[tokio::test]
async fn a_body_over_the_limit_leaves_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let store = LocalBlobs::open(dir.path()).unwrap();
    let exact = store.put("exact", body(vec![vec![0; 600], vec![0; 400]]), 1000).await.unwrap();
    assert_eq!(exact.size, 1000);
    store.delete("exact").await.unwrap();
    // An endless body is cut at the limit.
    let endless = stream::repeat_with(|| Ok(Bytes::from_static(&[0; 65_536]))).boxed();
    let error = store.put("large/input", endless, 5_000_000).await.unwrap_err();
    assert!(matches!(error, BlobError::TooLarge { limit: 5_000_000 }));
    assert!(no_files(dir.path()).await, "{:?}", files(dir.path()));
}

#[tokio::test]
async fn a_body_that_breaks_off_or_is_dropped_leaves_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let store = LocalBlobs::open(dir.path()).unwrap();
    let broken =
        stream::iter([Ok(Bytes::from(vec![0; 2_000_000])), Err(io::ErrorKind::ConnectionReset.into())]);
    let error = store.put("broken/input", broken.boxed(), u64::MAX).await.unwrap_err();
    assert!(matches!(error, BlobError::Upload(_)), "{error}");
    assert!(no_files(dir.path()).await);
    let stalled = stream::iter([Ok(Bytes::from(vec![0; 2_000_000]))]).chain(stream::pending()).boxed();
    let dropped =
        tokio::time::timeout(Duration::from_millis(200), store.put("stalled/input", stalled, u64::MAX));
    assert!(dropped.await.is_err());
    assert!(no_files(dir.path()).await);
    assert!(store.list("").await.unwrap().is_empty());
}

#[tokio::test]
async fn a_blob_is_not_seen_before_it_is_whole_and_half_ones_go_at_the_next_start() {
    let dir = tempfile::tempdir().unwrap();
    let store = LocalBlobs::open(dir.path()).unwrap();
    store.put("kept/input", body(vec![vec![1; 10]]), 10).await.unwrap();
    let stalled = stream::iter([Ok(Bytes::from(vec![0; 2_000_000]))]).chain(stream::pending()).boxed();
    let mut put = store.put("half/input", stalled, u64::MAX);
    assert!(tokio::time::timeout(Duration::from_millis(200), &mut put).await.is_err());
    assert_eq!(store.list("").await.unwrap(), ["kept/input"]);
    assert!(matches!(store.read("half/input").await, Err(BlobError::NotFound { .. })));
    assert_eq!(files(dir.path()).len(), 2, "the staging file is there");
    // As after a kill: a second start while the first put's file is still on disk.
    let reopened = LocalBlobs::open(dir.path()).unwrap();
    assert_eq!(files(dir.path()).len(), 1);
    assert!(!dir.path().join("half").exists(), "its empty folder goes too");
    assert_eq!(reopened.read("kept/input").await.unwrap().len(), 10);
}

#[tokio::test]
async fn a_check_fails_when_the_folder_is_gone() {
    let dir = tempfile::tempdir().unwrap();
    let store = LocalBlobs::open(dir.path()).unwrap();
    store.check().await.unwrap();
    assert!(files(dir.path()).is_empty(), "a check leaves no trace");
    fs::remove_dir_all(dir.path()).unwrap();
    assert!(matches!(store.check().await, Err(BlobError::Displaced(_))));
    assert!(
        matches!(store.delete("a/input").await, Err(BlobError::Displaced(_))),
        "nobody knows whether it is gone"
    );
    assert!(matches!(store.list("").await, Err(BlobError::Displaced(_))));
    assert!(matches!(store.put("a/input", body(vec![vec![1]]), 1).await, Err(BlobError::Displaced(_))));
    assert!(!dir.path().exists(), "it is not made again");
}

#[cfg(unix)]
#[test]
fn a_full_disk_is_told_from_other_failures() {
    // /dev/full refuses every write with ENOSPC; where there is none, there is nothing to try.
    if !Path::new("/dev/full").exists() {
        println!("skipped: no /dev/full here");
        return;
    }
    let full = fs::write("/dev/full", "x").unwrap_err();
    assert!(matches!(local::unwritten(full), BlobError::Full));
    let other = fs::write("/dev/full/x", "x").unwrap_err();
    assert!(matches!(local::unwritten(other), BlobError::Folder(_)));
}
