//! The estimators of an object's pose in one service: inputs are arm states and the camera's
//! features, outputs the object's pose and the normal that follows from it.

use std::time::Instant;

use tangent_estimation::object_pose::{CameraFrame, CameraModel, Corner, ObjectShape};
use tangent_estimation::{
    CORNERS, ContactSample, ObjectEstimate, ObjectPoseEstimator, ObjectSample,
    build_object_estimator,
};
use tangent_mechanics::{Flange, Pose, Tool};
use tangent_runtime::health::instance_name;
use tangent_runtime::{
    Age, AliveToken, Bus, Gauge, HealthReporter, Publisher, Rate, Received, Subscription,
};
use tangent_schemas::tangent::{ArmState, FeatureArray, NormalEstimate, ObjectEstimate as Message};
use tangent_schemas::topics;

use crate::message::{message, object_message};
use crate::{EstimatorError, ObjectChoice};

/// Number of feature messages that may wait; each arm state takes one.
const WAITING: usize = 8;
/// Silence of the camera after which it is reported, s.
const CAMERA_PATIENCE_S: f64 = 0.5;

struct Lane {
    estimator: Box<dyn ObjectPoseEstimator>,
    shape: ObjectShape,
    objects: Publisher<Message>,
    normals: Publisher<NormalEstimate>,
    _alive: AliveToken,
}

pub(crate) struct Objects {
    lanes: Vec<Lane>,
    features: Subscription<FeatureArray>,
    tool_from_flange: Pose<Tool, Flange>,
    meters: Meters,
}

struct Meters {
    frames: Rate,
    camera_age: Age,
    refused: Gauge,
}

impl Objects {
    /// `None` if no estimator of an object's pose is configured.
    pub fn new(
        choices: &[ObjectChoice],
        camera: Option<&CameraModel>,
        flange_from_tool: &Pose<Flange, Tool>,
        bus: &Bus,
        health: &HealthReporter,
    ) -> Result<Option<Self>, EstimatorError> {
        if choices.is_empty() {
            return Ok(None);
        }
        let camera = camera.ok_or_else(|| EstimatorError::NoCamera(choices[0].name.clone()))?;
        let mut lanes: Vec<Lane> = Vec::with_capacity(choices.len());
        for choice in choices {
            let estimator = build_object_estimator(&choice.name, &choice.settings, camera)?;
            if lanes.iter().any(|l| l.estimator.name() == estimator.name()) {
                return Err(EstimatorError::Twice(choice.name.clone()));
            }
            lanes.push(Lane {
                objects: bus.publisher(&topics::estimate_object(estimator.name()))?,
                normals: bus.publisher(&topics::estimate_normal(estimator.name()))?,
                _alive: bus.declare_alive(
                    &topics::estimator_service(estimator.name()),
                    &instance_name(),
                )?,
                shape: choice.settings.target.surface,
                estimator,
            });
        }
        Ok(Some(Self {
            lanes,
            features: bus.subscribe(&topics::CAMERA_FEATURES, WAITING)?,
            tool_from_flange: flange_from_tool.inverse(),
            meters: Meters {
                frames: health.rate("camera_features"),
                camera_age: health.age("camera_features"),
                refused: health.gauge("camera_features_refused"),
            },
        }))
    }

    /// Resets all estimators.
    pub fn reset(&mut self) {
        for lane in &mut self.lanes {
            lane.estimator.reset();
        }
    }

    /// Handles one arm state, with the camera's features since the last one.
    pub fn step(&mut self, contact: &ContactSample, arm: &ArmState) {
        let frame = self.frame(contact.time_s, arm);
        let sample = ObjectSample {
            time_s: contact.time_s,
            base_from_flange: contact.base_from_tool * self.tool_from_flange,
            base_from_tool: contact.base_from_tool,
            wrench: contact.wrench,
            wrench_delay_s: contact.wrench_delay_s,
            wrench_validity: contact.wrench_validity,
            wrench_bias_age_s: contact.wrench_bias_age_s,
            frame,
        };
        let tip = contact.base_from_tool.translation();
        for lane in &mut self.lanes {
            let begin = Instant::now();
            let estimate: ObjectEstimate = lane.estimator.update(&sample);
            let normal = estimate.normal_at(&lane.shape, &tip);
            let update_s = begin.elapsed().as_secs_f64();
            let name = lane.estimator.name();
            lane.objects
                .publish(&object_message(name, &estimate, arm, update_s));
            lane.normals.publish(&message(name, &normal, arm, update_s));
        }
    }

    /// Whether the camera has been silent for too long.
    pub fn is_blind(&self) -> bool {
        !(0.0..=CAMERA_PATIENCE_S).contains(&self.meters.camera_age.seconds())
    }

    /// The oldest waiting frame, on the clock of the arm's samples.
    fn frame(&mut self, time_s: f64, arm: &ArmState) -> Option<CameraFrame> {
        let received: Received<FeatureArray> = self.features.try_recv()?;
        self.meters.frames.tick();
        self.meters.camera_age.mark_at(received.received);
        let frame = frame_of(&received.message, time_s, arm.header.stamp.to_ns());
        if frame.is_none() {
            self.meters.refused.set(self.meters.refused.get() + 1.0);
        }
        frame
    }
}

/// Converts features to the estimators' clock by the difference of the stamps. `None` if a label is
/// not one of the target's or occurs twice, or a coordinate is not finite.
fn frame_of(features: &FeatureArray, time_s: f64, arm_stamp_ns: i64) -> Option<CameraFrame> {
    let mut corners = [None; CORNERS];
    for feature in &features.features {
        let slot = corners.get_mut(feature.id as usize)?;
        if slot.is_some() || !feature.u.is_finite() || !feature.v.is_finite() {
            return None;
        }
        *slot = Some(Corner {
            pixel_px: nalgebra::Vector2::new(feature.u, feature.v),
        });
    }
    let stamp_ns = features.header.stamp.to_ns();
    let behind_s = (i128::from(arm_stamp_ns) - i128::from(stamp_ns)) as f64 * 1e-9;
    Some(CameraFrame {
        time_s: time_s - behind_s,
        sequence: features.sequence,
        corners,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use tangent_schemas::standard::Header;
    use tangent_schemas::tangent::Feature;

    fn found(ids: &[u32]) -> FeatureArray {
        FeatureArray {
            header: Header::new(10_000_000_000, "camera"),
            sequence: 7,
            features: ids
                .iter()
                .map(|&id| Feature {
                    id,
                    u: f64::from(id),
                    v: 2.0,
                })
                .collect(),
            detect_s: 0.001,
        }
    }

    #[test]
    fn a_frame_is_placed_by_the_difference_of_the_stamps() {
        let frame = frame_of(&found(&[0, 2]), 3.0, 10_025_000_000).unwrap();
        assert!((frame.time_s - 2.975).abs() < 1e-12);
        assert_eq!(frame.sequence, 7);
        assert_eq!(
            frame.corners.map(|c| c.is_some()),
            [true, false, true, false]
        );
    }

    #[test]
    fn invalid_labels_are_refused() {
        assert!(frame_of(&found(&[0, 4]), 3.0, 0).is_none());
        assert!(frame_of(&found(&[1, 1]), 3.0, 0).is_none());
        let mut bad = found(&[0, 1]);
        bad.features[1].v = f64::NAN;
        assert!(frame_of(&bad, 3.0, 0).is_none());
    }
}
