//! `blend`: fusion of the reactive estimate and the Gaussian-process prediction (Tugal et al.,
//! IV.B.d).
//!
//! The published weight is a constant; here it follows from the covariances of both. Created by the
//! registry.

use tangent_mechanics::Direction;

use crate::EstimatorConfig;
use crate::gaussian_process::GaussianProcess;
use crate::tangent_frame::TangentFrame;
use crate::world_estimator::{WorldEstimate, WorldEstimator, WorldSample};

/// `n = (1 - alpha) n_reactive + alpha n_predicted` with `alpha = tr(P_r) / (tr(P_r) + tr(P_p))`,
/// bounded.
#[derive(Clone, Debug)]
pub(crate) struct Blend {
    config: EstimatorConfig,
    process: GaussianProcess,
}

impl Blend {
    /// The configuration must have passed [`EstimatorConfig::check`].
    pub fn new(config: &EstimatorConfig) -> Self {
        Self {
            config: *config,
            process: GaussianProcess::new(config),
        }
    }
}

/// Covariance intersection in the tangent plane of the reactive normal. The prediction was learnt
/// from the reactive estimate; this rule stays consistent whatever the two have in common.
fn fuse(reactive: &WorldEstimate, predicted: &WorldEstimate, alpha: f64) -> Option<WorldEstimate> {
    let frame = TangentFrame::new(
        reactive.normal_vector(),
        (predicted.normal - reactive.normal).components(),
    );
    let ours = frame.project_matrix(&reactive.covariance).try_inverse()?;
    let theirs = frame.project_matrix(&predicted.covariance).try_inverse()?;
    let covariance = (ours * (1.0 - alpha) + theirs * alpha).try_inverse()?;
    let turn = covariance * (theirs * alpha) * frame.logarithm(&predicted.normal_vector());
    let fused = frame.turned(&turn);
    let symmetric = (covariance + covariance.transpose()) * 0.5;
    Some(WorldEstimate {
        normal: Direction::new(fused.normal),
        covariance: fused.lift_matrix(&symmetric),
        curvature: reactive.curvature.map(|c| fused.flatten(&c)),
        ..*reactive
    })
}

impl WorldEstimator for Blend {
    fn name(&self) -> &'static str {
        "blend"
    }

    fn update(&mut self, sample: &WorldSample) -> WorldEstimate {
        let (reactive, prediction) = self.process.step(sample);
        let Some(predicted) = prediction else {
            return reactive;
        };
        let (ours, theirs) = (reactive.covariance.trace(), predicted.covariance.trace());
        let b = &self.config.blend;
        let alpha = (ours / (ours + theirs).max(f64::MIN_POSITIVE)).clamp(b.alpha_min, b.alpha_max);
        let estimate = fuse(&reactive, &predicted, alpha).unwrap_or(reactive);
        self.process.hold(estimate);
        estimate
    }

    fn reset(&mut self) {
        *self = Self::new(&self.config);
    }
}
