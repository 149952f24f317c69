//! `reactive`: the normal from force and velocity, cycle by cycle (Tugal et al., IV.B.a).
//!
//! The published decomposition with what hardware asks of it: measured velocity under the wrench
//! filter's lag, friction forgotten by distance, force bias carried as a state, and a covariance.
//! Called by the registry, and by the estimators that refine it.

use crate::contact_filter::ContactFilter;
use crate::motion::{Motion, MotionTracker};
use crate::{ContactSample, EstimatorConfig, NormalEstimate, NormalEstimator};

/// Force-velocity decomposition with friction and bias as states.
#[derive(Clone, Debug)]
pub struct Reactive {
    config: EstimatorConfig,
    tracker: MotionTracker,
    filter: ContactFilter,
    held: Option<NormalEstimate>,
}

impl Reactive {
    /// The configuration must have passed [`EstimatorConfig::check`].
    pub fn new(config: &EstimatorConfig) -> Self {
        Self {
            config: *config,
            tracker: MotionTracker::default(),
            filter: ContactFilter::new(config),
            held: None,
        }
    }

    /// One step; also what the refining estimators need of it. The motion is `None` where the
    /// sample was refused.
    pub(crate) fn step(&mut self, sample: &ContactSample) -> (NormalEstimate, Option<Motion>) {
        match self.tracker.take(sample) {
            Ok(motion) => {
                self.filter.update(&motion);
                let estimate = self.filter.estimate(&motion);
                self.held = Some(estimate);
                (estimate, Some(motion))
            }
            Err(validity) => {
                let mut estimate = self
                    .held
                    .unwrap_or_else(|| NormalEstimate::refused(&sample.base_from_tool, validity));
                estimate.validity = validity;
                (estimate, None)
            }
        }
    }

    pub(crate) fn filter(&self) -> &ContactFilter {
        &self.filter
    }

    /// What is handed out for refused samples from now on.
    pub(crate) fn hold(&mut self, estimate: NormalEstimate) {
        self.held = Some(estimate);
    }
}

impl NormalEstimator for Reactive {
    fn name(&self) -> &'static str {
        "reactive"
    }

    fn update(&mut self, sample: &ContactSample) -> NormalEstimate {
        self.step(sample).0
    }

    fn reset(&mut self) {
        *self = Self::new(&self.config);
    }
}
