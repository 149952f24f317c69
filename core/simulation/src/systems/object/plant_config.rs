//! The `[plant]` table of an object-pose scenario: the parts of the torque-controlled cell.

use serde::{Deserialize, Serialize};

use crate::arms::torque_arm::TorqueArmConfig;
use crate::contact::ContactConfig;
use crate::hardware_errors::{ErrorRanges, TorqueErrors};
use crate::plant_error::PlantError;
use crate::sensors::camera::CameraConfig;
use crate::sensors::force_torque::SensorConfig;
use crate::start::StartConfig;
use crate::stated::StatedCell;
use crate::surfaces::SurfaceConfig;
use crate::tool::ToolConfig;

/// The `[plant]` table of an object-pose scenario.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObjectPlantConfig {
    /// Built-in arm model with six or seven joints.
    #[serde(default = "default_robot")]
    pub robot: String,
    /// Torque control, friction, encoders.
    #[serde(default)]
    pub arm: TorqueArmConfig,
    /// The object's surface and its pose without load: `base_from_object` is `base_from_surface`.
    pub surface: SurfaceConfig,
    /// Motion of the object.
    #[serde(default)]
    pub object: ObjectMotionConfig,
    /// Stick, and payload of the sensor. A pad without rings is a point; the stick is rigid.
    #[serde(default)]
    pub tool: ToolConfig,
    /// Stiffness of the object, and friction.
    #[serde(default)]
    pub contact: ContactConfig,
    /// Force/torque sensor.
    #[serde(default)]
    pub sensor: SensorConfig,
    /// Camera on the flange.
    #[serde(default)]
    pub camera: CameraConfig,
    /// Start pose of the arm.
    pub start: StartConfig,
    /// What the plant does differently from what the other tables state.
    #[serde(default)]
    pub errors: TorqueErrors,
    /// Ranges from which further errors are drawn with the seed.
    #[serde(default)]
    pub errors_drawn: ErrorRanges,
}

impl ObjectPlantConfig {
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

/// Motion and deflection of the object.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ObjectMotionConfig {
    /// Constant velocity of the object's origin, base axes, m/s.
    pub velocity_m_per_s: [f64; 3],
    /// Constant angular velocity, base axes, rad/s.
    pub turn_rate_rad_per_s: [f64; 3],
    /// If true, the whole object deflects along the normal under load, and the camera sees it (the
    /// paper's elastic law). Otherwise only the spot under the tool deflects.
    pub yields: bool,
}

impl Default for ObjectMotionConfig {
    fn default() -> Self {
        Self {
            velocity_m_per_s: [0.0; 3],
            turn_rate_rad_per_s: [0.0; 3],
            yields: true,
        }
    }
}

fn default_robot() -> String {
    "smart3s_substitute".to_owned()
}

/// Checks that every number is in its range.
pub(crate) fn check(config: &ObjectPlantConfig) -> Result<(), PlantError> {
    let value = PlantError::unless;
    let camera = &config.camera;
    config.arm.check()?;
    value(
        "tool.compliance",
        1.0,
        "absent: the stick is rigid",
        config.tool.compliance.is_none(),
    )?;
    config.contact.check_stiffness()?;
    config.sensor.check()?;
    config.errors.check()?;
    config.errors_drawn.check()?;
    value(
        "camera.rate_hz",
        camera.rate_hz,
        "0 to 500",
        (0.0..=500.0).contains(&camera.rate_hz),
    )?;
    value(
        "camera.delay_s",
        camera.delay_s,
        "0 to 0.2",
        (0.0..=0.2).contains(&camera.delay_s),
    )?;
    value(
        "camera.focal_px",
        camera.focal_px,
        "10 to 100000",
        (10.0..=1e5).contains(&camera.focal_px),
    )?;
    value(
        "camera.pixel_m",
        camera.pixel_m,
        "1e-7 to 1e-3",
        (1e-7..=1e-3).contains(&camera.pixel_m),
    )?;
    for size in camera.image_px {
        value(
            "camera.image_px",
            size,
            "16 to 8192",
            (16.0..=8192.0).contains(&size),
        )?;
    }
    for (key, x, max) in [
        ("camera.image.blur_px", camera.image.blur_px, 20.0),
        ("camera.image.noise_grey", camera.image.noise_grey, 100.0),
        ("camera.noise_px", camera.noise_px, 100.0),
        (
            "camera.intrinsic_error_share",
            camera.intrinsic_error_share,
            0.5,
        ),
        ("camera.position_error_m", camera.position_error_m, 1.0),
        (
            "camera.orientation_error_rad",
            camera.orientation_error_rad,
            1.0,
        ),
    ] {
        value(key, x, "0 or above, and small", (0.0..=max).contains(&x))?;
    }
    Ok(())
}
