//! An estimate as it travels on the bus.

use tangent_estimation::NormalEstimate;
use tangent_schemas::convert::cut;
use tangent_schemas::standard::Header;
use tangent_schemas::tangent::{ArmState, NormalEstimate as NormalEstimateMessage};

/// Of the arm state it rests on; `update_s` is the time the update took. No allocation.
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
