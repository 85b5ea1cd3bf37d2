//! What every operation works with.

use std::sync::Arc;

use rayon::ThreadPoolBuildError;
use tokio::sync::Semaphore;
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;

use super::access::Gate;
use super::admission::Shares;
use super::audit::Trail;
use super::counters::{Counters, LostLines};
use super::crowd::Crowd;
use super::idempotency::InFlight;
use super::limits::Limits;
use super::operations::health::Faults;
use super::tls::Tls;
use super::validation::Validator;
use crate::jobs::JobService;
use crate::outbound::webhooks;

/// The service's state; clones share it.
#[derive(Clone)]
pub struct App(Arc<Inner>);

struct Inner {
    jobs: Arc<JobService>,
    limits: Limits,
    validator: Validator,
    in_flight: InFlight,
    connections: Crowd,
    uploads: Arc<Semaphore>,
    shares: Shares,
    gate: Option<Gate>,
    trail: Option<Arc<Trail>>,
    tls: Option<Arc<Tls>>,
    webhooks: Option<webhooks::Settings>,
    counters: Counters,
    lost_lines: LostLines,
    faults: Faults,
    closing: CancellationToken,
    requests: TaskTracker,
}

impl App {
    /// Without a `gate`, whoever reaches the service may do everything.
    ///
    /// # Errors
    /// When the threads that check meshes cannot be started.
    pub fn new(
        jobs: Arc<JobService>,
        limits: Limits,
        gate: Option<Gate>,
        trail: Option<Trail>,
        tls: Option<Tls>,
        webhooks: Option<webhooks::Settings>,
        lost_lines: LostLines,
    ) -> Result<Self, ThreadPoolBuildError> {
        let validator = Validator::new(&limits)?;
        Ok(Self(Arc::new(Inner {
            jobs,
            limits,
            validator,
            in_flight: InFlight::default(),
            connections: Crowd::new(limits.connections),
            uploads: Arc::new(Semaphore::new(limits.uploads.min(Semaphore::MAX_PERMITS))),
            shares: Shares::default(),
            gate,
            trail: trail.map(Arc::new),
            tls: tls.map(Arc::new),
            webhooks,
            counters: Counters::default(),
            lost_lines,
            faults: Faults::default(),
            closing: CancellationToken::new(),
            requests: TaskTracker::new(),
        })))
    }

    pub fn jobs(&self) -> &JobService {
        &self.0.jobs
    }

    /// The requests that change something: they go on to their end without their clients.
    pub(super) fn requests(&self) -> &TaskTracker {
        &self.0.requests
    }

    pub fn limits(&self) -> &Limits {
        &self.0.limits
    }

    pub(super) fn validator(&self) -> &Validator {
        &self.0.validator
    }

    pub(super) fn gate(&self) -> Option<&Gate> {
        self.0.gate.as_ref()
    }

    pub(super) fn trail(&self) -> Option<&Arc<Trail>> {
        self.0.trail.as_ref()
    }

    /// What connections are encrypted with, if they are.
    pub(super) fn tls(&self) -> Option<&Arc<Tls>> {
        self.0.tls.as_ref()
    }

    /// How others are told of jobs' ends, if they are.
    pub(super) fn webhooks(&self) -> Option<&webhooks::Settings> {
        self.0.webhooks.as_ref()
    }

    pub(super) fn counters(&self) -> &Counters {
        &self.0.counters
    }

    /// What the log has lost.
    pub(super) fn lost_lines(&self) -> &LostLines {
        &self.0.lost_lines
    }

    /// What readiness has told the log of.
    pub(super) fn faults(&self) -> &Faults {
        &self.0.faults
    }

    /// A place for each connection that may be open at the same time.
    pub(super) fn connections(&self) -> &Crowd {
        &self.0.connections
    }

    /// A place for each upload that may come in at the same time.
    pub(super) fn uploads(&self) -> &Arc<Semaphore> {
        &self.0.uploads
    }

    /// How many of those places each sender has.
    pub(super) fn shares(&self) -> &Shares {
        &self.0.shares
    }

    pub(super) fn in_flight(&self) -> &InFlight {
        &self.0.in_flight
    }

    /// Set when the service begins to shut down: requests that wait should answer.
    pub fn closing(&self) -> &CancellationToken {
        &self.0.closing
    }
}
