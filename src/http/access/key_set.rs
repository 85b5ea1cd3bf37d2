//! What a key set holds (RFC 7517): keys that tokens may be checked with, others, and what is no key at all.

use jsonwebtoken::jwk::{AlgorithmParameters, Jwk, PublicKeyUse};
use jsonwebtoken::{Algorithm, DecodingKey};
use serde::Deserialize;
use serde_json::Value;

use super::discovery::shown;
use super::jwks::JwksError;

/// One key of the set.
pub(super) struct PublicKey {
    pub id: Option<String>,
    /// The only algorithm that it is for, where the set says so.
    pub algorithm: Option<Algorithm>,
    pub key: DecodingKey,
}

/// Why an entry of the set is no key. It repeats nothing of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
enum NoKey {
    #[error("is no JSON object")]
    NoObject,
    #[error("has no key type 'kty'")]
    NoType,
    #[error("lacks '{0}', which keys of its type have")]
    Lacks(&'static str),
    #[error("has a member of another kind than keys have")]
    Member,
    #[error("is not written in base64url")]
    Base64,
}

/// The keys that signatures may be checked with. Others in the set are left out: shared secrets, keys for encryption,
/// types that are not known; and what is no key, as long as there is one that is.
///
/// # Errors
/// [`JwksError::Empty`] where the set has no keys or others alone; [`JwksError::Damaged`] where it is none, or has no key
/// to use and something that is no key: that may have been one.
pub(super) fn parse(text: &[u8]) -> Result<Vec<PublicKey>, JwksError> {
    #[derive(Deserialize)]
    struct Set {
        keys: Vec<Value>,
    }
    // Its error repeats a string that is in a wrong place whole.
    let set: Set =
        serde_json::from_slice(text).map_err(|error| JwksError::Damaged(shown(&error.to_string())))?;
    let (mut keys, mut damaged) = (Vec::new(), None);
    for (place, value) in set.keys.into_iter().enumerate() {
        match public(value) {
            Ok(key) => keys.extend(key),
            Err(error) => {
                damaged.get_or_insert((place + 1, error));
            }
        }
    }
    match damaged {
        _ if !keys.is_empty() => Ok(keys),
        Some((place, error)) => {
            Err(JwksError::Damaged(format!("it has no key to use, and entry {place} of its list {error}")))
        }
        None => Err(JwksError::Empty),
    }
}

/// The key, if it is one for signatures that is known here.
fn public(value: Value) -> Result<Option<PublicKey>, NoKey> {
    whole(&value)?;
    let jwk: Jwk = serde_json::from_value(value).map_err(|_| NoKey::Member)?;
    if !matches!(jwk.common.public_key_use, None | Some(PublicKeyUse::Signature)) {
        return Ok(None);
    }
    let algorithm = match jwk.common.key_algorithm.map(Algorithm::try_from) {
        None => None,
        Some(Ok(algorithm)) => Some(algorithm),
        Some(Err(_)) => return Ok(None),
    };
    // Of a type, or on a curve, that is not known.
    if matches!(jwk.algorithm, AlgorithmParameters::Other(_)) {
        return Ok(None);
    }
    let key = DecodingKey::from_jwk(&jwk).map_err(|_| NoKey::Base64)?;
    let is_public = super::jwt::ALGORITHMS.iter().any(|algorithm| algorithm.family() == key.family());
    Ok(is_public.then_some(PublicKey { id: jwk.common.key_id, algorithm, key }))
}

/// Whether an entry has what every key of its type has (RFC 7518, section 6; RFC 8037, section 2).
fn whole(value: &Value) -> Result<(), NoKey> {
    let entry = value.as_object().ok_or(NoKey::NoObject)?;
    let text = |member| entry.get(member).and_then(Value::as_str).filter(|text| !text.is_empty());
    let members: &[&'static str] = match text("kty").ok_or(NoKey::NoType)? {
        "RSA" => &["n", "e"],
        "EC" => &["crv", "x", "y"],
        "OKP" => &["crv", "x"],
        "oct" => &["k"],
        _ => &[],
    };
    let lacking = members.iter().find(|member| text(member).is_none());
    lacking.map_or(Ok(()), |member| Err(NoKey::Lacks(member)))
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn parsed(keys: Value) -> Result<usize, JwksError> {
        parse(json!({ "keys": keys }).to_string().as_bytes()).map(|keys| keys.len())
    }

    #[test]
    fn an_error_repeats_little_of_a_key_set() {
        let long = "x".repeat(super::super::fetching::MOST / 2);
        for set in [json!(long), json!({"keys": long})] {
            let said = parse(set.to_string().as_bytes()).err().unwrap().to_string();
            assert!(said.contains("xxx") && said.len() < 1000, "{} bytes", said.len());
        }
        let said = parsed(json!([{"kty": "RSA", "n": "secret"}])).unwrap_err().to_string();
        assert!(said.contains("entry 1") && said.contains("'e'") && !said.contains("secret"), "{said}");
    }

    #[test]
    fn keys_of_other_kinds_are_none_and_what_is_no_key_is_damage() {
        let others = [
            json!({"kty": "RSA", "n": "AQAB", "e": "AQAB", "use": "enc"}),
            json!({"kty": "RSA", "n": "AQAB", "e": "AQAB", "alg": "RSA-OAEP"}),
            json!({"kty": "EC", "crv": "P-256", "x": "AA", "y": "AA", "alg": "unheard"}),
            json!({"kty": "EC", "crv": "secp256k1", "x": "AA", "y": "AA"}),
            json!({"kty": "OKP", "crv": "X25519", "x": "AA"}),
            json!({"kty": "oct", "k": "AA"}),
            json!({"kty": "AKP", "pub": "AA"}),
        ];
        assert!(matches!(parsed(json!([])), Err(JwksError::Empty)));
        assert!(matches!(parsed(json!(others)), Err(JwksError::Empty)));
        let good = json!({"kty": "RSA", "n": "AQAB", "e": "AQAB"});
        let damaged = [
            (json!(null), "no JSON object"),
            (json!("AQAB"), "no JSON object"),
            (json!([]), "no JSON object"),
            (json!({}), "'kty'"),
            (json!({"kty": 1}), "'kty'"),
            (json!({"kty": "RSA", "e": "AQAB"}), "'n'"),
            (json!({"kty": "RSA", "n": "AQAB"}), "'e'"),
            (json!({"kty": "RSA", "n": 17, "e": "AQAB", "use": "enc"}), "'n'"),
            (json!({"kty": "RSA", "n": "#", "e": "AQAB"}), "base64url"),
            (json!({"kty": "RSA", "n": "AQAB", "e": "AQAB", "kid": 1}), "of another kind"),
            (json!({"kty": "EC", "x": "AA", "y": "AA"}), "'crv'"),
            (json!({"kty": "EC", "crv": "P-256", "y": "AA"}), "'x'"),
            (json!({"kty": "EC", "crv": "P-256", "x": "AA", "y": ""}), "'y'"),
            (json!({"kty": "OKP", "crv": "Ed25519"}), "'x'"),
        ];
        for (entry, what) in damaged {
            let said = parsed(json!([entry, others[0]])).unwrap_err();
            assert!(
                matches!(said, JwksError::Damaged(_)) && said.to_string().contains(what),
                "{entry}: {said}"
            );
            let beside = parsed(json!([others[0], entry, good]));
            assert!(matches!(beside, Ok(1)), "{entry}: one that can be used is enough");
        }
    }
}
