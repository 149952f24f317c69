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
///
/// ```
/// use nalgebra::{UnitQuaternion, Vector2, Vector3};
/// use tangent_estimation::object_pose::OBJECT_ESTIMATORS;
/// use tangent_estimation::{
///     CameraFrame, CameraModel, Corner, ObjectPoseConfig, ObjectSample, build_object_estimator,
/// };
/// use tangent_mechanics::{Pose, Wrench};
/// use tangent_sensing::Validity;
///
/// // The flange looks down from 0.25 m on an object at the base's origin.
/// let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
/// let base_from_flange = Pose::new(Vector3::new(0.0, 0.0, 0.25), down);
/// let camera = CameraModel {
///     flange_from_camera: Pose::identity(),
///     focal_px: 400.0,
///     principal_px: Vector2::new(320.0, 240.0),
///     pixel_m: 2e-5,
/// };
/// let base_from_camera = base_from_flange * camera.flange_from_camera;
/// let config = ObjectPoseConfig::default();
/// for name in OBJECT_ESTIMATORS {
///     let mut estimator = build_object_estimator(name, &config, &camera)?;
///     let mut step = |sequence: u32| {
///         let time_s = 0.02 * f64::from(sequence);
///         let corners = config.target.corners().map(|corner| {
///             let pixel_px = camera.project(&base_from_camera.inverse().transform_point(&corner));
///             pixel_px.map(|pixel_px| Corner { pixel_px })
///         });
///         estimator.update(&ObjectSample {
///             time_s,
///             base_from_flange,
///             base_from_tool: base_from_flange * Pose::identity(),
///             wrench: Wrench::zero(),
///             wrench_delay_s: 0.0,
///             wrench_validity: Validity::Valid,
///             wrench_bias_age_s: None,
///             frame: Some(CameraFrame { time_s, sequence: u64::from(sequence), corners }),
///         })
///     };
///     for sequence in 0..50 {
///         step(sequence);
///     }
///     let estimate = step(50);
///     assert_eq!(estimate.validity, Validity::Valid, "{name}");
///     assert!(estimate.base_from_object.translation().norm() < 1e-3, "{name}");
/// }
/// # Ok::<(), tangent_estimation::EstimationError>(())
/// ```
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
