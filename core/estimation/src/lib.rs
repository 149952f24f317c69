//! Surface-normal estimators, one file each: contact samples in, a normal with its covariance out.
//! Estimators of the pose of an object of known shape, from camera, force and joints.
//!
//! Called by the `estimator` service and by the closed loop of `evaluate`.

mod blend;
mod config;
mod contact_filter;
pub mod depth_normal;
mod error;
mod estimator;
mod gaussian_process;
mod gaussian_process_paper;
mod motion;
pub mod object_pose;
mod on_moving_base;
mod quadratic;
mod quadratic_paper;
mod ranges;
mod reactive;
mod reactive_paper;
mod registry;
mod tangent_frame;
mod world_estimator;

pub use config::{
    BlendConfig, ContactConfig, EstimatorConfig, GaussianProcessConfig, PaperConfig,
    QuadraticConfig, SensingConfig, SurfaceConfig,
};
pub use error::EstimationError;
pub use estimator::{ContactSample, NormalEstimate, NormalEstimator};
pub use object_pose::{
    CORNERS, CameraFrame, CameraModel, Corner, ObjectEstimate, ObjectPoseConfig,
    ObjectPoseEstimator, ObjectSample, build_object_estimator,
};
pub use registry::{build, estimator_names};
