//! Signed tokens (JWT, RFC 7519) of the one issuer that the operator trusts, as OpenID Connect providers give them.

use std::sync::Arc;
use std::time::Instant;

use jsonwebtoken::errors::{Error, ErrorKind};
use jsonwebtoken::{Algorithm, Validation, decode, decode_header};
use serde::Deserialize;
use tokio_util::sync::CancellationToken;

use super::jwks::{Jwks, NoKeys};
use super::{JwksError, JwksSource, Principal, Scope};

/// Signatures by a key of which the service knows the public half alone (RFC 7518, section 3.1, and RFC 8037): neither
/// none nor a shared secret.
pub(super) const ALGORITHMS: [Algorithm; 9] = [
    Algorithm::RS256,
    Algorithm::RS384,
    Algorithm::RS512,
    Algorithm::PS256,
    Algorithm::PS384,
    Algorithm::PS512,
    Algorithm::ES256,
    Algorithm::ES384,
    Algorithm::EdDSA,
];
/// Bytes of a token.
const MOST: usize = 16 << 10;
/// How far the issuer's clock may be from this one, seconds.
const LEEWAY: u64 = 30;
/// Characters of a subject (OpenID Connect Core, section 2).
const SUBJECT_CHARS: usize = 255;
/// What may stand before a scope's name, for issuers whose scopes are shared by many services.
const SCOPE_PREFIX: &str = "rosaline:";

/// Why a token is not accepted; told to whoever sent it.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub(super) enum TokenError {
    #[error("the token is no signed JWT")]
    Malformed,
    #[error("the token is signed in a way that is not accepted; RS, PS, ES and EdDSA are")]
    Algorithm,
    #[error("the token names no key of the issuer")]
    UnknownKey,
    /// Whether it is valid is not known.
    #[error("the service has no keys of the issuer now, so it is not known whether this token is valid")]
    Unreadable,
    #[error("the signature of the token is not by the issuer's key")]
    Signature,
    #[error("the token has expired")]
    Expired,
    #[error("the token is not valid yet")]
    NotYet,
    #[error("the token is of another issuer")]
    Issuer,
    #[error("the token is for another audience")]
    Audience,
    #[error("the token lacks a claim, or has one that cannot be read: exp, iss, aud and sub are needed")]
    Claims,
}

impl From<Error> for TokenError {
    fn from(error: Error) -> Self {
        match error.kind() {
            ErrorKind::ExpiredSignature => TokenError::Expired,
            ErrorKind::ImmatureSignature => TokenError::NotYet,
            ErrorKind::InvalidIssuer => TokenError::Issuer,
            ErrorKind::InvalidAudience => TokenError::Audience,
            ErrorKind::InvalidAlgorithm => TokenError::Algorithm,
            ErrorKind::MissingRequiredClaim(_) | ErrorKind::InvalidClaimFormat(_) | ErrorKind::Json(_) => {
                TokenError::Claims
            }
            _ => TokenError::Signature,
        }
    }
}

/// The claims that are read here; jsonwebtoken checks those of time and audience.
#[derive(Deserialize)]
struct Claims {
    iss: String,
    sub: String,
    /// One text with spaces (RFC 8693, section 4.2).
    #[serde(default)]
    scope: Option<Words>,
    /// The same where other issuers have it.
    #[serde(default)]
    scp: Option<Words>,
}

#[derive(Deserialize)]
#[serde(untagged)]
enum Words {
    Text(String),
    List(Vec<String>),
}

impl Words {
    fn each(&self) -> Vec<&str> {
        match self {
            Words::Text(text) => text.split_whitespace().collect(),
            Words::List(list) => list.iter().map(String::as_str).collect(),
        }
    }
}

/// Whose tokens are accepted, and for what.
pub struct Issuer {
    /// As `iss` has it.
    name: String,
    validation: Validation,
    keys: Arc<Jwks>,
}

impl Issuer {
    /// Without `keys` the issuer is asked where they are.
    ///
    /// # Errors
    /// [`JwksError`] when the keys cannot be read from their file, or the issuer cannot be asked.
    pub fn open(name: &str, audience: &str, keys: Option<JwksSource>) -> Result<Self, JwksError> {
        let mut validation = Validation::new(ALGORITHMS[0]);
        validation.set_issuer(&[name]);
        validation.set_audience(&[audience]);
        validation.set_required_spec_claims(&["exp", "iss", "aud", "sub"]);
        validation.validate_nbf = true;
        validation.leeway = LEEWAY;
        Ok(Self { name: name.to_owned(), validation, keys: Arc::new(Jwks::open(keys, name)?) })
    }

    /// Whether the keys can be read where they are in a file. Blocks.
    ///
    /// # Errors
    /// [`JwksError`] where they cannot.
    pub(super) fn check(&self) -> Result<(), JwksError> {
        self.keys.check()
    }

    /// Whether there are keys that tokens can be checked with now.
    pub(super) fn has_keys(&self) -> bool {
        self.keys.has_keys(Instant::now())
    }

    /// Keeps the keys fresh until `closing`.
    pub(in super::super) fn follow(&self, closing: CancellationToken) {
        let keys = self.keys.clone();
        tokio::spawn(async move { keys.follow(closing).await });
    }

    /// Whom a token is of.
    pub(super) async fn principal(&self, token: &str) -> Result<Principal, TokenError> {
        if token.len() > MOST || token.split('.').count() != 3 {
            return Err(TokenError::Malformed);
        }
        let header = decode_header(token).map_err(|error| match error.kind() {
            // Also where the algorithm has no name in the crate: "none" among them.
            ErrorKind::Json(_) => TokenError::Algorithm,
            _ => TokenError::Malformed,
        })?;
        // Extensions that must be understood (RFC 7515, section 4.1.11) are not.
        if !ALGORITHMS.contains(&header.alg) || header.crit.is_some() {
            return Err(TokenError::Algorithm);
        }
        let found = self.keys.find(header.kid.as_deref(), header.alg).await;
        let key = found.map_err(|NoKeys| TokenError::Unreadable)?.ok_or(TokenError::UnknownKey)?;
        let validation = Validation { algorithms: vec![header.alg], ..self.validation.clone() };
        self.accept(decode::<Claims>(token, &key, &validation)?.claims)
    }

    fn accept(&self, claims: Claims) -> Result<Principal, TokenError> {
        let is_sound = |subject: &str| {
            (1..=SUBJECT_CHARS).contains(&subject.chars().count()) && !subject.contains(char::is_control)
        };
        if claims.iss != self.name || !is_sound(&claims.sub) {
            return Err(TokenError::Claims);
        }
        let words = [&claims.scope, &claims.scp].into_iter().flatten().flat_map(Words::each);
        let scopes = words.filter_map(|word| word.strip_prefix(SCOPE_PREFIX).unwrap_or(word).parse().ok());
        let mut scopes: Vec<Scope> = scopes.collect();
        scopes.dedup();
        // No key's name has a '#', and no issuer's may (OpenID Connect Core, section 2): the names of keys, and those of
        // two issuers, are apart.
        Ok(Principal { name: format!("{}#{}", self.name, claims.sub), scopes })
    }
}
