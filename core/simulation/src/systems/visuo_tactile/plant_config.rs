//! The `[plant]` table of a visuo-tactile scenario: a torque-controlled arm without a force sensor,
//! a surface and a camera.

use serde::{Deserialize, Serialize};
use tangent_estimation::depth_normal::DepthNormalConfig;

use crate::arms::torque_arm::TorqueArmConfig;
use crate::contact::ContactConfig;
use crate::hardware_errors::{ErrorRanges, TorqueErrors};
use crate::plant_error::PlantError;
use crate::sensors::depth_camera::DepthCameraConfig;
use crate::sensors::normal_camera::NormalCameraConfig;
use crate::sensors::wrench_estimate::ExternalWrenchConfig;
use crate::start::StartConfig;
use crate::stated::StatedCell;
use crate::surfaces::SurfaceConfig;
use crate::tool::ToolConfig;

/// The `[plant]` table of a visuo-tactile scenario.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VisuoTactilePlantConfig {
    /// Built-in arm model with six or seven joints.
    #[serde(default = "default_robot")]
    pub robot: String,
    /// Torque control, friction, encoders.
    #[serde(default)]
    pub arm: TorqueArmConfig,
    /// The surface and its pose.
    pub surface: SurfaceConfig,
    /// Pad and payload of the flange. There is no sensor, and the pad's compliance is part of
    /// `contact`.
    #[serde(default)]
    pub tool: ToolConfig,
    /// Stiffness of surface and pad in series, and friction.
    #[serde(default)]
    pub contact: ContactConfig,
    /// The robot's own estimate of the external wrench.
    #[serde(default)]
    pub external_wrench: ExternalWrenchConfig,
    /// Source of the camera's normals.
    #[serde(default)]
    pub normals_from: NormalSource,
    /// Camera for the source `features`.
    #[serde(default)]
    pub camera: NormalCameraConfig,
    /// Camera for the source `depth`.
    #[serde(default)]
    pub depth_camera: DepthCameraConfig,
    /// Estimator that reads the depth camera's images.
    #[serde(default)]
    pub depth_normal: DepthNormalConfig,
    /// Start pose of the arm.
    pub start: StartConfig,
    /// Variation of the start pose by the seed.
    #[serde(default)]
    pub start_spread: StartSpreadConfig,
    /// What the plant does differently from what the other tables state.
    #[serde(default)]
    pub errors: TorqueErrors,
    /// Ranges from which further errors are drawn with the seed.
    #[serde(default)]
    pub errors_drawn: ErrorRanges,
}

impl VisuoTactilePlantConfig {
    /// The cell as its file states it.
    ///
    /// # Errors
    /// An unknown robot, or one with a number of joints other than `N`.
    pub fn stated<const N: usize>(&self) -> Result<StatedCell<N>, PlantError> {
        StatedCell::new(&self.robot, &self.tool, self.arm.delay_periods)
    }

    /// The configuration with the errors of `seed` drawn.
    pub(super) fn drawn(&self, joints: usize, seed: u64) -> Self {
        let mut config = self.clone();
        (config.errors, config.tool.payload_error) =
            self.errors_drawn
                .added(&self.errors, &self.tool.payload_error, joints, seed);
        config
    }
}

/// Source of the camera's normals.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum NormalSource {
    /// The true normal with a camera's errors, rate and delay: fast.
    #[default]
    Features,
    /// An estimate from rendered depth images.
    Depth,
}

/// Variation of the start pose by the seed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct StartSpreadConfig {
    /// Largest change of the tilt, rad. If not 0, the tilt's direction is drawn from the whole
    /// circle.
    pub tilt_rad: f64,
    /// Largest change of the position along each axis, m.
    pub position_m: f64,
    /// Largest change of the gap, m.
    pub clearance_m: f64,
}

fn default_robot() -> String {
    "panda".to_owned()
}

/// Checks that every number is in its range.
pub(crate) fn check(config: &VisuoTactilePlantConfig) -> Result<(), PlantError> {
    let value = PlantError::unless;
    config.arm.check()?;
    value(
        "tool.compliance",
        1.0,
        "absent: it is part of contact.stiffness_n_per_m",
        config.tool.compliance.is_none(),
    )?;
    config.contact.check_stiffness()?;
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
    config.errors.check()?;
    config.errors_drawn.check()?;
    config.camera.check()
}
