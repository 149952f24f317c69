//! `[camera]`: the camera on the wrist, the source of its images and what is detected in them.

use std::path::PathBuf;

use serde::Deserialize;
use tangent_mechanics::{Camera, Flange, Pose};
use tangent_schemas::standard::CameraInfo;

use super::PoseConfig;
use crate::config::check::Checker;
use crate::config::load::ConfigError;

/// Content of a camera's images.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CameraKind {
    /// Grey values or colours, in which the corners of the target are detected.
    #[default]
    Target,
    /// Depth, which is passed on to `depth_normal`.
    Depth,
}

/// Focal length, pixels: one value for square pixels, or one along the rows and one along the
/// columns.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(untagged)]
pub enum Focal {
    /// One focal length for both directions, pixels.
    Square(f64),
    /// fx along the rows and fy along the columns.
    Each([f64; 2]),
}

impl Focal {
    /// fx and fy, pixels.
    pub fn each(self) -> [f64; 2] {
        match self {
            Self::Square(f) => [f, f],
            Self::Each(f) => f,
        }
    }
}

/// Calibration of a camera without distortion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Calibration {
    /// Width and height of an image, pixels.
    pub size_px: [u32; 2],
    /// fx and fy, pixels.
    pub focal_px: [f64; 2],
    /// Principal point, pixels.
    pub principal_px: [f64; 2],
}

impl std::fmt::Display for Calibration {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "size_px = {:?}, focal_px = {:.1?}, principal_px = {:.1?}",
            self.size_px, self.focal_px, self.principal_px
        )
    }
}

impl Calibration {
    /// Calibration from a driver's message; `None` if the message states that there is none, or is
    /// not valid.
    pub fn of(info: &CameraInfo) -> Option<Self> {
        let [fx, _, cx, _, fy, cy, ..] = info.k;
        let known = fx > 0.0 && fy > 0.0 && info.k.iter().all(|x| x.is_finite());
        (known && info.width > 0 && info.height > 0).then_some(Self {
            size_px: [info.width, info.height],
            focal_px: [fx, fy],
            principal_px: [cx, cy],
        })
    }

    /// Describes a difference from `other` by more than `share` of the focal length; `None` if
    /// there is none.
    pub fn differs(&self, other: &Self, share: f64) -> Option<String> {
        if self.size_px != other.size_px {
            let (own, its) = (self.size_px, other.size_px);
            return Some(format!("size_px = {own:?} against {its:?}"));
        }
        [
            ("focal_px", self.focal_px, other.focal_px),
            ("principal_px", self.principal_px, other.principal_px),
        ]
        .into_iter()
        .find(|(_, own, its)| (0..2).any(|i| (own[i] - its[i]).abs() > share * self.focal_px[i]))
        .map(|(name, own, its)| format!("{name} = {own:.1?} against {its:.1?}"))
    }
}

/// `[camera]`. A cell without one has no camera.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraConfig {
    /// Key of the images, `sensor_msgs/msg/Image`: the simulator's, or a ROS 2 camera's behind a
    /// bridge.
    #[serde(default = "simulated")]
    pub topic: String,
    /// A recording (MCAP) whose images are played on `topic` in place of a driver's images.
    #[serde(default)]
    pub recording: Option<PathBuf>,
    /// Topic of the images in the recording; `None`: the first topic that has images.
    #[serde(default)]
    pub recording_topic: Option<String>,
    /// Content of the images.
    #[serde(default)]
    pub kind: CameraKind,
    /// Key of the driver's calibration, `sensor_msgs/msg/CameraInfo`; `None`: only the values given
    /// here are used.
    #[serde(default)]
    pub info_topic: Option<String>,
    /// Width and height of an image, pixels. Images of another size are refused. Give this and the
    /// next two keys all together, or leave out all three for depth with an `info_topic`.
    #[serde(default)]
    pub size_px: Option<[u32; 2]>,
    /// Focal length of the calibration, pixels.
    #[serde(default)]
    pub focal_px: Option<Focal>,
    /// Principal point of the calibration, pixels.
    #[serde(default)]
    pub principal_px: Option<[f64; 2]>,
    /// Edge of a pixel on the sensor, m; the published filter works in metres on the image plane.
    #[serde(default = "pixel")]
    pub pixel_m: f64,
    /// Optical centre on the flange, z forward, x to the right and y down in the image.
    pub flange_from_camera: PoseConfig,
    /// Rate of the images that are passed on for viewers and recordings, Hz; 0: none.
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
    /// Pose of the camera on the flange.
    pub fn flange_from_camera(&self) -> Pose<Flange, Camera> {
        self.flange_from_camera.pose()
    }

    /// Calibration in the file; `None` if the driver's is used.
    pub fn calibration(&self) -> Option<Calibration> {
        Some(Calibration {
            size_px: self.size_px?,
            focal_px: self.focal_px?.each(),
            principal_px: self.principal_px?,
        })
    }

    pub(in crate::config) fn check(&self, checker: &Checker<'_>) -> Result<(), ConfigError> {
        let topics = [
            ("camera.topic", Some(&self.topic)),
            ("camera.info_topic", self.info_topic.as_ref()),
        ];
        for (key, topic) in topics {
            let topic = topic.map_or("simulator/image", String::as_str);
            checker.require(
                !topic.is_empty()
                    && !topic.starts_with('/')
                    && !topic.contains(['*', '$', '?', '#']),
                key,
                topic,
                "a key without wildcards and without a leading slash, as in \"simulator/image\"",
            )?;
        }
        match self.calibration() {
            Some(calibration) => {
                for size in calibration.size_px {
                    checker.range("camera.size_px", f64::from(size), 16.0..=8192.0, "pixels")?;
                }
                checker.ranges(
                    "camera.focal_px",
                    &calibration.focal_px,
                    10.0..=1e5,
                    "pixels",
                )?;
                checker.ranges(
                    "camera.principal_px",
                    &calibration.principal_px,
                    -8192.0..=16384.0,
                    "pixels",
                )?;
            }
            None => self.check_drivers_word(checker)?,
        }
        checker.range("camera.pixel_m", self.pixel_m, 1e-7..=1e-3, "m")?;
        checker.range("camera.pass_on_hz", self.pass_on_hz, 0.0..=1000.0, "Hz")?;
        self.flange_from_camera
            .check(checker, "camera.flange_from_camera")
    }

    /// Checks a camera whose calibration is not in the file.
    fn check_drivers_word(&self, checker: &Checker<'_>) -> Result<(), ConfigError> {
        let given = [
            ("camera.size_px", self.size_px.is_some()),
            ("camera.focal_px", self.focal_px.is_some()),
            ("camera.principal_px", self.principal_px.is_some()),
        ];
        let from_driver = self.kind == CameraKind::Depth && self.info_topic.is_some();
        for (key, is_given) in given {
            checker.require(
                is_given || (from_driver && given.iter().all(|(_, is_given)| !is_given)),
                key,
                "nothing",
                "size_px, focal_px and principal_px; with kind = \"depth\" and an info_topic also none of the three",
            )?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use crate::config::{CellConfig, testing};

    fn cell(camera: &str) -> Result<CellConfig, String> {
        testing::cell(&format!(
            "[camera]\nflange_from_camera = {{ translation_m = [0.07, 0.0, -0.03] }}\n{camera}"
        ))
    }

    #[test]
    fn pixels_are_square_or_not() {
        for (focal, each) in [
            ("400.0", [400.0, 400.0]),
            ("[423.6, 424.1]", [423.6, 424.1]),
        ] {
            let given =
                format!("size_px = [848, 480]\nfocal_px = {focal}\nprincipal_px = [424.0, 240.0]");
            let camera = cell(&given).unwrap().camera.unwrap();
            assert_eq!(camera.calibration().unwrap().focal_px, each);
        }
    }

    #[test]
    fn what_a_calibration_lacks_is_named() {
        let driver = "kind = \"depth\"\ninfo_topic = \"camera/depth/camera_info\"\n";
        let camera = cell(driver).unwrap().camera.unwrap();
        assert_eq!(camera.calibration(), None);
        for (given, key) in [
            ("", "camera.size_px"),
            ("kind = \"depth\"", "camera.size_px"),
            ("info_topic = \"camera/info_raw\"", "camera.size_px"),
            (
                "size_px = [848, 480]\nfocal_px = 424.0",
                "camera.principal_px",
            ),
            (
                "size_px = [848, 480]\nfocal_px = [424.0, 1.0]\nprincipal_px = [0.0, 0.0]",
                "camera.focal_px",
            ),
            (&format!("{driver}size_px = [848, 480]"), "camera.focal_px"),
            (
                "kind = \"depth\"\ninfo_topic = \"/camera/info\"",
                "camera.info_topic",
            ),
        ] {
            let error = cell(given).unwrap_err();
            assert!(error.contains(key), "{given}: {error}");
        }
    }
}
