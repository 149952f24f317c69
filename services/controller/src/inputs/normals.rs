//! Estimates of the surface's normal.

use std::time::Duration;

use nalgebra::{Matrix3, Vector3};
use tangent_control::{EstimateInput, EstimatorName};
use tangent_estimation::NormalEstimate;
use tangent_runtime::Latest;
use tangent_schemas::tangent::{ArmState, NormalEstimate as NormalMessage};
use tangent_sensing::Validity;

use super::age::CycleAge;

/// Reads the topic of one estimator.
pub struct EstimateReader {
    /// As in `estimate/NAME/normal`.
    pub name: EstimatorName,
    newest: Latest<NormalMessage>,
    age: CycleAge,
    /// Estimate read in this cycle.
    now: Option<EstimateInput>,
}

impl EstimateReader {
    /// Reads `newest`, the topic of the estimator of this name.
    pub fn new(name: EstimatorName, newest: Latest<NormalMessage>) -> Self {
        Self {
            name,
            newest,
            age: CycleAge::default(),
            now: None,
        }
    }

    /// Reads the newest estimate and its age, `since_packet` after the robot's newest packet `arm`
    /// came.
    pub fn read(&mut self, arm: &ArmState, since_packet: Duration) {
        let age = &mut self.age;
        self.now = self.newest.get().map(|newest| {
            let message = &newest.message;
            let said = (newest.publisher, message.header.stamp.to_ns());
            EstimateInput {
                estimate: normal_estimate(message),
                age_s: age.of(said, message.cycle, newest.age(), arm, since_packet),
            }
        });
    }

    /// Estimate of this cycle; `None` before the first message.
    pub fn now(&self) -> Option<EstimateInput> {
        self.now
    }
}

/// Estimate from a message.
pub fn normal_estimate(message: &NormalMessage) -> NormalEstimate {
    let shape = Matrix3::from_row_slice(&message.curvature);
    NormalEstimate {
        point: Vector3::from(&message.point),
        normal: Vector3::from(&message.normal),
        covariance: Matrix3::from_row_slice(&message.covariance),
        validity: Validity::from(message.validity),
        friction: (message.friction >= 0.0).then_some(message.friction),
        curvature: (shape != Matrix3::zeros()).then_some(shape),
    }
}
