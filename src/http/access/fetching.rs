//! A key set that is fetched: from a URL of the operator's, or from where the issuer says.

use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use bytes::Bytes;

use super::JwksError;
use super::discovery::Discovery;
use crate::outbound::{Client, OutboundError, Url};

/// Bytes of a key set.
pub(super) const MOST: usize = 1 << 20;
/// How long a fetch may take.
pub(super) const PATIENCE: Duration = Duration::from_secs(5);

/// How to the keys that are not in a file.
pub(super) enum Way {
    At(Client),
    By {
        discovery: Box<Discovery>,
        /// For where the keys were last: to make one reads all of the system's CA certificates.
        last: Mutex<Option<(Url, Client)>>,
    },
}

impl Way {
    pub(super) fn to(url: Url) -> Result<Self, JwksError> {
        Ok(Self::At(Client::new(url, PATIENCE)?))
    }

    /// Nothing is asked yet.
    pub(super) fn by(issuer: &str) -> Result<Self, JwksError> {
        Ok(Self::By { discovery: Box::new(Discovery::of(issuer, PATIENCE)?), last: Mutex::default() })
    }

    /// The set as it is now.
    pub(super) async fn text(&self) -> Result<Bytes, JwksError> {
        let client = match self {
            Way::At(client) => client.clone(),
            // Asked each time, as they may have moved.
            Way::By { discovery, last } => client_for(discovery.keys().await?, last)?,
        };
        Ok(client.get(MOST).await?)
    }
}

fn client_for(url: Url, last: &Mutex<Option<(Url, Client)>>) -> Result<Client, OutboundError> {
    let mut last = last.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some((known, client)) = &*last
        && *known == url
    {
        return Ok(client.clone());
    }
    let client = Client::new(url.clone(), PATIENCE)?;
    *last = Some((url, client.clone()));
    Ok(client)
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;
    use std::net::SocketAddr;
    use std::sync::Arc;

    use axum::Router;
    use axum::extract::ConnectInfo;
    use axum::routing::get;
    use tokio::net::TcpListener;

    use super::*;

    /// As one client keeps its connection, and each new one makes another.
    #[tokio::test]
    async fn one_client_fetches_the_keys_of_an_issuer_as_long_as_they_stay_where_they_are() {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let name = format!("http://{}", listener.local_addr().unwrap());
        let configuration = format!("{{\"issuer\": \"{name}\", \"jwks_uri\": \"{name}/keys\"}}");
        let peers = Arc::new(Mutex::new(HashSet::new()));
        let seen = peers.clone();
        let keys = async move |ConnectInfo(peer): ConnectInfo<SocketAddr>| {
            seen.lock().unwrap().insert(peer);
            "{}"
        };
        let router = Router::new()
            .route("/.well-known/openid-configuration", get(async move || configuration))
            .route("/keys", get(keys))
            .into_make_service_with_connect_info::<SocketAddr>();
        tokio::spawn(async move { axum::serve(listener, router).await });
        let way = Way::by(&name).unwrap();
        for _ in 0..3 {
            assert_eq!(way.text().await.unwrap(), "{}");
        }
        assert_eq!(peers.lock().unwrap().len(), 1);
    }
}
