//! The `[plant]` table of an `admittance` scenario: a velocity-controlled arm on a surface whose
//! shape the law does not know.

use serde::{Deserialize, Serialize};

use crate::arms::platform::PlatformConfig;
use crate::arms::servo::ServoConfig;
use crate::contact::ContactConfig;
use crate::hardware_errors::HardwareErrors;
use crate::sensors::arm_force::ArmForceConfig;
use crate::sensors::depth_camera::DepthCameraConfig;
use crate::sensors::force_torque::SensorConfig;
use crate::start::StartConfig;
use crate::surfaces::SurfaceConfig;
use crate::tool::ToolConfig;

/// Configuration of the plant. It is stepped once per arm period.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AdmittancePlantConfig {
    /// Built-in arm model; `ur5` by default.
    #[serde(default = "default_robot")]
    pub robot: String,
    /// Velocity servo and encoders.
    #[serde(default)]
    pub arm: ServoConfig,
    /// Longest sub-step of contact, s.
    #[serde(default = "default_substep")]
    pub substep_max_s: f64,
    /// The surface and its pose.
    pub surface: SurfaceConfig,
    /// Pad, compliance and payload on the sensor.
    #[serde(default)]
    pub tool: ToolConfig,
    /// Normal force and friction.
    #[serde(default)]
    pub contact: ContactConfig,
    /// Force/torque sensor.
    #[serde(default)]
    pub sensor: SensorConfig,
    /// Force that the arm's own controller states.
    #[serde(default)]
    pub arm_force: ArmForceConfig,
    /// What the plant does differently from what the other tables state.
    #[serde(default)]
    pub errors: HardwareErrors,
    /// Start pose of the arm.
    pub start: StartConfig,
    /// The mobile platform under the arm; a fixed base when absent.
    #[serde(default)]
    pub base: Option<PlatformConfig>,
    /// A depth camera on the flange, whose images a live cell publishes. `evaluate` has no use for
    /// them. None when absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub depth_camera: Option<DepthCameraConfig>,
}

fn default_robot() -> String {
    "ur5".to_owned()
}

fn default_substep() -> f64 {
    0.001
}
