//! The `[plant]` table of an object-pose scenario: what the torque-controlled cell is made of.

use serde::{Deserialize, Serialize};

use crate::camera::CameraConfig;
use crate::plant_config::{ContactConfig, SensorConfig, StartConfig, SurfaceConfig, ToolConfig};
use crate::plant_error::PlantError;
use crate::torque_arm::TorqueArmConfig;

/// The `[plant]` table of an object-pose scenario.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObjectPlantConfig {
    /// Built-in arm model with six joints.
    #[serde(default = "default_robot")]
    pub robot: String,
    /// Torque control, friction, encoders.
    #[serde(default)]
    pub arm: TorqueArmConfig,
    /// The object's surface and where it stands when nothing presses: `base_from_object` is
    /// `base_from_surface`.
    pub surface: SurfaceConfig,
    /// How the object moves.
    #[serde(default)]
    pub object: ObjectMotionConfig,
    /// Stick and what hangs on the sensor. A pad without rings is a point; the stick is rigid.
    #[serde(default)]
    pub tool: ToolConfig,
    /// Stiffness of the yielding object, friction.
    #[serde(default)]
    pub contact: ContactConfig,
    /// Force/torque sensor.
    #[serde(default)]
    pub sensor: SensorConfig,
    /// Camera on the flange.
    #[serde(default)]
    pub camera: CameraConfig,
    /// Where the arm stands at the start.
    pub start: StartConfig,
}

/// How the object moves and yields.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ObjectMotionConfig {
    /// Constant velocity of its origin, base axes, m/s.
    pub velocity_m_per_s: [f64; 3],
    /// Constant angular velocity, base axes, rad/s.
    pub turn_rate_rad_per_s: [f64; 3],
    /// Pressed, the whole object gives way along the normal and the camera sees it (the paper's
    /// elastic law); otherwise only the spot under the tool does.
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

/// Every number in its range.
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
    value(
        "contact.stiffness_n_per_m",
        config.contact.stiffness_n_per_m,
        "100 to 1000000 N/m",
        (100.0..=1e6).contains(&config.contact.stiffness_n_per_m),
    )?;
    if let Some((key, x, allowed)) = config.sensor.fault.and_then(|fault| fault.mistake()) {
        value(key, x, allowed, false)?;
    }
    value(
        "sensor.rate_hz",
        config.sensor.rate_hz,
        "125 to 7000",
        (125.0..=7000.0).contains(&config.sensor.rate_hz),
    )?;
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
