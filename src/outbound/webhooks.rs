//! Webhooks: tells the operator's targets of the ends of jobs, by the rules of Standard Webhooks
//! (<https://www.standardwebhooks.com>, specification 1.0).
//!
//! What is to be told is in the outbox ([`crate::jobs::Outbox`]), which survives the process. Each target has senders of
//! its own, so that one that is slow holds up no other. A delivery is under the lease of one sender; it may be sent again
//! after a crash, with the same id.

mod payload;
mod schedule;
mod signature;
mod targets;

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::Semaphore;
use tokio::task::JoinSet;
use tokio_util::sync::CancellationToken;

use super::{Answer, Client, OutboundError};
use crate::jobs::operator_file::{Stamp, stamp};
use crate::jobs::{Delivery, JobService, LONGEST_WAIT, Lease, Listener, Outbox, Told};

pub use schedule::Schedule;
pub use signature::{NoSecret, Secret};
pub use targets::{Event, Target, TargetError, TargetFile, UnknownEvent};

/// Deliveries to one target at the same time.
const SENDERS: usize = 4;
/// How often a target's deliveries and the file of targets are looked at.
const LOOK: Duration = Duration::from_millis(500);
/// How much longer than a try may take it is under its lease.
const LEASE_MARGIN: Duration = Duration::from_secs(60);
/// How long deliveries that were given up are kept, and how often those are looked for.
const DEAD_KEPT: Duration = Duration::from_secs(30 * 24 * 60 * 60);
const FORGET: Duration = Duration::from_secs(60 * 60);

/// Why webhooks cannot be sent.
#[derive(Debug, thiserror::Error)]
pub enum WebhookError {
    #[error(transparent)]
    Targets(#[from] TargetError),
    #[error(transparent)]
    Client(#[from] OutboundError),
    #[error("the targets of webhooks cannot be noted: {0}")]
    Store(#[from] crate::jobs::store::StoreError),
}

/// How webhooks are sent.
#[derive(Debug, Clone)]
pub struct Settings {
    pub file: TargetFile,
    pub schedule: Schedule,
    /// How long a target may take to answer.
    pub timeout: Duration,
}

/// Sends from now on until `jobs` shuts down; changes of the file are taken over.
///
/// # Errors
/// When the file cannot be used, or is not there although it must.
pub async fn start(settings: Settings, jobs: &JobService) -> Result<(), WebhookError> {
    let outbox = jobs.outbox();
    let first = stamp(settings.file.path());
    let mut crew = Crew::new();
    match settings.file.read_aside().await? {
        Some(targets) => crew.serve(&settings, &outbox, targets).await?,
        // What waits for the targets of before must not be given up because a file was lost.
        None => match outbox.listeners().await? {
            0 => {}
            count => {
                let error = settings.file.missing();
                tracing::error!(%error, targets = count, "nothing is sent until the file is back; what is to be told waits");
            }
        },
    }
    jobs.run_beside(follow(settings, outbox, crew, first));
    Ok(())
}

/// Whether the targets can be read now: else changes are not taken over, and a restart may tell nobody.
///
/// # Errors
/// When the file cannot be used, or is not there although it must or there are targets out of it.
pub async fn check(settings: &Settings, jobs: &JobService) -> Result<(), WebhookError> {
    if settings.file.read_aside().await?.is_none() && jobs.outbox().listeners().await? > 0 {
        return Err(settings.file.missing().into());
    }
    Ok(())
}

/// Exchanges the senders when the file has changed; a file that cannot be used, or is gone, leaves those before at work
/// and is tried again.
async fn follow(settings: Settings, outbox: Outbox, mut crew: Crew, first: Stamp) {
    let mut taken = first;
    let mut told: Option<String> = None;
    let mut forgotten: Option<tokio::time::Instant> = None;
    loop {
        tokio::select! {
            () = tokio::time::sleep(LOOK) => {}
            () = outbox.draining() => return crew.end(&outbox).await,
        }
        let now = stamp(settings.file.path());
        if now == taken {
            told = None;
        } else {
            match renew(&settings, &outbox, &mut crew).await {
                Ok(()) => (taken, told) = (now, None),
                Err(error) => {
                    let error = error.to_string();
                    // Once for each reason, not at each look.
                    if told.as_ref() != Some(&error) {
                        tracing::error!(error, "the webhook targets stay those before");
                        told = Some(error);
                    }
                }
            }
        }
        if forgotten.is_none_or(|at| at.elapsed() >= FORGET) {
            forgotten = Some(tokio::time::Instant::now());
            let kept = i64::try_from(DEAD_KEPT.as_millis()).unwrap_or(i64::MAX);
            if let Err(error) = outbox.forget(kept).await {
                tracing::warn!(%error, "old webhooks cannot be forgotten");
            }
        }
    }
}

async fn renew(settings: &Settings, outbox: &Outbox, crew: &mut Crew) -> Result<(), WebhookError> {
    let targets = settings.file.read_aside().await?.ok_or_else(|| settings.file.missing())?;
    let count = targets.len();
    crew.serve(settings, outbox, targets).await?;
    tracing::info!(targets = count, "the webhook targets have changed");
    Ok(())
}

/// The senders of all targets.
struct Crew {
    /// Those of targets before are among them until what they have under way has ended.
    senders: JoinSet<()>,
    leave: CancellationToken,
}

impl Crew {
    fn new() -> Self {
        Self { senders: JoinSet::new(), leave: CancellationToken::new() }
    }

    /// Senders for these targets in place of those before, which begin nothing more.
    async fn serve(
        &mut self,
        settings: &Settings,
        outbox: &Outbox,
        targets: Vec<Target>,
    ) -> Result<(), WebhookError> {
        let listeners: Vec<Listener> = targets.iter().map(Listener::from).collect();
        let senders = targets.into_iter().map(|target| Sender::new(target, settings, outbox));
        let senders = senders.collect::<Result<Vec<_>, _>>()?;
        outbox.listen(&listeners).await?;
        std::mem::take(&mut self.leave).cancel();
        for sender in senders {
            self.senders.spawn(Arc::new(sender).work(self.leave.clone()));
        }
        while self.senders.try_join_next().is_some() {}
        Ok(())
    }

    /// Lets what is under way end, unless the service cannot wait for it.
    async fn end(mut self, outbox: &Outbox) {
        tokio::select! {
            () = async { while self.senders.join_next().await.is_some() {} } => {}
            () = outbox.stopping() => self.senders.shutdown().await,
        }
    }
}

/// Sends to one target.
struct Sender {
    target: Target,
    client: Client,
    outbox: Outbox,
    schedule: Schedule,
    lease: Duration,
}

impl Sender {
    fn new(target: Target, settings: &Settings, outbox: &Outbox) -> Result<Self, OutboundError> {
        if target.url.is_in_the_clear() {
            tracing::warn!(to = target.name, "webhooks cross the network in the clear; use https");
        }
        let client = Client::new(target.url.clone(), settings.timeout)?;
        let lease = settings.timeout.saturating_add(LEASE_MARGIN).min(LONGEST_WAIT);
        Ok(Self { target, client, outbox: outbox.clone(), schedule: settings.schedule, lease })
    }

    /// Sends what is due until it is to leave, then ends what is under way.
    async fn work(self: Arc<Self>, leave: CancellationToken) {
        let places = Arc::new(Semaphore::new(SENDERS));
        let mut under_way = JoinSet::new();
        while !leave.is_cancelled() && !self.outbox.is_draining() {
            // The semaphore is never closed.
            let Ok(place) = places.clone().acquire_owned().await else { return };
            // That may have taken as long as a target's answer.
            if leave.is_cancelled() || self.outbox.is_draining() {
                break;
            }
            match self.claimed().await {
                Some((delivery, lease)) => {
                    let sender = self.clone();
                    under_way.spawn(async move {
                        sender.deliver(delivery, lease).await;
                        drop(place);
                    });
                }
                None => {
                    tokio::select! {
                        () = tokio::time::sleep(LOOK) => {}
                        () = self.outbox.draining() => break,
                        () = leave.cancelled() => break,
                    }
                }
            }
            while under_way.try_join_next().is_some() {}
        }
        while under_way.join_next().await.is_some() {}
    }

    async fn claimed(&self) -> Option<(Delivery, Lease)> {
        let lease = Lease::new();
        let held = i64::try_from(self.lease.as_millis()).unwrap_or(i64::MAX);
        match self.outbox.claim(&self.target.name, &lease, held).await {
            Ok(found) => found.map(|delivery| (delivery, lease)),
            Err(error) => {
                tracing::error!(to = self.target.name, %error, "webhooks cannot be looked up");
                None
            }
        }
    }

    async fn deliver(&self, delivery: Delivery, lease: Lease) {
        let outcome = self.send(&delivery).await;
        let told = self.judged(outcome, delivery.attempts);
        let (to, id, job) = (&self.target.name, &delivery.id, delivery.job);
        match &told {
            Told::Yes => tracing::info!(to, id, %job, "webhook delivered"),
            Told::Later { after, failure } => {
                tracing::warn!(to, id, %job, attempt = delivery.attempts, again_in_ms = after, failure, "webhook not delivered");
            }
            Told::Never { failure } => tracing::error!(to, id, %job, failure, "webhook given up"),
        }
        match self.outbox.settle(&delivery, &lease, &told).await {
            Ok(true) => {}
            Ok(false) => tracing::warn!(to, id, "a webhook took longer than its lease; it may be sent twice"),
            Err(error) => {
                tracing::error!(to, id, %error, "a webhook's end cannot be noted; it is sent again")
            }
        }
    }

    async fn send(&self, delivery: &Delivery) -> Result<Answer, OutboundError> {
        // A struct of strings and numbers always serialises; an empty body is the honest rest.
        let body = payload::body(delivery).unwrap_or_default();
        let timestamp = time::OffsetDateTime::now_utc().unix_timestamp();
        let signature = self.target.sign(&delivery.id, timestamp, &body);
        let headers = [
            ("content-type", "application/json".to_owned()),
            ("webhook-id", delivery.id.clone()),
            ("webhook-timestamp", timestamp.to_string()),
            ("webhook-signature", signature),
        ];
        self.client.post(&headers, body).await
    }

    /// Any 2xx is success, and 410 asks to send no more of it ("Delivery attempts and failures").
    fn judged(&self, outcome: Result<Answer, OutboundError>, tries: u32) -> Told {
        let (failure, asked) = match outcome {
            Ok(Answer { status: 200..300, .. }) => return Told::Yes,
            Ok(Answer { status: 410, .. }) => {
                return Told::Never { failure: OutboundError::Status(410).to_string() };
            }
            Ok(Answer { status, retry_after }) => (OutboundError::Status(status).to_string(), retry_after),
            Err(error) => (error.to_string(), None),
        };
        match self.schedule.wait(tries, asked, random()) {
            Some(wait) => Told::Later { after: i64::try_from(wait.as_millis()).unwrap_or(i64::MAX), failure },
            None => Told::Never { failure },
        }
    }
}

/// From 0 to 1.
fn random() -> f64 {
    getrandom::u32().map_or(1.0, |value| f64::from(value) / f64::from(u32::MAX))
}
