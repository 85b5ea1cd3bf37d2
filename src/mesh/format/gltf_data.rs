//! The numbers of a glTF file: buffers, their views, and accessors with sparse replacements.

use std::borrow::Cow;
use std::collections::BTreeMap;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use gltf::json::accessor::{Accessor, ComponentType, Type};
use gltf::json::validation::Checked;
use gltf::json::{Buffer, Root};

use super::gltf::malformed;
use super::scalar::{ByteOrder, Scalar};
use super::surface::check_limit;
use super::{Format, Limits, ReadError};

/// The model and its buffers' bytes.
pub(super) struct Buffers<'a> {
    format: Format,
    root: &'a Root,
    bytes: Vec<Cow<'a, [u8]>>,
}

impl<'a> Buffers<'a> {
    /// Decodes `data:` URIs; `bin` is what a GLB carries for its first buffer.
    ///
    /// # Errors
    /// `UnsupportedFeature` for any other URI: nothing outside the file is ever read.
    pub(super) fn new(
        format: Format,
        root: &'a Root,
        mut bin: Option<Cow<'a, [u8]>>,
        limits: &Limits,
    ) -> Result<Self, ReadError> {
        let mut bytes = Vec::with_capacity(root.buffers.len());
        let mut decoded = 0usize;
        for (index, buffer) in root.buffers.iter().enumerate() {
            let data = match &buffer.uri {
                Some(uri) => {
                    decoded = decoded.saturating_add(uri.len() / 4 * 3);
                    check_limit(format, "decoded bytes", decoded, limits.decoded_bytes)?;
                    Cow::Owned(decode_uri(format, index, uri)?)
                }
                None if index == 0 => bin.take().unwrap_or_default(),
                None => Cow::default(),
            };
            check_length(format, index, buffer, &data)?;
            bytes.push(data);
        }
        Ok(Buffers { format, root, bytes })
    }

    fn malformed(&self, accessor: usize, what: &str) -> ReadError {
        malformed(self.format, format!("accessor {accessor} {what}"))
    }

    /// The positions that an accessor holds.
    pub(super) fn positions(&self, accessor: usize) -> Result<Numbers<'_>, ReadError> {
        let numbers = self.numbers(accessor, Type::Vec3)?;
        if numbers.scalar == Scalar::U32 {
            return Err(self.malformed(accessor, "has positions of a type that glTF forbids"));
        }
        Ok(numbers)
    }

    /// The vertex indices that an accessor holds.
    pub(super) fn indices(&self, accessor: usize) -> Result<Numbers<'_>, ReadError> {
        let numbers = self.numbers(accessor, Type::Scalar)?;
        if !matches!(numbers.scalar, Scalar::U8 | Scalar::U16 | Scalar::U32) {
            return Err(self.malformed(accessor, "has indices of a type that glTF forbids"));
        }
        Ok(numbers)
    }

    fn numbers(&self, index: usize, shape: Type) -> Result<Numbers<'_>, ReadError> {
        let accessor = self.root.accessors.get(index).ok_or_else(|| self.malformed(index, "is not there"))?;
        let (Checked::Valid(component), Checked::Valid(found)) = (accessor.component_type, accessor.type_)
        else {
            return Err(self.malformed(index, "has an unknown type"));
        };
        if found != shape {
            return Err(self.malformed(index, "has the wrong number of components"));
        }
        let scalar = scalar(component.0);
        let size = scalar.size() * shape.multiplicity();
        let count = usize::try_from(accessor.count.0).map_err(|_| self.malformed(index, "is too long"))?;
        let offset = accessor.byte_offset.unwrap_or_default().0;
        let (bytes, stride) = match accessor.buffer_view {
            Some(view) => self.strided(index, view.value(), offset, count, size)?,
            // All zero but for the sparse entries. A tiny file shall not declare millions of them.
            None if count <= self.bytes.iter().map(|bytes| bytes.len()).sum() => (&[][..], size),
            None => return Err(self.malformed(index, "has no buffer for its elements")),
        };
        let replaced = self.sparse(index, accessor, count, size)?;
        let scale = if accessor.normalized { 1.0 / largest(scalar) } else { 1.0 };
        Ok(Numbers { scalar, scale, bytes, stride, count, replaced })
    }

    /// The bytes of `count` elements of `size` bytes in a view, and the distance between two.
    fn strided(
        &self,
        accessor: usize,
        view: usize,
        offset: u64,
        count: usize,
        size: usize,
    ) -> Result<(&[u8], usize), ReadError> {
        let outside = || self.malformed(accessor, "reaches beyond its buffer");
        let view = self.root.buffer_views.get(view).ok_or_else(outside)?;
        let buffer = self.bytes.get(view.buffer.value()).ok_or_else(outside)?;
        let start = view.byte_offset.unwrap_or_default().0;
        let range = |start: u64, length: u64| -> Option<std::ops::Range<usize>> {
            Some(usize::try_from(start).ok()?..usize::try_from(start.checked_add(length)?).ok()?)
        };
        let bytes =
            range(start, view.byte_length.0).and_then(|range| buffer.get(range)).ok_or_else(outside)?;
        let bytes =
            usize::try_from(offset).ok().and_then(|offset| bytes.get(offset..)).ok_or_else(outside)?;
        let stride = view.byte_stride.map_or(size, |stride| stride.0);
        if stride < size {
            return Err(self.malformed(accessor, "has elements that overlap"));
        }
        let length = count.checked_sub(1).map_or(Some(0), |last| last.checked_mul(stride)?.checked_add(size));
        match length {
            Some(length) if length <= bytes.len() => Ok((&bytes[..length], stride)),
            _ => Err(outside()),
        }
    }

    /// Where the elements that a sparse accessor replaces have their bytes.
    fn sparse(
        &self,
        index: usize,
        accessor: &Accessor,
        count: usize,
        size: usize,
    ) -> Result<BTreeMap<usize, &[u8]>, ReadError> {
        let Some(sparse) = &accessor.sparse else { return Ok(BTreeMap::new()) };
        let Checked::Valid(component) = sparse.indices.component_type else {
            return Err(self.malformed(index, "has an unknown type"));
        };
        let place = scalar(component.0);
        let entries = usize::try_from(sparse.count.0).ok().filter(|&entries| entries <= count);
        let entries = entries.ok_or_else(|| self.malformed(index, "replaces more elements than it has"))?;
        let (places, step) = self.strided(
            index,
            sparse.indices.buffer_view.value(),
            sparse.indices.byte_offset.0,
            entries,
            place.size(),
        )?;
        let values = &sparse.values;
        let (values, stride) =
            self.strided(index, values.buffer_view.value(), values.byte_offset.0, entries, size)?;
        let mut replaced = BTreeMap::new();
        for entry in 0..entries {
            let element = place.integer(ByteOrder::Little, &places[entry * step..]);
            let element = usize::try_from(element).ok().filter(|&element| element < count);
            let element =
                element.ok_or_else(|| self.malformed(index, "replaces an element that it has not"))?;
            replaced.insert(element, &values[entry * stride..][..size]);
        }
        Ok(replaced)
    }
}

fn check_length(format: Format, index: usize, buffer: &Buffer, data: &[u8]) -> Result<(), ReadError> {
    if (data.len() as u64) < buffer.byte_length.0 {
        let detail = format!("buffer {index} declares {} bytes and has {}", buffer.byte_length.0, data.len());
        return Err(ReadError::Truncated { format, detail });
    }
    Ok(())
}

fn decode_uri(format: Format, index: usize, uri: &str) -> Result<Vec<u8>, ReadError> {
    let external = ReadError::UnsupportedFeature {
        format,
        feature: "a buffer in another file",
        advice: "send a GLB, or a glTF whose buffers are data: URIs",
    };
    let Some(data) = uri.strip_prefix("data:") else { return Err(external) };
    let encoded = data.split_once(";base64,").map(|(_, encoded)| encoded);
    let bytes = encoded.and_then(|encoded| STANDARD.decode(encoded).ok());
    bytes.ok_or_else(|| malformed(format, format!("the data: URI of buffer {index} is no base64")))
}

fn scalar(component: ComponentType) -> Scalar {
    match component {
        ComponentType::I8 => Scalar::I8,
        ComponentType::U8 => Scalar::U8,
        ComponentType::I16 => Scalar::I16,
        ComponentType::U16 => Scalar::U16,
        ComponentType::U32 => Scalar::U32,
        ComponentType::F32 => Scalar::F32,
    }
}

/// What a normalised integer of value 1 is (section 3.11).
fn largest(scalar: Scalar) -> f64 {
    match scalar {
        Scalar::I8 => 127.0,
        Scalar::U8 => 255.0,
        Scalar::I16 => 32767.0,
        Scalar::U16 => 65535.0,
        _ => 1.0,
    }
}

/// The element of an accessor without a buffer: three components at most.
const ZERO: [u8; 12] = [0; 12];

/// The elements of an accessor, checked to be there.
pub(super) struct Numbers<'a> {
    scalar: Scalar,
    /// To normalise integers.
    scale: f64,
    bytes: &'a [u8],
    stride: usize,
    count: usize,
    replaced: BTreeMap<usize, &'a [u8]>,
}

impl Numbers<'_> {
    pub(super) fn len(&self) -> usize {
        self.count
    }

    /// The bytes of an element below [`Self::len`], and perhaps more.
    fn element(&self, index: usize) -> &[u8] {
        match self.replaced.get(&index) {
            Some(bytes) => bytes,
            None if self.bytes.is_empty() => &ZERO,
            None => &self.bytes[index * self.stride..],
        }
    }

    /// An element of three components.
    pub(super) fn point(&self, index: usize) -> [f64; 3] {
        let bytes = self.element(index);
        let size = self.scalar.size();
        [0, 1, 2].map(|axis| {
            let number = self.scalar.real(ByteOrder::Little, &bytes[axis * size..]) * self.scale;
            // Two integers stand for -1 (section 3.11).
            if self.scale == 1.0 { number } else { number.max(-1.0) }
        })
    }

    /// An element of one integer.
    pub(super) fn index(&self, index: usize) -> i64 {
        self.scalar.integer(ByteOrder::Little, self.element(index))
    }
}
