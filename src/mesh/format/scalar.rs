//! Numbers of the binary formats, of any type and byte order.

/// A number type in a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    I64,
    U64,
    F32,
    F64,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum ByteOrder {
    Little,
    Big,
}

/// The number of type `$type` that `$bytes` begins with; shorter input is a caller's error.
macro_rules! decode {
    ($type:ty, $order:expr, $bytes:expr) => {{
        let mut number = [0; size_of::<$type>()];
        number.copy_from_slice(&$bytes[..size_of::<$type>()]);
        match $order {
            ByteOrder::Little => <$type>::from_le_bytes(number),
            ByteOrder::Big => <$type>::from_be_bytes(number),
        }
    }};
}

impl Scalar {
    /// Bytes of one number.
    pub(super) fn size(self) -> usize {
        match self {
            Scalar::I8 | Scalar::U8 => 1,
            Scalar::I16 | Scalar::U16 => 2,
            Scalar::I32 | Scalar::U32 | Scalar::F32 => 4,
            Scalar::I64 | Scalar::U64 | Scalar::F64 => 8,
        }
    }

    pub(super) fn is_integer(self) -> bool {
        !matches!(self, Scalar::F32 | Scalar::F64)
    }

    /// The number that `bytes` begin with; `bytes` hold [`Self::size`] at least.
    #[inline]
    pub(super) fn real(self, order: ByteOrder, bytes: &[u8]) -> f64 {
        match self {
            Scalar::F32 => f64::from(decode!(f32, order, bytes)),
            Scalar::F64 => decode!(f64, order, bytes),
            Scalar::U64 => decode!(u64, order, bytes) as f64,
            _ => self.integer(order, bytes) as f64,
        }
    }

    /// The integer that `bytes` begin with; real numbers are cut, those too large for `i64` become
    /// its end, which no index reaches.
    #[inline]
    pub(super) fn integer(self, order: ByteOrder, bytes: &[u8]) -> i64 {
        match self {
            Scalar::I8 => i64::from(bytes[0] as i8),
            Scalar::U8 => i64::from(bytes[0]),
            Scalar::I16 => i64::from(decode!(i16, order, bytes)),
            Scalar::U16 => i64::from(decode!(u16, order, bytes)),
            Scalar::I32 => i64::from(decode!(i32, order, bytes)),
            Scalar::U32 => i64::from(decode!(u32, order, bytes)),
            Scalar::I64 => decode!(i64, order, bytes),
            Scalar::U64 => i64::try_from(decode!(u64, order, bytes)).unwrap_or(i64::MAX),
            Scalar::F32 => decode!(f32, order, bytes) as i64,
            Scalar::F64 => decode!(f64, order, bytes) as i64,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_come_out_in_both_byte_orders() {
        assert_eq!(Scalar::F32.real(ByteOrder::Big, &1.5f32.to_be_bytes()), 1.5);
        assert_eq!(Scalar::F64.real(ByteOrder::Little, &0.1f64.to_le_bytes()), 0.1);
        assert_eq!(Scalar::I16.integer(ByteOrder::Big, &(-2i16).to_be_bytes()), -2);
        assert_eq!(Scalar::U32.integer(ByteOrder::Little, &[0xff; 4]), i64::from(u32::MAX));
        assert_eq!(Scalar::U64.integer(ByteOrder::Little, &[0xff; 8]), i64::MAX);
        assert_eq!(Scalar::U64.real(ByteOrder::Little, &[0xff; 8]), u64::MAX as f64);
        assert_eq!(Scalar::I8.real(ByteOrder::Little, &[0xff]), -1.0);
    }
}
