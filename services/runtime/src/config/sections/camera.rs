//! `[camera]`: the camera on the wrist, where its images come from and what is found in them.

use std::path::PathBuf;

use serde::Deserialize;
use tangent_mechanics::{Camera, Flange, Pose};

use super::PoseConfig;
use crate::config::check::Checker;
use crate::config::load::ConfigError;

/// What a camera's images show.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CameraKind {
    /// Grey values or colours, in which the target's corners are looked for.
    #[default]
    Target,
    /// Depth, passed on to `depth_normal`.
    Depth,
}

/// `[camera]`. A cell without one has no camera.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraConfig {
    /// Key of the images, `sensor_msgs/msg/Image`: the simulator's, or a ROS 2 camera's behind a bridge.
    #[serde(default = "simulated")]
    pub topic: String,
    /// A recording (MCAP) whose images are played on `topic` in place of a driver's.
    #[serde(default)]
    pub recording: Option<PathBuf>,
    /// Topic of the images in it; none: the first that has some.
    #[serde(default)]
    pub recording_topic: Option<String>,
    /// What its images show.
    #[serde(default)]
    pub kind: CameraKind,
    /// Width and height of an image, pixels. Images of another size are refused.
    pub size_px: [u32; 2],
    /// Focal length of the calibration, pixels.
    pub focal_px: f64,
    /// Principal point of the calibration, pixels.
    pub principal_px: [f64; 2],
    /// Edge of a pixel on the sensor, m; the published filter works in metres on the image plane.
    #[serde(default = "pixel")]
    pub pixel_m: f64,
    /// Optical centre on the flange, z forward, x to the right and y down in the image.
    pub flange_from_camera: PoseConfig,
    /// Images passed on for viewers and recordings, per second; 0: none.
    #[serde(default = "pass_on")]
    pub pass_on_hz: f64,
}

fn simulated() -> String {
    "simulator/image".to_owned()
}

fn pixel() -> f64 {
    8e-6
}

fn pass_on() -> f64 {
    5.0
}

impl CameraConfig {
    /// Where the camera is on the flange.
    pub fn flange_from_camera(&self) -> Pose<Flange, Camera> {
        self.flange_from_camera.pose()
    }

    pub(in crate::config) fn check(&self, checker: &Checker<'_>) -> Result<(), ConfigError> {
        let topic = &self.topic;
        checker.require(
            !topic.is_empty() && !topic.starts_with('/') && !topic.contains(['*', '$', '?', '#']),
            "camera.topic",
            topic,
            "a key without wildcards and without a leading slash, as in \"simulator/image\"",
        )?;
        for size in self.size_px {
            checker.range("camera.size_px", f64::from(size), 16.0..=8192.0, "pixels")?;
        }
        checker.range("camera.focal_px", self.focal_px, 10.0..=1e5, "pixels")?;
        checker.ranges(
            "camera.principal_px",
            &self.principal_px,
            -8192.0..=16384.0,
            "pixels",
        )?;
        checker.range("camera.pixel_m", self.pixel_m, 1e-7..=1e-3, "m")?;
        checker.range("camera.pass_on_hz", self.pass_on_hz, 0.0..=1000.0, "Hz")?;
        self.flange_from_camera
            .check(checker, "camera.flange_from_camera")
    }
}
