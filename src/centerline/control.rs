//! Progress out of a running extraction, and cancellation into it.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use crate::centerline::ExtractError;

/// The stages of the method, in the paper's order and words (section IV).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Stage {
    /// Checks, repairs and caps of the surface, before the paper's first stage.
    Preparation,
    /// The morphology-preserving smoothing filter (the paper's ref. 6), off by default.
    SmoothingFilter,
    /// Tips of the branches (IV.A, refs. 30 and 31).
    Tips,
    /// Segmentation into branches (IV.A, eqs. 1-3).
    Segmentation,
    /// Optimal cut planes and centerline points (IV.B, eqs. 4, 8-10).
    CutPlanes,
    /// Laplacian smoothing of the centerline points (IV.C).
    LaplacianSmoothing,
    /// Linearity and thinning (IV.C, eqs. 5-7, Algorithm 1).
    Thinning,
    /// Re-centering and joint collapse (IV.D, eq. 10).
    Recentering,
    /// Sub-sampling and connection into the 1D centerline (IV.D).
    Connection,
}

impl Stage {
    /// Every stage, in order.
    pub const ALL: [Stage; 9] = [
        Stage::Preparation,
        Stage::SmoothingFilter,
        Stage::Tips,
        Stage::Segmentation,
        Stage::CutPlanes,
        Stage::LaplacianSmoothing,
        Stage::Thinning,
        Stage::Recentering,
        Stage::Connection,
    ];

    /// The stage's name in job status, logs and timings.
    pub fn name(self) -> &'static str {
        match self {
            Stage::Preparation => "preparation",
            Stage::SmoothingFilter => "smoothing_filter",
            Stage::Tips => "tips",
            Stage::Segmentation => "segmentation",
            Stage::CutPlanes => "cut_planes",
            Stage::LaplacianSmoothing => "laplacian_smoothing",
            Stage::Thinning => "thinning",
            Stage::Recentering => "recentering",
            Stage::Connection => "connection",
        }
    }
}

/// The share of the surface, by vertices, that goes through the stages after preparation now.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Part {
    /// What went through them before, 0 to 1.
    pub before: f64,
    /// What is at work, 0 to 1.
    pub share: f64,
}

impl Part {
    /// The whole surface at once.
    pub const WHOLE: Part = Part { before: 0.0, share: 1.0 };

    /// How much of the whole is done when `within` of this part is; all of them 0 to 1.
    pub fn overall(self, within: f64) -> f64 {
        self.before + self.share * within
    }
}

/// What a running extraction tells its caller.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Progress {
    /// The stage at work.
    pub stage: Stage,
    /// How much of that stage is done, 0 to 1.
    pub fraction: f64,
    /// What of the surface the stage is at work on: one component after another goes through the stages.
    pub part: Part,
}

/// A flag that stops an extraction; clones share it.
#[derive(Debug, Clone, Default)]
pub struct CancelToken(Arc<AtomicBool>);

impl CancelToken {
    pub fn new() -> Self {
        Self::default()
    }

    /// Asks the extraction to stop; it obeys within 100 ms.
    pub fn cancel(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    pub fn is_cancelled(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }

    /// `Err(Cancelled)` once [`CancelToken::cancel`] was called; loops call this every few thousand steps.
    pub fn check(&self) -> Result<(), ExtractError> {
        if self.is_cancelled() { Err(ExtractError::Cancelled) } else { Ok(()) }
    }
}

/// What the caller hands to an extraction beside mesh and parameters.
pub struct Control<'a> {
    pub cancel: CancelToken,
    progress: Option<&'a (dyn Fn(Progress) + Sync)>,
    part: Part,
}

impl<'a> Control<'a> {
    /// Reports progress to `progress`, possibly from several threads.
    pub fn new(cancel: CancelToken, progress: &'a (dyn Fn(Progress) + Sync)) -> Self {
        Self { cancel, progress: Some(progress), part: Part::WHOLE }
    }

    /// No progress and no way to cancel: for tests and small tools.
    pub fn silent() -> Control<'static> {
        Control { cancel: CancelToken::new(), progress: None, part: Part::WHOLE }
    }

    /// The same caller, told of the progress of `part` alone.
    pub(super) fn of_part(&self, part: Part) -> Control<'a> {
        Control { cancel: self.cancel.clone(), progress: self.progress, part }
    }

    /// The same caller, told of nothing: for work that another stage tells of.
    pub(super) fn quiet(&self) -> Control<'a> {
        Control { cancel: self.cancel.clone(), progress: None, part: self.part }
    }

    /// Reports `fraction` of `stage` and fails once cancelled.
    pub fn report(&self, stage: Stage, fraction: f64) -> Result<(), ExtractError> {
        if let Some(progress) = self.progress {
            progress(Progress { stage, fraction, part: self.part });
        }
        self.cancel.check()
    }
}
