//! `blend`: reactive estimate and Gaussian-process prediction, fused (Tugal et al., IV.B.d).
//!
//! The published weight is a constant; here it follows from how sure each side is. Called by the
//! registry.

use crate::gaussian_process::GaussianProcess;
use crate::tangent_frame::TangentFrame;
use crate::{ContactSample, EstimatorConfig, NormalEstimate, NormalEstimator};

/// `n = (1 - alpha) n_reactive + alpha n_predicted` with `alpha = tr(P_r) / (tr(P_r) + tr(P_p))`,
/// bounded.
#[derive(Clone, Debug)]
pub struct Blend {
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

/// Covariance intersection in the tangent plane of the reactive normal: the prediction has learnt
/// from that same estimate, and this rule stays honest whatever they share.
fn fuse(
    reactive: &NormalEstimate,
    predicted: &NormalEstimate,
    alpha: f64,
) -> Option<NormalEstimate> {
    let frame = TangentFrame::new(reactive.normal, predicted.normal - reactive.normal);
    let ours = frame.project_matrix(&reactive.covariance).try_inverse()?;
    let theirs = frame.project_matrix(&predicted.covariance).try_inverse()?;
    let covariance = (ours * (1.0 - alpha) + theirs * alpha).try_inverse()?;
    let turn = covariance * (theirs * alpha) * frame.logarithm(&predicted.normal);
    let fused = frame.turned(&turn);
    let symmetric = (covariance + covariance.transpose()) * 0.5;
    Some(NormalEstimate {
        normal: fused.normal,
        covariance: fused.lift_matrix(&symmetric),
        curvature: reactive.curvature.map(|c| fused.flatten(&c)),
        ..*reactive
    })
}

impl NormalEstimator for Blend {
    fn name(&self) -> &'static str {
        "blend"
    }

    fn update(&mut self, sample: &ContactSample) -> NormalEstimate {
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
