//! The HTTP client behind every outbound request.

use std::time::Duration;

use bytes::{Bytes, BytesMut};
use reqwest::redirect;
use serde::{Deserialize, Serialize};

use super::names::Names;

/// Why nothing came back.
#[derive(Debug, thiserror::Error)]
pub enum OutboundError {
    #[error("no HTTP client can be made: {0}; are the system's CA certificates installed (ca-certificates)?")]
    Client(String),
    #[error("'{0}' is no http or https URL")]
    Url(String),
    #[error("no answer: {0}")]
    Unreachable(String),
    #[error("it answered {0}")]
    Status(u16),
    #[error("its answer has more than {0} bytes")]
    TooLarge(usize),
}

/// A client for one URL that follows no redirect and gives up in time. TLS trusts the system's CA certificates, or those
/// of `SSL_CERT_FILE`; a proxy is the one of `HTTPS_PROXY` and its like.
#[derive(Debug, Clone)]
pub struct Client {
    url: Url,
    http: reqwest::Client,
}

impl Client {
    /// `limit` bounds a request from its connection to the end of its answer.
    ///
    /// # Errors
    /// [`OutboundError::Client`] where TLS is needed and cannot be set up.
    pub fn new(url: Url, limit: Duration) -> Result<Self, OutboundError> {
        let mut builder = reqwest::Client::builder();
        if url.0.scheme() == "http" {
            // Then a system without CA certificates will do.
            builder = builder.tls_certs_only([]);
        }
        let client = builder
            .timeout(limit)
            .dns_resolver(Names)
            .redirect(redirect::Policy::none())
            .referer(false)
            .user_agent(concat!("rosaline/", env!("CARGO_PKG_VERSION")))
            .build();
        let http = client.map_err(|error| OutboundError::Client(causes(error)))?;
        Ok(Self { url, http })
    }

    /// The body of a 200, of at most `most` bytes.
    ///
    /// # Errors
    /// [`OutboundError`] also for every other status.
    pub async fn get(&self, most: usize) -> Result<Bytes, OutboundError> {
        let mut answer = self.http.get(self.url.0.clone()).send().await.map_err(unreachable)?;
        if answer.status() != reqwest::StatusCode::OK {
            return Err(OutboundError::Status(answer.status().as_u16()));
        }
        let mut body = BytesMut::new();
        while let Some(chunk) = answer.chunk().await.map_err(unreachable)? {
            if body.len() + chunk.len() > most {
                return Err(OutboundError::TooLarge(most));
            }
            body.extend_from_slice(&chunk);
        }
        Ok(body.freeze())
    }

    /// What is answered to this body; the answer's own body is not read.
    ///
    /// # Errors
    /// [`OutboundError::Unreachable`] where no answer begins in time.
    pub async fn post(
        &self,
        headers: &[(&'static str, String)],
        body: String,
    ) -> Result<Answer, OutboundError> {
        let request = self.http.post(self.url.0.clone()).body(body);
        let request = headers.iter().fold(request, |request, (name, value)| request.header(*name, value));
        let answer = request.send().await.map_err(unreachable)?;
        let retry_after = answer.headers().get(reqwest::header::RETRY_AFTER);
        let seconds = retry_after.and_then(|value| value.to_str().ok()?.trim().parse().ok());
        Ok(Answer { status: answer.status().as_u16(), retry_after: seconds.map(Duration::from_secs) })
    }
}

/// What a target answered.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Answer {
    pub status: u16,
    /// `Retry-After`, where it is in seconds.
    pub retry_after: Option<Duration>,
}

/// An `http` or `https` URL.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Url(reqwest::Url);

impl Url {
    /// Whether what is sent there is encrypted.
    pub fn is_https(&self) -> bool {
        self.0.scheme() == "https"
    }

    /// Whether what is sent there crosses a network in the clear.
    pub fn is_in_the_clear(&self) -> bool {
        let host = self.0.host_str().unwrap_or_default().trim_matches(['[', ']']);
        let is_local = host == "localhost" || host.parse().is_ok_and(|ip: std::net::IpAddr| ip.is_loopback());
        self.0.scheme() == "http" && !is_local
    }
}

impl std::str::FromStr for Url {
    type Err = OutboundError;

    fn from_str(text: &str) -> Result<Self, OutboundError> {
        let url = reqwest::Url::parse(text).ok().filter(|url| matches!(url.scheme(), "http" | "https"));
        url.map(Self).ok_or_else(|| OutboundError::Url(text.to_owned()))
    }
}

impl TryFrom<String> for Url {
    type Error = OutboundError;

    fn try_from(text: String) -> Result<Self, OutboundError> {
        text.parse()
    }
}

impl From<Url> for String {
    fn from(url: Url) -> Self {
        url.to_string()
    }
}

impl std::fmt::Display for Url {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.0.fmt(f)
    }
}

/// Without the URL, which may hold a secret of the operator's.
fn unreachable(error: reqwest::Error) -> OutboundError {
    OutboundError::Unreachable(causes(error.without_url()))
}

/// An error with what is behind it: reqwest's own text names no cause.
fn causes(error: reqwest::Error) -> String {
    let mut text = error.to_string();
    let mut source = std::error::Error::source(&error);
    while let Some(cause) = source {
        text = format!("{text}: {cause}");
        source = cause.source();
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn urls_are_http_or_https_and_some_are_in_the_clear() {
        let clear = |text: &str| text.parse::<Url>().unwrap().is_in_the_clear();
        assert!(clear("http://10.0.0.7/hook") && clear("http://pacs.example/"));
        for text in
            ["https://pacs.example/", "http://127.0.0.1:1/", "http://[::1]/", "http://localhost:8080/x"]
        {
            assert!(!clear(text), "{text}");
        }
        for text in ["", "pacs.example", "ftp://pacs.example/", "file:///etc/passwd", "http://"] {
            assert!(text.parse::<Url>().is_err(), "{text}");
        }
    }
}
