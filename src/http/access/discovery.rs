//! Where an issuer's keys are, as its own configuration says (OpenID Connect Discovery 1.0, section 4).

use std::time::Duration;

use serde::Deserialize;

use crate::outbound::{Client, OutboundError, Url};

/// Bytes of a configuration.
const MOST: usize = 1 << 20;
/// Behind the issuer, without the slash that it may end with.
const WELL_KNOWN: &str = "/.well-known/openid-configuration";
/// Characters of another's text that an error repeats.
const SHOWN: usize = 200;

/// Why it is not known where the keys are.
#[derive(Debug, thiserror::Error)]
pub enum DiscoveryError {
    #[error(
        "where the keys of '{0}' are cannot be found by its name, which is no https URL (on this machine: http) without \
         user, query and fragment; say it with --jwks"
    )]
    Name(String),
    #[error(
        "{url} cannot be fetched: {source}; see whether --jwt-issuer is the issuer's address, or name its keys with --jwks"
    )]
    Fetch { url: Url, source: OutboundError },
    #[error("{url} is no configuration: {detail}; it is a JSON object with 'issuer' and 'jwks_uri'")]
    Damaged { url: Url, detail: String },
    #[error(
        "{url} is the configuration of another issuer, {found:?}; --jwt-issuer must be as it is there, also in its last slash"
    )]
    Issuer { url: Url, found: String },
    #[error(
        "{url} names {found:?} for the keys, which is no https URL; have it name one, or name one with --jwks"
    )]
    Keys { url: Url, found: String },
}

/// An issuer that is asked where its keys are.
pub struct Discovery {
    issuer: String,
    url: Url,
    client: Client,
}

/// What is read of a configuration (OpenID Connect Discovery 1.0, section 3).
#[derive(Deserialize)]
struct Configuration {
    issuer: String,
    jwks_uri: String,
}

impl Discovery {
    /// `patience` bounds each request. Nothing is asked yet.
    ///
    /// # Errors
    /// [`DiscoveryError::Name`] where the issuer's name is no address to ask.
    pub fn of(issuer: &str, patience: Duration) -> Result<Self, DiscoveryError> {
        let wrong = || DiscoveryError::Name(issuer.to_owned());
        let text = format!("{}{WELL_KNOWN}", issuer.strip_suffix('/').unwrap_or(issuer));
        let url: Url = text.parse().map_err(|_| wrong())?;
        if issuer.contains(['?', '#', '@']) || url.is_in_the_clear() {
            return Err(wrong());
        }
        let client = Client::new(url.clone(), patience)
            .map_err(|source| DiscoveryError::Fetch { url: url.clone(), source })?;
        Ok(Self { issuer: issuer.to_owned(), url, client })
    }

    /// Where the keys are now.
    ///
    /// # Errors
    /// [`DiscoveryError`] where the configuration does not come, is of another issuer, or names no fit address.
    pub async fn keys(&self) -> Result<Url, DiscoveryError> {
        let text = self.client.get(MOST).await;
        let text = text.map_err(|source| DiscoveryError::Fetch { url: self.url.clone(), source })?;
        self.named(&text)
    }

    /// Where the keys are by this configuration.
    fn named(&self, text: &[u8]) -> Result<Url, DiscoveryError> {
        let url = || self.url.clone();
        // Its error repeats a string that is in a wrong place whole.
        let found: Configuration = serde_json::from_slice(text)
            .map_err(|error| DiscoveryError::Damaged { url: url(), detail: shown(&error.to_string()) })?;
        if found.issuer != self.issuer {
            return Err(DiscoveryError::Issuer { url: url(), found: shown(&found.issuer) });
        }
        // Without TLS only where the issuer itself is asked without it, on this machine.
        let fits = |keys: &Url| keys.is_https() || !self.url.is_https() && !keys.is_in_the_clear();
        let keys = found.jwks_uri.parse().ok().filter(fits);
        keys.ok_or_else(|| DiscoveryError::Keys { url: url(), found: shown(&found.jwks_uri) })
    }
}

/// As much of another's text as an error repeats.
pub(super) fn shown(text: &str) -> String {
    text.chars().take(SHOWN).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_configuration_is_behind_the_issuers_path() {
        let url = |issuer| Discovery::of(issuer, Duration::from_secs(1)).map(|found| found.url.to_string());
        for (issuer, expected) in [
            ("http://127.0.0.1:7", "http://127.0.0.1:7/.well-known/openid-configuration"),
            ("http://localhost/", "http://localhost/.well-known/openid-configuration"),
            ("http://[::1]/realms/ward/", "http://[::1]/realms/ward/.well-known/openid-configuration"),
        ] {
            assert_eq!(url(issuer).unwrap(), expected);
        }
        for issuer in [
            "",
            "ward",
            "http://login.example",
            "ftp://login.example",
            "https://login.example/?tenant=1",
            "https://login.example/#x",
            "https://user@login.example/",
        ] {
            assert!(matches!(url(issuer), Err(DiscoveryError::Name(_))), "{issuer}");
        }
    }

    #[test]
    fn an_error_repeats_little_of_a_configuration() {
        let discovery = Discovery::of("http://127.0.0.1:7", Duration::from_secs(1)).unwrap();
        let long = "x".repeat(MOST / 2);
        for configuration in [
            serde_json::json!(long),
            serde_json::json!({"issuer": long, "jwks_uri": ""}),
            serde_json::json!({"issuer": "http://127.0.0.1:7", "jwks_uri": long}),
        ] {
            let said = discovery.named(configuration.to_string().as_bytes()).unwrap_err().to_string();
            assert!(said.contains("xxx") && said.len() < 1000, "{} bytes", said.len());
        }
    }
}
