//! The data arrays of VTK's XML files: ASCII, base64 or raw, inline or appended, zlib-compressed or not.

use std::borrow::Cow;
use std::cell::Cell;

use base64::Engine;
use base64::alphabet::STANDARD;
use base64::engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig};
use flate2::{Decompress, FlushDecompress, Status};
use quick_xml::events::BytesStart;
use rayon::prelude::*;

use super::ReadError;
use super::scalar::{ByteOrder, Scalar};
use super::surface::check_limit;
use super::text::Tokens;
use super::values::Values;
use super::vtp_structure::{FORMAT, attribute, malformed};

/// Deflate cannot pack more than this many bytes into one.
const MOST_DEFLATED: usize = 1032;

/// VTK pads as it should; others do not.
const BASE64: GeneralPurpose = GeneralPurpose::new(
    &STANDARD,
    GeneralPurposeConfig::new()
        .with_decode_padding_mode(DecodePaddingMode::Indifferent)
        .with_decode_allow_trailing_bits(true),
);

/// What an array is to its cells, by its name.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Role {
    Connectivity,
    Offsets,
    /// VMTK's `MaximumInscribedSphereRadius`, 3D Slicer's `Radius`.
    InscribedRadius,
    Other,
}

impl Role {
    pub(super) fn of(tag: &BytesStart<'_>) -> Self {
        match attribute(tag, "Name") {
            Some("connectivity") => Role::Connectivity,
            Some("offsets") => Role::Offsets,
            Some("MaximumInscribedSphereRadius" | "Radius") => Role::InscribedRadius,
            _ => Role::Other,
        }
    }
}

/// The attribute `format`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Coding {
    Ascii,
    Binary,
    /// At this offset of the appended data.
    Appended(usize),
}

/// A `DataArray`, its data still as they stand in the file.
#[derive(Debug)]
pub(super) struct Array<'a> {
    pub(super) role: Role,
    pub(super) scalar: Scalar,
    coding: Coding,
    /// Of an inline array.
    pub(super) text: &'a str,
}

impl Array<'_> {
    pub(super) fn new(tag: &BytesStart<'_>) -> Result<Self, ReadError> {
        let role = Role::of(tag);
        let scalar = match attribute(tag, "type") {
            Some("Int8") => Scalar::I8,
            Some("UInt8") => Scalar::U8,
            Some("Int16") => Scalar::I16,
            Some("UInt16") => Scalar::U16,
            Some("Int32") => Scalar::I32,
            Some("UInt32") => Scalar::U32,
            Some("Int64" | "vtkIdType") => Scalar::I64,
            Some("UInt64") => Scalar::U64,
            Some("Float32") => Scalar::F32,
            Some("Float64") => Scalar::F64,
            _ => return Err(malformed("a data array has no known type")),
        };
        let coding = match attribute(tag, "format") {
            Some("ascii") | None => Coding::Ascii,
            Some("binary") => Coding::Binary,
            Some("appended") => {
                let offset = attribute(tag, "offset").and_then(|offset| offset.parse().ok());
                Coding::Appended(offset.ok_or_else(|| malformed("an appended data array has no offset"))?)
            }
            Some(_) => return Err(malformed("a data array is neither ascii, binary nor appended")),
        };
        Ok(Array { role, scalar, coding, text: "" })
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Compression {
    None,
    Zlib,
    /// One that is not read here, by name.
    Other(&'static str),
}

/// The data behind the tag `AppendedData`, from the underscore on.
pub(super) enum Appended<'a> {
    Base64(Cow<'a, [u8]>),
    Raw(&'a [u8]),
}

impl<'a> Appended<'a> {
    pub(super) fn new(data: &'a [u8], is_base64: bool) -> Result<Self, ReadError> {
        let data = data.trim_ascii_start();
        let data = data.strip_prefix(b"_").ok_or_else(|| malformed("its appended data begin without a _"))?;
        if !is_base64 {
            return Ok(Appended::Raw(data));
        }
        let end = data.iter().position(|&byte| byte == b'<').unwrap_or(data.len());
        Ok(Appended::Base64(without_space(&data[..end])))
    }
}

fn without_space(text: &[u8]) -> Cow<'_, [u8]> {
    let text = text.trim_ascii();
    if text.iter().any(u8::is_ascii_whitespace) {
        Cow::Owned(text.iter().copied().filter(|byte| !byte.is_ascii_whitespace()).collect())
    } else {
        Cow::Borrowed(text)
    }
}

/// How the arrays of a file are coded.
pub(super) struct Decoder<'a> {
    pub(super) order: ByteOrder,
    /// The type of the counts before binary data.
    pub(super) header: Scalar,
    pub(super) compression: Compression,
    pub(super) appended: Option<Appended<'a>>,
    /// Bytes that were unpacked so far, and may be in all.
    pub(super) unpacked: Cell<usize>,
    pub(super) limit: usize,
}

/// The numbers of an array.
pub(super) enum Data<'a> {
    Text(&'a str),
    /// From this offset on.
    Bytes(Cow<'a, [u8]>, usize),
}

impl Data<'_> {
    pub(super) fn values(&self, order: ByteOrder) -> Values<'_> {
        let tokens = |bytes, at| Tokens::part(FORMAT, " of a data array", bytes, at);
        match self {
            Data::Text(text) => Values::text(tokens(text.as_bytes(), 0)),
            Data::Bytes(bytes, at) => Values::binary(tokens(bytes, *at), order),
        }
    }
}

/// Where an array's bytes begin.
#[derive(Clone, Copy)]
enum Source<'s> {
    Base64(&'s [u8]),
    Raw(&'s [u8]),
}

fn cut() -> ReadError {
    ReadError::Truncated { format: FORMAT, detail: "a data array stops before its declared end".to_owned() }
}

/// Characters of base64 that hold `bytes` bytes, padding counted.
fn base64_length(bytes: usize) -> usize {
    bytes.div_ceil(3).saturating_mul(4)
}

impl<'s> Source<'s> {
    /// The next `length` bytes, which in base64 are padded on their own, and what follows them.
    fn split(self, length: usize) -> Result<(Cow<'s, [u8]>, Source<'s>), ReadError> {
        match self {
            Source::Raw(bytes) => {
                let (taken, rest) = bytes.split_at_checked(length).ok_or_else(cut)?;
                Ok((Cow::Borrowed(taken), Source::Raw(rest)))
            }
            Source::Base64(text) => {
                // Without padding the last characters may be missing.
                let (taken, rest) = text.split_at(base64_length(length).min(text.len()));
                if (length / 3).saturating_mul(4) > taken.len() {
                    return Err(cut());
                }
                let mut bytes = BASE64.decode(taken).map_err(|_| malformed("a data array is no base64"))?;
                if bytes.len() < length {
                    return Err(cut());
                }
                bytes.truncate(length);
                Ok((Cow::Owned(bytes), Source::Base64(rest)))
            }
        }
    }
}

impl Decoder<'_> {
    /// Unpacks an array, which holds `count` numbers when that is known.
    pub(super) fn decode<'s>(
        &'s self,
        array: &Array<'s>,
        count: Option<usize>,
    ) -> Result<Data<'s>, ReadError> {
        let inline;
        let source = match (array.coding, &self.appended) {
            (Coding::Ascii, _) => return Ok(Data::Text(array.text)),
            (Coding::Binary, _) => {
                inline = without_space(array.text.as_bytes());
                Source::Base64(&inline)
            }
            (Coding::Appended(offset), Some(Appended::Base64(text))) => {
                Source::Base64(text.get(offset..).ok_or_else(cut)?)
            }
            (Coding::Appended(offset), Some(Appended::Raw(bytes))) => {
                // Only these may be lent: what base64 holds has to be unpacked.
                if self.compression == Compression::None {
                    return self.lend(bytes.get(offset..).ok_or_else(cut)?, array, count);
                }
                Source::Raw(bytes.get(offset..).ok_or_else(cut)?)
            }
            (Coding::Appended(_), None) => return Err(malformed("it has no appended data")),
        };
        let (bytes, at) = match self.compression {
            Compression::None => self.plain(source)?,
            Compression::Zlib => (self.inflated(source)?, 0),
            Compression::Other(feature) => {
                let advice = "save it with zlib compression or with none";
                return Err(ReadError::UnsupportedFeature { format: FORMAT, feature, advice });
            }
        };
        check_length(bytes.len() - at, array, count)?;
        Ok(Data::Bytes(Cow::Owned(bytes), at))
    }

    /// Raw bytes behind their count, where they stand.
    fn lend<'s>(
        &self,
        bytes: &'s [u8],
        array: &Array<'_>,
        count: Option<usize>,
    ) -> Result<Data<'s>, ReadError> {
        let (word, rest) = bytes.split_at_checked(self.header.size()).ok_or_else(cut)?;
        let bytes = rest.get(..self.word(word)?).ok_or_else(cut)?;
        check_length(bytes.len(), array, count)?;
        Ok(Data::Bytes(Cow::Borrowed(bytes), 0))
    }

    /// Bytes behind their count; VTK encodes both in one go, others each on its own.
    fn plain(&self, source: Source<'_>) -> Result<(Vec<u8>, usize), ReadError> {
        let word = self.header.size();
        let (length, rest) = source.split(word)?;
        let length = self.word(&length)?;
        let Source::Base64(text) = source else { return Err(cut()) };
        let is_padded = text[..base64_length(word).min(text.len())].contains(&b'=');
        // A length that the text cannot hold is a lie, not a large mesh.
        if (length / 3).saturating_mul(4) > text.len() {
            return Err(cut());
        }
        self.unpack(length)?;
        if is_padded {
            return Ok((rest.split(length)?.0.into_owned(), 0));
        }
        Ok((source.split(length.saturating_add(word))?.0.into_owned(), word))
    }

    /// Blocks that are compressed one by one, behind their number and sizes.
    fn inflated(&self, source: Source<'_>) -> Result<Vec<u8>, ReadError> {
        let word = self.header.size();
        let blocks = self.word(&source.split(word)?.0)?;
        if blocks == 0 {
            return Ok(Vec::new());
        }
        let (header, rest) = source.split(blocks.saturating_add(3).saturating_mul(word))?;
        let words = header.chunks_exact(word).map(|bytes| self.word(bytes)).collect::<Result<Vec<_>, _>>()?;
        let [_, block, last, ref sizes @ ..] = words[..] else { return Err(cut()) };
        if block == 0 || last > block {
            return Err(malformed("the blocks of a compressed data array have impossible sizes"));
        }
        let last = if last == 0 { block } else { last };
        let total = (blocks - 1).checked_mul(block).and_then(|whole| whole.checked_add(last));
        let packed = sizes.iter().fold(0, |sum: usize, &size| sum.saturating_add(size));
        let (packed_bytes, _) = rest.split(packed)?;
        let total = total.filter(|&total| total / MOST_DEFLATED <= packed);
        let total = total
            .ok_or_else(|| malformed("a data array declares more than its compressed bytes can hold"))?;
        self.unpack(total)?;
        let mut parts = Vec::with_capacity(blocks);
        let mut left = &packed_bytes[..];
        for &size in sizes {
            let (part, rest) = left.split_at(size);
            parts.push(part);
            left = rest;
        }
        let mut out = vec![0; total];
        let blocks = out.par_chunks_mut(block).zip(parts);
        blocks
            .try_for_each_init(|| Decompress::new(true), |stream, (out, part)| inflate(stream, part, out))?;
        Ok(out)
    }

    fn word(&self, bytes: &[u8]) -> Result<usize, ReadError> {
        let count = self.header.integer(self.order, bytes);
        usize::try_from(count).map_err(|_| malformed("a data array has an impossible size"))
    }

    fn unpack(&self, bytes: usize) -> Result<(), ReadError> {
        self.unpacked.set(self.unpacked.get().saturating_add(bytes));
        check_limit(FORMAT, "decoded bytes", self.unpacked.get(), self.limit)
    }
}

fn check_length(bytes: usize, array: &Array<'_>, count: Option<usize>) -> Result<(), ReadError> {
    match count {
        Some(count) if Some(bytes) != count.checked_mul(array.scalar.size()) => {
            let found = bytes / array.scalar.size();
            Err(malformed(format!("a data array holds {found} numbers where {count} are declared")))
        }
        _ => Ok(()),
    }
}

/// Fills `out` exactly.
fn inflate(stream: &mut Decompress, part: &[u8], out: &mut [u8]) -> Result<(), ReadError> {
    stream.reset(true);
    let status = stream.decompress(part, out, FlushDecompress::Finish);
    if matches!(status, Ok(Status::StreamEnd)) && stream.total_out() == out.len() as u64 {
        Ok(())
    } else {
        Err(malformed("a compressed block does not unpack to its declared size"))
    }
}
