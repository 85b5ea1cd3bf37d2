//! TLS by rustls: one certificate with its key, taken over again when their files change.

mod expiry;

use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, PoisonError, RwLock};
use std::time::{Duration, Instant};

use tokio_rustls::TlsAcceptor;
use tokio_rustls::rustls::crypto::aws_lc_rs;
use tokio_rustls::rustls::pki_types::pem::{self, PemObject};
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer};
use tokio_rustls::rustls::{self, ServerConfig};
use tokio_util::sync::CancellationToken;

use crate::jobs::operator_file::{self, Stamp, stamp};

pub use expiry::Expiry;

/// How often the files are looked at.
const LOOK: Duration = Duration::from_secs(1);
/// How often a certificate that is about to expire is warned of.
const REMIND: Duration = Duration::from_secs(24 * 60 * 60);

/// Why a certificate with its key cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum TlsError {
    #[error("{path} cannot be read: {source}")]
    Io { path: String, source: io::Error },
    #[error("{path} holds no {what} in PEM form: {detail}")]
    Pem { path: String, what: &'static str, detail: pem::Error },
    #[error(
        "{cert} and {key} cannot be used together: {source}; give a certificate, its chain after it, and its key"
    )]
    Pair { cert: String, key: String, source: rustls::Error },
}

/// The certificate and the key that connections are encrypted with.
pub struct Tls {
    cert: PathBuf,
    key: PathBuf,
    config: RwLock<(Arc<ServerConfig>, Option<Expiry>)>,
    /// Of the files as they were when the service started.
    first: [Stamp; 2],
}

impl Tls {
    /// # Errors
    /// [`TlsError`] when a file cannot be read, or the two are no pair.
    pub fn open(cert: impl Into<PathBuf>, key: impl Into<PathBuf>) -> Result<Self, TlsError> {
        let (cert, key) = (cert.into(), key.into());
        let first = [stamp(&cert), stamp(&key)];
        let config = RwLock::new(load(&cert, &key)?);
        Ok(Self { cert, key, config, first })
    }

    /// For the next connection.
    pub(super) fn acceptor(&self) -> TlsAcceptor {
        TlsAcceptor::from(self.config.read().unwrap_or_else(PoisonError::into_inner).0.clone())
    }

    /// When the certificate in force, or one of its chain, expires; `None` where that cannot be read.
    pub fn expiry(&self) -> Option<Expiry> {
        self.config.read().unwrap_or_else(PoisonError::into_inner).1
    }

    /// Takes changed files over until `closing`. A pair that cannot be used leaves the one before in force.
    ///
    /// A change counts once it has stood still from one look to the next: the two files are not replaced in the
    /// same moment.
    pub(super) async fn follow(self: Arc<Self>, closing: CancellationToken) {
        let (mut taken, mut seen) = (self.first, self.first);
        let mut reminded: Option<(Instant, Option<Expiry>)> = None;
        loop {
            let expiry = self.expiry();
            if reminded.is_none_or(|(at, of)| of != expiry || at.elapsed() >= REMIND) {
                reminded = Some((Instant::now(), expiry));
                if let Some(warning) = expiry.and_then(|expiry| expiry.warning()) {
                    tracing::warn!("{warning}");
                }
            }
            tokio::select! {
                () = tokio::time::sleep(LOOK) => {}
                () = closing.cancelled() => return,
            }
            let (tls, before) = (self.clone(), seen);
            let looked = tokio::task::spawn_blocking(move || {
                let now = [stamp(&tls.cert), stamp(&tls.key)];
                if now == before && now != taken {
                    tls.renew();
                    return (now, now);
                }
                (taken, now)
            });
            // Fails only when the runtime ends.
            let Ok(found) = looked.await else { return };
            (taken, seen) = found;
        }
    }

    fn renew(&self) {
        match load(&self.cert, &self.key) {
            Ok(config) => {
                *self.config.write().unwrap_or_else(PoisonError::into_inner) = config;
                tracing::info!("the TLS certificate has changed; new connections get the new one");
            }
            Err(error) => tracing::error!(%error, "the TLS certificate stays the one before"),
        }
    }
}

fn load(cert: &Path, key: &Path) -> Result<(Arc<ServerConfig>, Option<Expiry>), TlsError> {
    let chain = CertificateDer::pem_slice_iter(&read(cert)?).collect::<Result<Vec<_>, _>>();
    let chain =
        chain.and_then(|chain| if chain.is_empty() { Err(pem::Error::NoItemsFound) } else { Ok(chain) });
    let chain = chain.map_err(|detail| TlsError::Pem { path: name(cert), what: "certificate", detail })?;
    let expiry = chain.iter().filter_map(|one| Expiry::of(one)).min();
    let secret = PrivateKeyDer::from_pem_slice(&read(key)?).map_err(|detail| TlsError::Pem {
        path: name(key),
        what: "private key",
        detail,
    })?;
    let config = ServerConfig::builder_with_provider(Arc::new(aws_lc_rs::default_provider()))
        .with_safe_default_protocol_versions()
        .and_then(|builder| builder.with_no_client_auth().with_single_cert(chain, secret));
    let mut config = config.map_err(|source| TlsError::Pair { cert: name(cert), key: name(key), source })?;
    config.alpn_protocols = vec![b"http/1.1".to_vec()];
    Ok((Arc::new(config), expiry))
}

fn read(path: &Path) -> Result<Vec<u8>, TlsError> {
    operator_file::read(path).map_err(|source| TlsError::Io { path: name(path), source })
}

fn name(path: &Path) -> String {
    path.display().to_string()
}
