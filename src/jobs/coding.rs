//! How a stored result is compressed.

use std::io::{self, Write};

use flate2::Compression;
use flate2::write::GzEncoder;
use serde::{Deserialize, Serialize};

use crate::centerline::CancelToken;

/// Results below this many bytes are not compressed: they go into one packet as they are.
pub(super) const LEAST: usize = 1 << 10;
/// Of zstd's 22: higher ones take many times as long for a few percent.
const ZSTD_LEVEL: i32 = 9;

/// Bytes that are compressed between two looks at the cancellation.
const STEP: usize = 64 << 10;

fn feed(encoder: &mut impl Write, bytes: &[u8], cancel: &CancelToken) -> io::Result<()> {
    for step in bytes.chunks(STEP) {
        if cancel.is_cancelled() {
            return Err(io::ErrorKind::Interrupted.into());
        }
        encoder.write_all(step)?;
    }
    Ok(())
}

/// A content coding (RFC 9110, section 8.4.1).
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Coding {
    /// The bytes as they are.
    #[default]
    Identity,
    Gzip,
    Zstd,
}

impl Coding {
    /// Those that change the bytes.
    pub const PACKED: [Coding; 2] = [Coding::Gzip, Coding::Zstd];

    /// The coding's word in HTTP.
    pub fn name(self) -> &'static str {
        match self {
            Coding::Identity => "identity",
            Coding::Gzip => "gzip",
            Coding::Zstd => "zstd",
        }
    }

    /// What its files' names end with.
    pub(super) fn suffix(self) -> &'static str {
        match self {
            Coding::Identity => "",
            Coding::Gzip => ".gz",
            Coding::Zstd => ".zst",
        }
    }

    pub(super) fn is_identity(&self) -> bool {
        *self == Coding::Identity
    }

    /// The bytes in this coding; the same ones for the same input.
    ///
    /// # Errors
    /// [`io::ErrorKind::Interrupted`] soon after `cancel` is set.
    pub(super) fn pack(self, bytes: &[u8], cancel: &CancelToken) -> io::Result<Vec<u8>> {
        match self {
            Coding::Identity => Ok(bytes.to_vec()),
            Coding::Gzip => {
                let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
                feed(&mut encoder, bytes, cancel)?;
                encoder.finish()
            }
            Coding::Zstd => {
                let mut encoder = zstd::Encoder::new(Vec::new(), ZSTD_LEVEL)?;
                // With it the frame says how long it will be, and short ones get smaller tables.
                encoder.set_pledged_src_size(Some(bytes.len() as u64))?;
                feed(&mut encoder, bytes, cancel)?;
                encoder.finish()
            }
        }
    }
}
