//! `Content-Digest` (RFC 9530): a body that was changed on its way is refused.

use axum::http::{HeaderMap, HeaderName};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;

use super::problem::{DIGEST_MISMATCH, MALFORMED_REQUEST, Problem};

pub const CONTENT_DIGEST: HeaderName = HeaderName::from_static("content-digest");

/// The SHA-256 that the client says its body has, in lower-case hex; other algorithms are passed over, as the
/// RFC allows.
///
/// # Errors
/// 400 when the header's SHA-256 is none.
pub fn sha256(headers: &HeaderMap) -> Result<Option<String>, Problem> {
    let lists = headers.get_all(&CONTENT_DIGEST).iter().filter_map(|value| value.to_str().ok());
    let mut members =
        lists.flat_map(|list| list.split(',')).filter_map(|member| member.trim().split_once('='));
    // Of one name the last counts, and parameters may follow a value (RFC 8941, sections 4.2.2 and 3.1.2).
    let Some((_, value)) = members.rfind(|(name, _)| *name == "sha-256") else { return Ok(None) };
    let value = value.split(';').next().unwrap_or_default().trim_end();
    let text = value.strip_prefix(':').and_then(|value| value.strip_suffix(':'));
    match text.and_then(|text| STANDARD.decode(text).ok()) {
        Some(bytes) if bytes.len() == 32 => {
            Ok(Some(bytes.iter().map(|byte| format!("{byte:02x}")).collect()))
        }
        _ => Err(Problem::new(&MALFORMED_REQUEST, "Content-Digest is written as sha-256=:BASE64:")),
    }
}

/// # Errors
/// 400 when `found` is not what the client sent.
pub fn check(expected: Option<&str>, found: &str) -> Result<(), Problem> {
    match expected {
        Some(expected) if expected != found => {
            let detail = "the body has not the SHA-256 of its Content-Digest; send the mesh again";
            Err(Problem::new(&DIGEST_MISMATCH, detail))
        }
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(value: &str) -> Result<Option<String>, Problem> {
        sha256(&HeaderMap::from_iter([(CONTENT_DIGEST, value.parse().unwrap())]))
    }

    #[test]
    fn digests_are_read() {
        // Of the empty body.
        let (base64, hex) = (
            "47DEQpj8HBSa+/TImW+5JCeuQeRkm5NMpJWZG3hSuFU=",
            "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855",
        );
        assert_eq!(read(&format!("sha-256=:{base64}:")).unwrap().as_deref(), Some(hex));
        assert_eq!(read(&format!("sha-512=:AAAA:, sha-256=:{base64}:")).unwrap().as_deref(), Some(hex));
        assert_eq!(read(&format!("sha-256=:{base64}:;a=1")).unwrap().as_deref(), Some(hex));
        assert_eq!(read(&format!("sha-256=:AAAA:, sha-256=:{base64}:")).unwrap().as_deref(), Some(hex));
        assert!(read(&format!("sha-256=:{base64}:, sha-256=:AAAA:")).is_err());
        assert_eq!(read("sha-512=:AAAA:").unwrap(), None);
        assert_eq!(sha256(&HeaderMap::new()).unwrap(), None);
        for value in ["sha-256=:AAAA:".to_owned(), format!("sha-256={base64}"), "sha-256=::".to_owned()] {
            assert!(read(&value).is_err(), "{value}");
        }
    }
}
