//! What every operation works with.

use std::sync::Arc;

use rayon::ThreadPoolBuildError;
use tokio_util::sync::CancellationToken;

use super::idempotency::InFlight;
use super::limits::Limits;
use super::validation::Validator;
use crate::jobs::JobService;

/// The service's state; clones share it.
#[derive(Clone)]
pub struct App(Arc<Inner>);

struct Inner {
    jobs: Arc<JobService>,
    limits: Limits,
    validator: Validator,
    in_flight: InFlight,
    closing: CancellationToken,
}

impl App {
    /// # Errors
    /// When the threads that check meshes cannot be started.
    pub fn new(jobs: Arc<JobService>, limits: Limits) -> Result<Self, ThreadPoolBuildError> {
        let validator = Validator::new(&limits)?;
        Ok(Self(Arc::new(Inner {
            jobs,
            limits,
            validator,
            in_flight: InFlight::default(),
            closing: CancellationToken::new(),
        })))
    }

    pub fn jobs(&self) -> &JobService {
        &self.0.jobs
    }

    pub fn limits(&self) -> &Limits {
        &self.0.limits
    }

    pub(super) fn validator(&self) -> &Validator {
        &self.0.validator
    }

    pub(super) fn in_flight(&self) -> &InFlight {
        &self.0.in_flight
    }

    /// Set when the service begins to shut down: requests that wait should answer.
    pub fn closing(&self) -> &CancellationToken {
        &self.0.closing
    }
}
