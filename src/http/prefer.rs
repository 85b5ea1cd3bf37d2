//! The preference `wait` (RFC 7240, section 4.3).

use std::time::Duration;

use axum::http::{HeaderMap, HeaderName, HeaderValue};

pub const PREFER: HeaderName = HeaderName::from_static("prefer");
pub const PREFERENCE_APPLIED: HeaderName = HeaderName::from_static("preference-applied");

/// How long the client prefers to wait, in whole seconds and never more than `longest`.
///
/// The first `wait` counts (RFC 7240, section 2); one that is not a number is ignored, as the RFC asks.
pub fn wait(headers: &HeaderMap, longest: Duration) -> Option<Duration> {
    let preferences = headers.get_all(PREFER).iter().filter_map(|value| value.to_str().ok());
    let first = preferences.flat_map(|list| list.split(',')).find_map(|preference| {
        let (name, value) = preference.split(';').next()?.split_once('=')?;
        name.trim().eq_ignore_ascii_case("wait").then(|| value.trim().trim_matches('"').to_owned())
    })?;
    if first.is_empty() || !first.bytes().all(|byte| byte.is_ascii_digit()) {
        return None;
    }
    let seconds = first.parse().unwrap_or(u64::MAX);
    Some(Duration::from_secs(seconds.min(longest.as_secs())))
}

/// The value of `Preference-Applied` for a wait.
pub fn applied(wait: Duration) -> HeaderValue {
    HeaderValue::try_from(format!("wait={}", wait.as_secs())).unwrap_or(HeaderValue::from_static("wait"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seconds(prefer: &str) -> Option<u64> {
        let headers = HeaderMap::from_iter([(PREFER, prefer.parse().unwrap())]);
        wait(&headers, Duration::from_secs(60)).map(|wait| wait.as_secs())
    }

    #[test]
    fn waits_are_read_and_bounded() {
        assert_eq!(seconds("wait=10"), Some(10));
        assert_eq!(seconds("respond-async, WAIT = \"5\"; foo=bar"), Some(5));
        assert_eq!(seconds("wait=3, wait=9"), Some(3));
        assert_eq!(seconds("wait=100000"), Some(60));
        assert_eq!(seconds("wait=99999999999999999999999999"), Some(60));
        assert_eq!(seconds("wait=0"), Some(0));
    }

    #[test]
    fn other_preferences_and_nonsense_are_ignored() {
        for prefer in ["return=minimal", "wait", "wait=", "wait=soon", "wait=-1", "wait=1.5", "await=3"] {
            assert_eq!(seconds(prefer), None, "{prefer}");
        }
        assert_eq!(wait(&HeaderMap::new(), Duration::from_secs(60)), None);
    }

    #[test]
    fn the_answer_names_what_was_applied() {
        assert_eq!(applied(Duration::from_secs(7)), "wait=7");
    }
}
