//! The pose of an object of known shape, from a camera on the wrist, the force at the tool's tip
//! and the joints: Lippiello, Siciliano, Villani, "Robot Force/Position Control with Force and
//! Visual Feedback".
//!
//! `object_pose_paper` is the published filter, `object_pose` the consistent form. Called by the
//! closed loop of `evaluate` and by the service that publishes `estimate/NAME/object`.

mod arm_history;
mod camera_model;
mod config;
mod contact;
mod filter;
mod filter_measurements;
mod filter_state;
mod implicit_surface;
mod interface;
mod paper;
mod paper_jacobians;
mod planar_pose;

pub use camera_model::{CORNERS, CameraFrame, CameraModel, Corner};
pub use config::{ContactNoiseConfig, Measurements, ObjectPoseConfig, PriorConfig, TargetConfig};
pub use filter::ObjectPose;
pub use implicit_surface::{ImplicitSurface, ObjectShape};
pub use interface::{
    CalibrationEstimate, FrameCounts, ObjectEstimate, ObjectPoseEstimator, ObjectSample,
};
pub use paper::ObjectPosePaper;
pub use planar_pose::{PlanarPoseError, PlanarTarget};

use crate::EstimationError;

/// Names of the estimators of an object's pose; the consistent one comes first.
pub const OBJECT_ESTIMATORS: [&str; 2] = ["object_pose", "object_pose_paper"];

/// Creates an object-pose estimator by name, with the settings of target, camera and noise.
///
/// # Errors
/// The name is unknown, or a setting is out of its range.
pub fn build_object_estimator(
    name: &str,
    config: &ObjectPoseConfig,
    camera: &CameraModel,
) -> Result<Box<dyn ObjectPoseEstimator>, EstimationError> {
    match name {
        "object_pose" => Ok(Box::new(ObjectPose::new(config, camera)?)),
        "object_pose_paper" => Ok(Box::new(ObjectPosePaper::new(config, camera)?)),
        other => Err(EstimationError::Unknown {
            name: other.to_owned(),
            allowed: OBJECT_ESTIMATORS.join(", "),
        }),
    }
}
