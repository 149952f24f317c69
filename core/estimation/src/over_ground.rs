//! Estimation on a moving base: samples go to the floor's axes, estimates come back to the base's.
//!
//! Around every estimator that the registry makes. The surface stands on the floor, so windows, maps and the filter's states
//! must too: kept in base axes they would be smeared by every centimetre that the platform moves. The estimators themselves
//! know one frame that the surface is fixed to, which they call base; on a moving base they are handed the floor's instead.
//! Samples without a base's motion pass through untouched.

use nalgebra::Matrix3;
use tangent_mechanics::{Aligned, Base, Pose, Tool, Twist};
use tangent_sensing::{BaseMotion, Validity};

use crate::{ContactSample, NormalEstimate, NormalEstimator};

/// An estimator whose memory stays with the floor.
pub(crate) struct OverGround {
    inner: Box<dyn NormalEstimator>,
    /// It has learnt in the floor's axes.
    on_floor: bool,
}

impl OverGround {
    pub fn new(inner: Box<dyn NormalEstimator>) -> Self {
        Self {
            inner,
            on_floor: false,
        }
    }
}

/// The sample as the floor sees it. A base of unknown motion makes the sample unusable, with the reason.
fn to_floor(sample: &ContactSample, base: &BaseMotion) -> ContactSample {
    let moved = |twist: &Twist<Aligned<Tool, Base>>| {
        let twist = base.over_ground(&sample.base_from_tool, twist);
        Twist::new(twist.linear, twist.angular)
    };
    ContactSample {
        base_from_tool: Pose::from_isometry(
            *(base.world_from_base * sample.base_from_tool).isometry(),
        ),
        twist: moved(&sample.twist),
        twist_commanded: moved(&sample.twist_commanded),
        wrench_validity: if base.trouble.is_some() && sample.wrench_validity.is_valid() {
            Validity::BaseUnknown
        } else {
            sample.wrench_validity
        },
        base: None,
        ..*sample
    }
}

fn to_base(estimate: &NormalEstimate, base: &BaseMotion) -> NormalEstimate {
    let pose = base.world_from_base.inverse();
    let rotation = pose.rotation().to_rotation_matrix().into_inner();
    let turned = |m: &Matrix3<f64>| {
        let t = rotation * m * rotation.transpose();
        // Exactly symmetric, so that readers may compare entries.
        (t + t.transpose()) * 0.5
    };
    NormalEstimate {
        point: pose.transform_point(&estimate.point),
        normal: pose.rotate(&estimate.normal),
        covariance: turned(&estimate.covariance),
        curvature: estimate.curvature.as_ref().map(turned),
        ..*estimate
    }
}

impl NormalEstimator for OverGround {
    fn name(&self) -> &'static str {
        self.inner.name()
    }

    fn update(&mut self, sample: &ContactSample) -> NormalEstimate {
        let Some(base) = &sample.base else {
            // The base was heard once and is no more: what was learnt is where nobody can say.
            if std::mem::take(&mut self.on_floor) {
                self.inner.reset();
            }
            return self.inner.update(sample);
        };
        self.on_floor = true;
        to_base(&self.inner.update(&to_floor(sample, base)), base)
    }

    fn reset(&mut self) {
        self.inner.reset();
    }
}
