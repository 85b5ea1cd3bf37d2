//! Byte ranges of a result (RFC 9110, section 14).

use std::ops::Range;

/// What a `Range` header asks of a body of known length.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Asked {
    /// The whole body: no range, one in another unit, a malformed one, or several (which a server may answer whole).
    Whole,
    /// These bytes, never empty.
    Part(Range<u64>),
    /// A range that the body does not reach.
    Unsatisfiable,
}

/// Reads `Range` against a body of `length` bytes.
pub fn asked(header: &str, length: u64) -> Asked {
    let Some((unit, set)) = header.split_once('=') else { return Asked::Whole };
    let set = set.trim();
    if !unit.trim().eq_ignore_ascii_case("bytes") || set.contains(',') {
        return Asked::Whole;
    }
    let Some((first, last)) = set.split_once('-') else { return Asked::Whole };
    let part = match (number(first), number(last)) {
        (Some(first), Some(last)) if first <= last => first..last.saturating_add(1).min(length),
        (Some(first), None) if last.is_empty() => first..length,
        (None, Some(suffix)) if first.is_empty() => length.saturating_sub(suffix)..length,
        _ => return Asked::Whole,
    };
    if part.start < part.end { Asked::Part(part) } else { Asked::Unsatisfiable }
}

/// Digits only: no sign, no spaces. Numbers past `u64` stand for "to the end".
fn number(text: &str) -> Option<u64> {
    if text.is_empty() || !text.bytes().all(|byte| byte.is_ascii_digit()) {
        return None;
    }
    Some(text.parse().unwrap_or(u64::MAX))
}

/// The value of `Content-Range` for a part.
pub fn content_range(part: &Range<u64>, length: u64) -> String {
    format!("bytes {}-{}/{length}", part.start, part.end.saturating_sub(1))
}

/// The value of `Content-Range` for an unsatisfiable range.
pub fn content_range_unsatisfied(length: u64) -> String {
    format!("bytes */{length}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts() {
        assert_eq!(asked("bytes=0-9", 100), Asked::Part(0..10));
        assert_eq!(asked("bytes=90-", 100), Asked::Part(90..100));
        assert_eq!(asked("bytes=-10", 100), Asked::Part(90..100));
        assert_eq!(asked("bytes=-1000", 100), Asked::Part(0..100));
        assert_eq!(asked("bytes=50-1000", 100), Asked::Part(50..100));
        assert_eq!(asked("Bytes=0-0", 100), Asked::Part(0..1));
        assert_eq!(asked("bytes=0-99999999999999999999999", 100), Asked::Part(0..100));
        assert_eq!(asked("bytes=0-18446744073709551615", 100), Asked::Part(0..100));
    }

    #[test]
    fn out_of_reach() {
        assert_eq!(asked("bytes=100-", 100), Asked::Unsatisfiable);
        assert_eq!(asked("bytes=100-200", 100), Asked::Unsatisfiable);
        assert_eq!(asked("bytes=-0", 100), Asked::Unsatisfiable);
        assert_eq!(asked("bytes=0-", 0), Asked::Unsatisfiable);
    }

    #[test]
    fn ignored() {
        for header in [
            "bytes=9-3",
            "lines=0-3",
            "bytes",
            "bytes=",
            "bytes=-",
            "bytes=a-b",
            "bytes=0-1,4-5",
            "bytes=+1-2",
        ] {
            assert_eq!(asked(header, 100), Asked::Whole, "{header}");
        }
    }

    #[test]
    fn headers() {
        assert_eq!(content_range(&(0..10), 100), "bytes 0-9/100");
        assert_eq!(content_range_unsatisfied(100), "bytes */100");
    }
}
