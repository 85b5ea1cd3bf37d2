//! The bytes of a file as they go out: one that is not, or is no longer, what it was found to be is cut short and never
//! sent to its end.

use std::fs::{self, File};
use std::io;
use std::ops::Range;
use std::os::unix::fs::FileExt;
use std::path::Path;

use bytes::Bytes;
use futures::StreamExt;
use futures::stream::{self, BoxStream};
use sha2::{Digest, Sha256};

use super::checked::aside;
use super::local::hex;
use crate::jobs::stamp::Stamp;

/// Bytes that are read at a time, and in memory for a client that is slow. Most results are one piece.
const PIECE: u64 = 256 << 10;

/// What shows that the bytes are the right ones.
pub(super) enum Proof {
    /// Of a whole file: its digest, known with the last piece, which is held back until then.
    Digest(Sha256, String),
    /// Of a part: that the open file's bytes are as they were when it was read through, after each piece. It may be
    /// linked or removed meanwhile.
    Stamp(Stamp),
}

impl Proof {
    /// Of a whole file with this SHA-256.
    pub(super) fn digest(sha256: &str) -> Self {
        Self::Digest(Sha256::new(), sha256.to_owned())
    }
}

/// An open file, and what of it has not been sent yet.
struct Sending {
    file: File,
    left: Range<u64>,
    proof: Proof,
}

/// The bytes of `range`, the first piece read already: a small file that is wrong is an error before anything is sent.
///
/// # Errors
/// [`io::ErrorKind::InvalidData`], also later, where the file is not what it was found to be.
pub(super) async fn pieces(
    path: &Path,
    range: Range<u64>,
    proof: Proof,
) -> io::Result<BoxStream<'static, io::Result<Bytes>>> {
    let path = path.to_owned();
    let begun = aside(move || {
        // At a pipe, which is no result, it would wait for ever.
        if !fs::metadata(&path)?.is_file() {
            return Err(changed());
        }
        Sending { file: File::open(path)?, left: range, proof }.next()
    });
    let Some((first, sending)) = begun.await? else { return Ok(stream::empty().boxed()) };
    let rest = stream::try_unfold(sending, |sending| aside(move || sending.next()));
    Ok(stream::iter([Ok(first)]).chain(rest).boxed())
}

impl Sending {
    fn next(mut self) -> io::Result<Option<(Bytes, Self)>> {
        let length = self.left.end.saturating_sub(self.left.start).min(PIECE);
        if length == 0 {
            return Ok(None);
        }
        let mut piece = vec![0; length as usize];
        self.file.read_exact_at(&mut piece, self.left.start).map_err(|error| match error.kind() {
            io::ErrorKind::UnexpectedEof => changed(),
            _ => error,
        })?;
        self.left.start += length;
        let is_right = match &mut self.proof {
            Proof::Stamp(stamp) => Stamp::of(&self.file.metadata()?).has_bytes_of(stamp),
            Proof::Digest(hash, wanted) => {
                hash.update(&piece);
                self.left.start < self.left.end || hex(std::mem::take(hash)) == *wanted
            }
        };
        if is_right { Ok(Some((piece.into(), self))) } else { Err(changed()) }
    }
}

fn changed() -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, "the file has changed since it was looked at")
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: u64 = 5 * PIECE / 2;

    /// What comes of a file, and whether it ends in an error.
    async fn sent(
        path: &Path,
        range: Range<u64>,
        proof: Proof,
        meanwhile: impl FnOnce(),
    ) -> io::Result<(u64, bool)> {
        let mut stream = pieces(path, range, proof).await?;
        meanwhile();
        let (mut length, mut is_cut) = (0, false);
        while let Some(piece) = stream.next().await {
            match piece {
                Ok(piece) => length += piece.len() as u64,
                Err(_) => is_cut = true,
            }
        }
        Ok((length, is_cut))
    }

    #[tokio::test]
    async fn the_last_piece_waits_for_the_digest_and_a_part_for_the_stamp() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("result");
        let bytes: Vec<u8> = (0..SIZE).map(|place| (place % 251) as u8).collect();
        let restore = || fs::write(&path, &bytes).unwrap();
        // In its first byte, which has gone out by then, or in the last; or cut.
        let change = |place: usize| {
            let mut other = bytes.clone();
            other[place] ^= 1;
            fs::write(&path, other).unwrap();
        };
        let cut = || fs::write(&path, &bytes[..10]).unwrap();
        let digest = || Proof::digest(&hex(Sha256::new().chain_update(&bytes)));
        let stamp = || Proof::Stamp(Stamp::of(&fs::metadata(&path).unwrap()));
        restore();
        assert_eq!(sent(&path, 0..SIZE, digest(), || {}).await.unwrap(), (SIZE, false));
        assert_eq!(sent(&path, 3..SIZE - 3, stamp(), || {}).await.unwrap(), (SIZE - 6, false));
        let late = || change(bytes.len() - 1);
        assert_eq!(sent(&path, 0..SIZE, digest(), late).await.unwrap(), (2 * PIECE, true));
        restore();
        assert_eq!(sent(&path, 0..SIZE, digest(), cut).await.unwrap(), (PIECE, true));
        restore();
        tokio::time::sleep(2 * crate::jobs::stamp::SETTLED).await;
        assert_eq!(sent(&path, 0..SIZE, stamp(), late).await.unwrap(), (PIECE, true));
        // Changed between the look and the sending.
        change(0);
        assert_eq!(sent(&path, 0..SIZE, digest(), || {}).await.unwrap(), (2 * PIECE, true));
        fs::write(&path, b"small").unwrap();
        assert!(sent(&path, 0..5, digest(), || {}).await.is_err(), "before anything is sent");
    }

    /// As by a backup of hard links, and by `DELETE` while a client is slow.
    #[tokio::test]
    async fn a_part_ends_well_though_its_file_is_linked_shut_or_removed_meanwhile() {
        use std::os::unix::fs::PermissionsExt;

        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("result");
        fs::write(&path, vec![7u8; SIZE as usize]).unwrap();
        // Longer than a tick, so that each shows in the time of change of the inode.
        tokio::time::sleep(2 * crate::jobs::stamp::SETTLED).await;
        let linked = || fs::hard_link(&path, folder.path().join("backup")).unwrap();
        let shut = || fs::set_permissions(&path, fs::Permissions::from_mode(0o400)).unwrap();
        let removed = || fs::remove_file(&path).unwrap();
        let all: [&dyn Fn(); 3] = [&linked, &shut, &removed];
        for meanwhile in all {
            let proof = Proof::Stamp(Stamp::of(&fs::metadata(&path).unwrap()));
            assert_eq!(sent(&path, 3..SIZE - 3, proof, meanwhile).await.unwrap(), (SIZE - 6, false));
            tokio::time::sleep(crate::jobs::stamp::SETTLED).await;
        }
        assert!(!path.exists());
    }
}
