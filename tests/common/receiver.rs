//! A server that takes webhooks, and fails when it is told to.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use axum::Router;
use axum::extract::{Request, State};
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use base64::Engine;
use base64::engine::general_purpose::STANDARD as BASE64;
use hmac::{Hmac, KeyInit, Mac};
use serde_json::Value;
use sha2::Sha256;

use crate::service::PATIENCE;

/// What a receiver does with a message.
#[derive(Clone, Copy)]
pub enum Answer {
    Status(u16),
    /// Answers 200 after this many milliseconds.
    Slow(u64),
}

/// A message that came.
#[derive(Clone)]
pub struct Message {
    pub path: String,
    headers: HeaderMap,
    pub body: String,
}

impl Message {
    pub fn header(&self, name: &str) -> &str {
        self.headers[name].to_str().unwrap()
    }

    pub fn id(&self) -> &str {
        self.header("webhook-id")
    }

    pub fn json(&self) -> Value {
        serde_json::from_str(&self.body).unwrap()
    }

    /// Checks the signature as Standard Webhooks says it is made.
    pub fn assert_signed(&self, secret: &str) {
        assert_eq!(self.signed_by(&[secret]), [true], "{}", self.header("webhook-signature"));
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_secs();
        assert!(now.abs_diff(self.header("webhook-timestamp").parse().unwrap()) < 300);
    }

    /// Whether one of the signatures is by each of these secrets.
    pub fn signed_by(&self, secrets: &[&str]) -> Vec<bool> {
        let signatures = || self.header("webhook-signature").split(' ');
        secrets.iter().map(|secret| signatures().any(|signature| self.verifies(secret, signature))).collect()
    }

    fn verifies(&self, secret: &str, signature: &str) -> bool {
        let key = BASE64.decode(secret.strip_prefix("whsec_").unwrap()).unwrap();
        let mut mac = Hmac::<Sha256>::new_from_slice(&key).unwrap();
        mac.update(format!("{}.{}.{}", self.id(), self.header("webhook-timestamp"), self.body).as_bytes());
        mac.verify_slice(&BASE64.decode(signature.strip_prefix("v1,").unwrap()).unwrap()).is_ok()
    }
}

/// A server that takes webhooks, and answers 200 when nothing else is planned.
#[derive(Clone, Default)]
pub struct Receiver {
    came: Arc<Mutex<Vec<Message>>>,
    pub plan: Arc<Mutex<VecDeque<Answer>>>,
    address: String,
}

impl Receiver {
    pub async fn start(plan: &[Answer]) -> Self {
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap().to_string();
        let receiver = Self { address, ..Self::default() };
        receiver.plan.lock().unwrap().extend(plan);
        let router = Router::new().fallback(receive).with_state(receiver.clone());
        tokio::spawn(async move { axum::serve(listener, router).await });
        receiver
    }

    pub fn url(&self) -> String {
        format!("http://{}/hook?token=a", self.address)
    }

    pub fn came(&self) -> Vec<Message> {
        self.came.lock().unwrap().clone()
    }

    /// What came once it is this many messages.
    pub async fn messages(&self, count: usize) -> Vec<Message> {
        let begin = Instant::now();
        while self.came().len() < count {
            assert!(begin.elapsed() < PATIENCE, "{} of {count} messages came", self.came().len());
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
        self.came()
    }
}

async fn receive(State(receiver): State<Receiver>, request: Request) -> Response {
    let (parts, body) = request.into_parts();
    let body = axum::body::to_bytes(body, 1 << 20).await.unwrap();
    let message = Message {
        path: parts.uri.to_string(),
        headers: parts.headers,
        body: String::from_utf8(body.to_vec()).unwrap(),
    };
    receiver.came.lock().unwrap().push(message);
    let answer = receiver.plan.lock().unwrap().pop_front();
    match answer {
        None => StatusCode::OK.into_response(),
        Some(Answer::Status(status)) => {
            (StatusCode::from_u16(status).unwrap(), [(header::LOCATION, "/elsewhere")]).into_response()
        }
        Some(Answer::Slow(millis)) => {
            tokio::time::sleep(Duration::from_millis(millis)).await;
            StatusCode::OK.into_response()
        }
    }
}
