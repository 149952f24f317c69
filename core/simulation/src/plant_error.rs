//! Why a plant cannot be built.

use tangent_mechanics::{InverseKinematicsError, ModelError};

use crate::surfaces::SurfaceError;

/// Why a plant cannot be built.
#[derive(Debug, thiserror::Error)]
pub enum PlantError {
    /// The arm model is unknown or not usable.
    #[error("plant.robot: {0}")]
    Robot(#[from] ModelError),
    /// The surface is not usable.
    #[error(transparent)]
    Surface(#[from] SurfaceError),
    /// The tool cannot be brought to its start pose.
    #[error(transparent)]
    Start(#[from] StartError),
    /// The detector of the target's corners cannot be made.
    #[error("plant.camera: {0}")]
    Camera(#[from] tangent_sensing::TargetDetectorError),
    /// A setting of the depth camera is out of its range.
    #[error("plant.{0}")]
    DepthCamera(#[from] crate::sensors::depth_camera::DepthCameraError),
    /// The simulated depth camera sees a surface that stands in the base.
    #[error(
        "plant.depth_camera: leave it out, or leave out plant.base: the simulated camera cannot look from a base that moves"
    )]
    CameraOnPlatform,
    /// A setting of the estimator that reads the depth images is out of its range.
    #[error("plant.{0}")]
    DepthNormal(#[from] tangent_estimation::EstimationError),
    /// A number is out of its range.
    #[error("plant: `{key}` is {value}, but must be {allowed}")]
    Value {
        /// Dotted key under `plant`.
        key: &'static str,
        /// Value given.
        value: f64,
        /// Allowed range.
        allowed: &'static str,
    },
}

impl PlantError {
    /// Fails unless `ok` and the value is finite.
    pub(crate) fn unless(
        key: &'static str,
        value: f64,
        allowed: &'static str,
        ok: bool,
    ) -> Result<(), Self> {
        if ok && value.is_finite() {
            Ok(())
        } else {
            Err(Self::Value {
                key,
                value,
                allowed,
            })
        }
    }
}

/// The start pose is out of reach.
#[derive(Debug, thiserror::Error)]
#[error(
    "start: no joint positions bring the tool to ({x:.3}, {y:.3}, {z:.3}) m over the surface ({source}); move the surface or `start.near_m`, or give `start.seed_rad` nearer to a solution"
)]
pub struct StartError {
    /// x of the tool's origin, base axes, m.
    pub x: f64,
    /// y of the tool's origin, base axes, m.
    pub y: f64,
    /// z of the tool's origin, base axes, m.
    pub z: f64,
    /// Error of the inverse kinematics.
    pub source: InverseKinematicsError,
}
