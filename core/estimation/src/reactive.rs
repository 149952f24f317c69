//! `reactive`: the normal from force and velocity, cycle by cycle (Tugal et al., IV.B.a).
//!
//! Extends the published decomposition for use on hardware: measured velocity with the lag of the
//! wrench filter, friction that is forgotten by distance, force bias as a state, and a covariance.
//! Created by the registry, and by the estimators that refine it.

use nalgebra::Matrix2;

use crate::EstimatorConfig;
use crate::contact_filter::{ContactFilter, ContactFilterState};
use crate::motion::{Motion, MotionTracker};
use crate::world_estimator::{WorldEstimate, WorldEstimator, WorldSample};

/// Force-velocity decomposition with friction and bias as states.
#[derive(Clone, Debug)]
pub(crate) struct Reactive {
    config: EstimatorConfig,
    tracker: MotionTracker,
    filter: ContactFilter,
    state: ContactFilterState,
    held: Option<WorldEstimate>,
}

impl Reactive {
    /// The configuration must have passed [`EstimatorConfig::check`].
    pub fn new(config: &EstimatorConfig) -> Self {
        let filter = ContactFilter::new(config);
        Self {
            config: *config,
            tracker: MotionTracker::default(),
            state: filter.initial_state(),
            filter,
            held: None,
        }
    }

    /// Takes a sample. Returns the estimate and the motion it was computed from; the motion is
    /// `None` if the sample was rejected.
    pub(crate) fn step(&mut self, sample: &WorldSample) -> (WorldEstimate, Option<Motion>) {
        match self.tracker.take(sample) {
            Ok(motion) => {
                self.filter.update(&mut self.state, &motion);
                let estimate = self.filter.estimate(&self.state, &motion);
                self.held = Some(estimate);
                (estimate, Some(motion))
            }
            Err(validity) => {
                let mut estimate = self
                    .held
                    .unwrap_or_else(|| WorldEstimate::invalid(&sample.world_from_tool, validity));
                estimate.validity = validity;
                (estimate, None)
            }
        }
    }

    /// State of the contact filter after the last sample.
    pub(crate) fn state(&self) -> &ContactFilterState {
        &self.state
    }

    /// Covariance of the normal in tangent axes, rad², after the last sample.
    pub(crate) fn normal_covariance(&self) -> Matrix2<f64> {
        self.filter.normal_covariance(&self.state)
    }

    /// Sets the estimate that is returned for rejected samples.
    pub(crate) fn hold(&mut self, estimate: WorldEstimate) {
        self.held = Some(estimate);
    }
}

impl WorldEstimator for Reactive {
    fn name(&self) -> &'static str {
        "reactive"
    }

    fn update(&mut self, sample: &WorldSample) -> WorldEstimate {
        self.step(sample).0
    }

    fn reset(&mut self) {
        *self = Self::new(&self.config);
    }
}
