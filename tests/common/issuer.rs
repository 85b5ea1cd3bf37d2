//! An issuer of tokens: its keys, and a server that gives the public ones.

use std::path::PathBuf;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{SystemTime, UNIX_EPOCH};

use axum::Router;
use axum::extract::State;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use base64::Engine;
use base64::engine::general_purpose::URL_SAFE_NO_PAD as BASE64;
use jsonwebtoken::jwk::Jwk;
use jsonwebtoken::{Algorithm, EncodingKey, Header, encode};
use rcgen::{KeyPair, PKCS_ED25519, PKCS_RSA_SHA256, SigningKey};
use serde_json::{Value, json};

use crate::service::Service;

pub const ISSUER: &str = "https://login.example/realms/ward";
pub const AUDIENCE: &str = "rosaline";

/// A key of an issuer.
pub struct Signer {
    pub id: &'static str,
    pub algorithm: Algorithm,
    pub pair: KeyPair,
}

impl Signer {
    pub fn new(id: &'static str, algorithm: Algorithm) -> Self {
        let pair = match algorithm {
            Algorithm::EdDSA => KeyPair::generate_for(&PKCS_ED25519),
            Algorithm::ES256 => KeyPair::generate(),
            _ => KeyPair::generate_rsa_for(&PKCS_RSA_SHA256, rcgen::RsaKeySize::_2048),
        };
        Self { id, algorithm, pair: pair.unwrap() }
    }

    pub fn secret(&self) -> EncodingKey {
        let der = self.pair.serialize_der();
        match self.algorithm {
            Algorithm::ES256 => EncodingKey::from_ec_der(&der),
            // The PKCS #1 key in a PKCS #8 one of 2048 bits, behind 26 bytes that say so (RFC 5958).
            _ => EncodingKey::from_rsa_der(&der[26..]),
        }
    }

    pub fn public(&self) -> Value {
        if self.algorithm == Algorithm::EdDSA {
            let point = BASE64.encode(self.pair.public_key_raw());
            return json!({"kty": "OKP", "crv": "Ed25519", "kid": self.id, "x": point});
        }
        let mut key = Jwk::from_encoding_key(&self.secret(), self.algorithm).unwrap();
        key.common.key_id = Some(self.id.to_owned());
        serde_json::to_value(key).unwrap()
    }

    pub fn header(&self) -> Header {
        Header { kid: Some(self.id.to_owned()), ..Header::new(self.algorithm) }
    }

    pub fn sign(&self, claims: &Value) -> String {
        if self.algorithm != Algorithm::EdDSA {
            return encode(&self.header(), claims, &self.secret()).unwrap();
        }
        let message = forged(&json!({"alg": "EdDSA", "kid": self.id}), claims, "");
        let message = message.trim_end_matches('.');
        format!("{message}.{}", BASE64.encode(self.pair.sign(message.as_bytes()).unwrap()))
    }
}

pub fn set(signers: &[&Signer]) -> String {
    json!({"keys": signers.iter().map(|signer| signer.public()).collect::<Vec<_>>()}).to_string()
}

/// Seconds from now, as claims have them.
pub fn at(seconds: i64) -> i64 {
    i64::try_from(SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_secs()).unwrap() + seconds
}

pub fn claims(subject: &str, scope: &str) -> Value {
    json!({"iss": ISSUER, "sub": subject, "aud": AUDIENCE, "exp": at(600), "nbf": at(-10), "scope": scope})
}

/// The same with some claims changed; null takes one away.
pub fn but(changes: Value) -> Value {
    let mut claims = claims("anna", "submit read");
    for (name, value) in changes.as_object().unwrap() {
        claims[name] = value.clone();
    }
    claims.as_object_mut().unwrap().retain(|_, value| !value.is_null());
    claims
}

pub fn arguments(keys: &str) -> [&str; 6] {
    ["--jwt-issuer", ISSUER, "--jwt-audience", AUDIENCE, "--jwks", keys]
}

/// A folder with a key set in it.
pub struct KeyFile(tempfile::TempDir);

impl KeyFile {
    pub fn new(text: &str) -> Self {
        let file = Self(tempfile::tempdir().unwrap());
        file.put(text);
        file
    }

    pub fn path(&self) -> PathBuf {
        self.0.path().join("jwks.json")
    }

    pub fn put(&self, text: &str) {
        std::fs::write(self.0.path().join("new"), text).unwrap();
        std::fs::rename(self.0.path().join("new"), self.path()).unwrap();
    }

    pub fn start(&self, more: &[&str]) -> Service {
        let path = self.path();
        Service::start(&[&arguments(path.to_str().unwrap()), more].concat())
    }
}

/// What an issuer answers when it is asked for its keys.
#[derive(Clone)]
pub struct Keys {
    answer: Arc<Mutex<(StatusCode, String)>>,
    asked: Arc<AtomicUsize>,
}

impl Keys {
    pub fn new(text: String) -> Self {
        Self { answer: Arc::new(Mutex::new((StatusCode::OK, text))), asked: Arc::default() }
    }

    pub fn put(&self, status: StatusCode, text: String) {
        *self.answer.lock().unwrap() = (status, text);
    }

    pub fn asked(&self) -> usize {
        self.asked.load(Ordering::SeqCst)
    }

    /// Serves on `listener` as long as the test lasts; the keys' URL.
    pub fn serve(&self, listener: tokio::net::TcpListener) -> String {
        let url = format!("http://{}/keys", listener.local_addr().unwrap());
        let router = Router::new().route("/keys", get(answer)).route("/elsewhere", get(answer));
        let router = router.with_state(self.clone());
        tokio::spawn(async move { axum::serve(listener, router).await });
        url
    }
}

async fn answer(State(keys): State<Keys>) -> Response {
    keys.asked.fetch_add(1, Ordering::SeqCst);
    let (status, text) = keys.answer.lock().unwrap().clone();
    (status, [(header::LOCATION, "/elsewhere")], text).into_response()
}

/// A token made by hand.
pub fn forged(header: &Value, claims: &Value, signature: &str) -> String {
    let part = |value: &Value| BASE64.encode(value.to_string());
    format!("{}.{}.{signature}", part(header), part(claims))
}
