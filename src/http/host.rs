//! The field `Host` (RFC 9112, section 3.2), without which an HTTP/1.1 request is none.

use axum::extract::Request;
use axum::http::uri::Authority;
use axum::http::{HeaderMap, HeaderValue, Version, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use super::problem::{MALFORMED_REQUEST, Problem};

/// Answers a request whose `Host` is missing, there twice or no host with a 400.
pub async fn check(request: Request, next: Next) -> Response {
    match fault(request.version(), request.headers()) {
        None => next.run(request).await,
        Some(found) => {
            let detail = format!("{found}; send one Host field with the host and port of the URL");
            Problem::new(&MALFORMED_REQUEST, detail).into_response()
        }
    }
}

fn fault(version: Version, headers: &HeaderMap) -> Option<&'static str> {
    let mut hosts = headers.get_all(header::HOST).iter();
    match (hosts.next(), hosts.next()) {
        (None, _) if version == Version::HTTP_11 => Some("the request has no Host field"),
        (Some(_), Some(_)) => Some("the request has more than one Host field"),
        (Some(host), None) if !is_host(host) => Some("the Host field of the request is no host"),
        _ => None,
    }
}

/// Whether it is a host with or without a port. It is empty where the URL has none.
fn is_host(value: &HeaderValue) -> bool {
    let Ok(text) = value.to_str() else { return false };
    text.is_empty() || (!text.contains('@') && text.parse::<Authority>().is_ok())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(version: Version, hosts: &[&str]) -> bool {
        let mut headers = HeaderMap::new();
        for host in hosts {
            headers.append(header::HOST, host.parse().unwrap());
        }
        fault(version, &headers).is_none()
    }

    #[test]
    fn one_host_is_needed_from_1_1_on() {
        for host in ["rosaline.example", "127.0.0.1:8080", "[::1]:80", "localhost", ""] {
            assert!(of(Version::HTTP_11, &[host]) && of(Version::HTTP_10, &[host]), "{host}");
        }
        assert!(!of(Version::HTTP_11, &[]) && of(Version::HTTP_10, &[]));
        for hosts in [&["a", "a"][..], &["a b"], &["a/b"], &["user@a"], &["a:b:c"]] {
            assert!(!of(Version::HTTP_11, hosts) && !of(Version::HTTP_10, hosts), "{hosts:?}");
        }
    }
}
