//! Estimates as messages on the bus.

use tangent_estimation::{NormalEstimate, ObjectEstimate};
use tangent_schemas::Covariance;
use tangent_schemas::convert::cut;
use tangent_schemas::standard::Header;
use tangent_schemas::tangent::{
    ArmState, NormalEstimate as NormalEstimateMessage, ObjectEstimate as ObjectEstimateMessage,
};

/// Message for an estimate of the normal; `arm` is the state that it is based on, `update_s` the
/// time of the update, s. No allocation.
pub(crate) fn message(
    name: &str,
    estimate: &NormalEstimate,
    arm: &ArmState,
    update_s: f64,
) -> NormalEstimateMessage {
    let mut covariance = [0.0; 9];
    // Symmetric: row-major and column-major are the same.
    covariance.copy_from_slice(estimate.covariance.as_slice());
    let mut curvature = [0.0; 9];
    if let Some(shape) = &estimate.curvature {
        curvature.copy_from_slice(shape.as_slice());
    }
    NormalEstimateMessage {
        header: Header::new(arm.header.stamp.to_ns(), "base"),
        cycle: arm.cycle,
        estimator: cut(name),
        point: (&estimate.point).into(),
        normal: (&estimate.normal).into(),
        covariance,
        validity: estimate.validity as u8,
        reason: cut(estimate.validity.reason()),
        friction: estimate.friction.unwrap_or(-1.0),
        curvature,
        update_s,
    }
}

/// Message for an estimate of an object's pose; `arm` is the state that it is based on, `update_s`
/// the time of the update, s. No allocation.
pub(crate) fn object_message(
    name: &str,
    estimate: &ObjectEstimate,
    arm: &ArmState,
    update_s: f64,
) -> ObjectEstimateMessage {
    let mut covariance = Covariance::default();
    covariance.0.copy_from_slice(estimate.covariance.as_slice());
    ObjectEstimateMessage {
        header: Header::new(arm.header.stamp.to_ns(), "base"),
        cycle: arm.cycle,
        estimator: cut(name),
        pose: (&estimate.base_from_object).into(),
        twist: (&estimate.twist).into(),
        covariance,
        validity: estimate.validity as u8,
        reason: cut(estimate.validity.reason()),
        vision_age_s: if estimate.vision_age_s.is_finite() {
            estimate.vision_age_s
        } else {
            -1.0
        },
        in_contact: estimate.in_contact,
        force_n: estimate.force_n,
        update_s,
    }
}
