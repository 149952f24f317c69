//! The `[plant]` table of a visuo-tactile scenario: a torque-controlled arm without a force sensor,
//! a surface, a camera.

use serde::{Deserialize, Serialize};
use tangent_estimation::depth_normal::DepthNormalConfig;

use crate::depth_camera::DepthCameraConfig;
use crate::normal_camera::NormalCameraConfig;
use crate::plant_config::{ContactConfig, StartConfig, SurfaceConfig, ToolConfig};
use crate::plant_error::PlantError;
use crate::torque_arm::TorqueArmConfig;
use crate::wrench_estimate::ExternalWrenchConfig;

/// The `[plant]` table of a visuo-tactile scenario.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TactilePlantConfig {
    /// Built-in arm model with seven joints.
    #[serde(default = "default_robot")]
    pub robot: String,
    /// Torque control, friction, encoders.
    #[serde(default)]
    pub arm: TorqueArmConfig,
    /// The surface and where it stands.
    pub surface: SurfaceConfig,
    /// Pad and what hangs on the flange; there is no sensor, and the pad's softness is in
    /// `contact`.
    #[serde(default)]
    pub tool: ToolConfig,
    /// Stiffness of surface and pad in series, friction.
    #[serde(default)]
    pub contact: ContactConfig,
    /// What the robot makes of the torques in its joints.
    #[serde(default)]
    pub external_wrench: ExternalWrenchConfig,
    /// Where the camera's normals come from.
    #[serde(default)]
    pub normals_from: NormalSource,
    /// The camera of the source `features`.
    #[serde(default)]
    pub camera: NormalCameraConfig,
    /// The camera of the source `depth`.
    #[serde(default)]
    pub depth_camera: DepthCameraConfig,
    /// What reads its images.
    #[serde(default)]
    pub depth_normal: DepthNormalConfig,
    /// Where the arm stands at the start.
    pub start: StartConfig,
    /// What the seed changes about the start.
    #[serde(default)]
    pub start_spread: StartSpreadConfig,
}

/// Where the camera's normals come from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum NormalSource {
    /// The true normal with a camera's errors, rate and delay: fast.
    #[default]
    Features,
    /// Depth images are drawn and read.
    Depth,
}

/// What the seed changes about the start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct StartSpreadConfig {
    /// Largest change of the tilt, rad; its direction is then drawn from the whole circle.
    pub tilt_rad: f64,
    /// Largest change of the place along each axis, m.
    pub position_m: f64,
    /// Largest change of the gap, m.
    pub clearance_m: f64,
}

fn default_robot() -> String {
    "panda".to_owned()
}

/// Every number in its range.
pub(crate) fn check(config: &TactilePlantConfig) -> Result<(), PlantError> {
    let value = PlantError::unless;
    config.arm.check()?;
    value(
        "tool.compliance",
        1.0,
        "absent: it is part of contact.stiffness_n_per_m",
        config.tool.compliance.is_none(),
    )?;
    value(
        "contact.stiffness_n_per_m",
        config.contact.stiffness_n_per_m,
        "100 to 1000000 N/m",
        (100.0..=1e6).contains(&config.contact.stiffness_n_per_m),
    )?;
    let (spread, start) = (&config.start_spread, &config.start);
    value(
        "start_spread.tilt_rad",
        spread.tilt_rad,
        "0 to 0.5 rad",
        (0.0..=0.5).contains(&spread.tilt_rad),
    )?;
    value(
        "start_spread.position_m",
        spread.position_m,
        "0 to 0.1 m",
        (0.0..=0.1).contains(&spread.position_m),
    )?;
    value(
        "start_spread.clearance_m",
        spread.clearance_m,
        "0 to start.clearance_m",
        (0.0..=start.clearance_m).contains(&spread.clearance_m),
    )?;
    config.external_wrench.check()?;
    config.camera.check()
}
