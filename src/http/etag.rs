//! Strong entity tags and the conditions on them (RFC 9110, sections 8.8.3 and 13.1).

use std::fmt;

use axum::http::{HeaderMap, HeaderValue, header};

/// A strong entity tag: the SHA-256 of the body.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ETag(String);

impl ETag {
    /// `digest` is lower-case hexadecimal.
    pub fn of_digest(digest: &str) -> Self {
        Self(format!("\"{digest}\""))
    }

    /// The header's value; `None` when the digest is not plain ASCII.
    pub fn header(&self) -> Option<HeaderValue> {
        HeaderValue::from_str(&self.0).ok()
    }

    /// Whether `If-None-Match` names this tag (by weak comparison) or any.
    pub fn is_known_to(&self, headers: &HeaderMap) -> bool {
        let mut lists = headers.get_all(header::IF_NONE_MATCH).iter().filter_map(|value| value.to_str().ok());
        lists
            .any(|list| is_any(list) || tags(list).any(|tag| tag.strip_prefix("W/").unwrap_or(tag) == self.0))
    }

    /// Whether `If-Match` allows the request: there is none, or it names this tag (by strong comparison) or any.
    pub fn allows(&self, headers: &HeaderMap) -> bool {
        let mut lists = headers.get_all(header::IF_MATCH).iter().peekable();
        lists.peek().is_none()
            || lists
                .filter_map(|list| list.to_str().ok())
                .any(|list| is_any(list) || tags(list).any(|tag| tag == self.0))
    }

    /// Whether a `Range` applies: there is no `If-Range`, or it names this tag (by strong comparison).
    ///
    /// Results carry no `Last-Modified`, so a date never matches.
    pub fn allows_range(&self, headers: &HeaderMap) -> bool {
        headers.get(header::IF_RANGE).is_none_or(|value| value.as_bytes() == self.0.as_bytes())
    }
}

/// Whether a list is the one star that stands for every tag.
fn is_any(list: &str) -> bool {
    list.trim() == "*"
}

/// The members of a list; a comma between quotes belongs to its tag.
fn tags(list: &str) -> impl Iterator<Item = &str> {
    let mut is_quoted = false;
    let ends = move |c: char| {
        is_quoted ^= c == '"';
        c == ',' && !is_quoted
    };
    list.split(ends).map(str::trim)
}

impl fmt::Display for ETag {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn headers(name: header::HeaderName, value: &str) -> HeaderMap {
        HeaderMap::from_iter([(name, value.parse().unwrap())])
    }

    #[test]
    fn if_none_match_compares_weakly() {
        let tag = ETag::of_digest("abc");
        assert!(!tag.is_known_to(&HeaderMap::new()));
        for value in ["\"abc\"", "W/\"abc\"", "\"x\", \"abc\"", "\"x,y\",\"abc\"", " * "] {
            assert!(tag.is_known_to(&headers(header::IF_NONE_MATCH, value)), "{value}");
        }
        for value in ["abc", "\"abcd\"", "\"ABC\"", "\"a,*,b\"", "\"x\", *", "\"x,\"abc\"\""] {
            assert!(!tag.is_known_to(&headers(header::IF_NONE_MATCH, value)), "{value}");
        }
    }

    #[test]
    fn if_match_compares_strongly() {
        let tag = ETag::of_digest("abc");
        assert!(tag.allows(&HeaderMap::new()));
        for value in ["\"abc\"", "\"x\", \"abc\"", "*"] {
            assert!(tag.allows(&headers(header::IF_MATCH, value)), "{value}");
        }
        for value in ["W/\"abc\"", "\"x\"", "abc", "", "\"a,*,b\"", "*, \"x\""] {
            assert!(!tag.allows(&headers(header::IF_MATCH, value)), "{value}");
        }
    }

    #[test]
    fn if_range_compares_strongly() {
        let tag = ETag::of_digest("abc");
        assert!(tag.allows_range(&HeaderMap::new()));
        assert!(tag.allows_range(&headers(header::IF_RANGE, "\"abc\"")));
        for value in ["W/\"abc\"", "\"x\"", "Sun, 06 Nov 1994 08:49:37 GMT"] {
            assert!(!tag.allows_range(&headers(header::IF_RANGE, value)), "{value}");
        }
    }
}
