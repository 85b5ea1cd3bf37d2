//! Who a request's key or token is of, where one is needed.

use std::sync::Arc;

use tokio_util::sync::CancellationToken;

use super::jwt::TokenError;
use super::keys::PREFIX;
use super::ring::Refusal;
use super::{Caller, Issuer, JwksError, KeyError, KeyRing};

/// The keys in force, and the issuer whose tokens are accepted.
pub struct Gate {
    keys: KeyRing,
    issuer: Option<Issuer>,
}

/// Why it is not known who asks.
#[derive(Debug, thiserror::Error)]
pub(super) enum Unknown {
    #[error("a key or a token is needed")]
    Nobody,
    /// The same for a wrong key and a revoked one.
    #[error("the key is not valid")]
    Key,
    /// Of a key; whether it is valid is not known.
    #[error("the service cannot read its keys now, so it is not known whether this one is valid")]
    Unreadable,
    #[error(transparent)]
    Token(#[from] TokenError),
}

impl Unknown {
    /// Whether that is the service's own fault, so that the key or token may be a valid one.
    pub(super) fn is_open(&self) -> bool {
        matches!(self, Self::Unreadable | Self::Token(TokenError::Unreadable))
    }
}

/// Why it cannot be known who asks.
#[derive(Debug, thiserror::Error)]
pub enum GateError {
    #[error(transparent)]
    Keys(#[from] KeyError),
    #[error(transparent)]
    Issuer(#[from] JwksError),
}

/// Whether tokens can be checked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in super::super) enum IssuerKeys {
    /// They can, or none are accepted.
    Fine,
    /// They cannot, and whoever has a key of the service's own is let in.
    AbsentBesideKeys,
    /// They cannot, and nobody is let in.
    Absent,
}

impl Gate {
    pub fn new(keys: KeyRing, issuer: Option<Issuer>) -> Self {
        Self { keys, issuer }
    }

    /// Whether a key or a token is needed.
    pub fn is_closed(&self) -> bool {
        self.issuer.is_some() || self.keys.is_closed()
    }

    /// Whether the keys, and those of the issuer where they are in a file, can be read. Blocks.
    ///
    /// # Errors
    /// [`GateError`] where they cannot.
    pub(in super::super) fn check(&self) -> Result<(), GateError> {
        self.keys.check()?;
        Ok(self.issuer.as_ref().map_or(Ok(()), Issuer::check)?)
    }

    /// What of the issuer's keys is known where they are fetched.
    pub(in super::super) fn issuer_keys(&self) -> IssuerKeys {
        match &self.issuer {
            Some(issuer) if !issuer.has_keys() && self.keys.has_keys() => IssuerKeys::AbsentBesideKeys,
            Some(issuer) if !issuer.has_keys() => IssuerKeys::Absent,
            _ => IssuerKeys::Fine,
        }
    }

    /// Keeps the issuer's keys fresh until `closing`.
    pub(in super::super) fn follow(&self, closing: CancellationToken) {
        if let Some(issuer) = &self.issuer {
            issuer.follow(closing);
        }
    }

    /// Whom a request with this token comes from.
    pub(super) async fn caller(&self, token: Option<&str>) -> Result<Caller, Unknown> {
        match (&self.issuer, token) {
            (Some(issuer), Some(token)) if !token.starts_with(PREFIX) => {
                Ok(Caller::Principal(Arc::new(issuer.principal(token).await?)))
            }
            (issuer, token) => match self.keys.caller(token) {
                // Anyone, as long as there is no key, but only where no token could be asked for instead.
                Ok(caller) if issuer.is_none() || matches!(caller, Caller::Principal(_)) => Ok(caller),
                Err(Refusal::Unreadable) => Err(Unknown::Unreadable),
                _ => Err(if token.is_some() { Unknown::Key } else { Unknown::Nobody }),
            },
        }
    }
}
