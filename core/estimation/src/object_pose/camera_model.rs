//! Model of a camera on the wrist and its output: the pinhole of eq. (7), and frames of labelled
//! corners.

use nalgebra::{Vector2, Vector3};
use tangent_mechanics::{Camera, Flange, Pose};

/// Number of corners of the target.
pub const CORNERS: usize = 4;

/// Smallest depth at which a point counts as in front of the camera, m.
const DEPTH_MIN_M: f64 = 0.01;

/// A pinhole camera fixed to the flange.
///
/// ```
/// use nalgebra::{Vector2, Vector3};
/// use tangent_estimation::CameraModel;
/// use tangent_mechanics::Pose;
///
/// let camera = CameraModel {
///     flange_from_camera: Pose::identity(),
///     focal_px: 400.0,
///     principal_px: Vector2::new(320.0, 240.0),
///     pixel_m: 2e-5,
/// };
/// let pixel_px = camera.project(&Vector3::new(0.05, 0.0, 0.5));
/// assert_eq!(pixel_px, Some(Vector2::new(360.0, 240.0)));
/// assert_eq!(camera.project(&Vector3::new(0.05, 0.0, -0.5)), None);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraModel {
    /// Pose of the camera: origin at the optical centre, z forward, x right, y down in the image.
    pub flange_from_camera: Pose<Flange, Camera>,
    /// Focal length, pixels.
    pub focal_px: f64,
    /// Principal point, pixels.
    pub principal_px: Vector2<f64>,
    /// Edge length of a pixel on the sensor, m.
    pub pixel_m: f64,
}

impl CameraModel {
    /// Pixel of a point (camera axes, m), eq. (7); `None` for a point that is not in front of the
    /// camera.
    pub fn project(&self, in_camera: &Vector3<f64>) -> Option<Vector2<f64>> {
        (in_camera.z > DEPTH_MIN_M)
            .then(|| self.principal_px + in_camera.xy() * (self.focal_px / in_camera.z))
    }

    /// Converts pixels to `[x/z, y/z]` with this calibration.
    pub fn normalised(&self, pixel_px: &Vector2<f64>) -> Vector2<f64> {
        (pixel_px - self.principal_px) / self.focal_px
    }

    /// The paper's focal length λ_c, m.
    pub fn focal_m(&self) -> f64 {
        self.focal_px * self.pixel_m
    }
}

/// One corner found in an image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Corner {
    /// Position in the image, pixels.
    pub pixel_px: Vector2<f64>,
}

/// The corners of one image, labelled: entry `i` belongs to the object's corner `i`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraFrame {
    /// Time of exposure, s, on the clock of the arm's state.
    pub time_s: f64,
    /// Number of the frame.
    pub sequence: u64,
    /// Corners found; `None` for a corner that was not found.
    pub corners: [Option<Corner>; CORNERS],
}
