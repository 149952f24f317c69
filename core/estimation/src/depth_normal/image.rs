//! A depth image and the pinhole camera model that belongs to it.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// A pinhole camera without distortion. Pixel coordinates (0, 0) are the middle of the upper left
/// pixel, as in `sensor_msgs/CameraInfo`.
///
/// ```
/// use nalgebra::Vector3;
/// use tangent_estimation::depth_normal::Intrinsics;
///
/// let camera = Intrinsics { fx_px: 400.0, fy_px: 400.0, cx_px: 320.0, cy_px: 240.0 };
/// assert_eq!(camera.ray(360.0, 240.0), [0.1, 0.0]);
/// assert_eq!(camera.project(&Vector3::new(0.05, 0.0, 0.5)), Some([360.0, 240.0]));
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Intrinsics {
    /// Focal length along a row, pixels.
    pub fx_px: f64,
    /// Focal length along a column, pixels.
    pub fy_px: f64,
    /// Principal point along a row, pixels.
    pub cx_px: f64,
    /// Principal point along a column, pixels.
    pub cy_px: f64,
}

impl Intrinsics {
    /// Intrinsics with these focal lengths and this principal point, pixels, along rows and
    /// columns.
    pub fn new([fx_px, fy_px]: [f64; 2], [cx_px, cy_px]: [f64; 2]) -> Self {
        Self {
            fx_px,
            fy_px,
            cx_px,
            cy_px,
        }
    }

    /// `[x/z, y/z]` of a pixel's ray.
    pub fn ray(&self, u_px: f64, v_px: f64) -> [f64; 2] {
        [
            (u_px - self.cx_px) / self.fx_px,
            (v_px - self.cy_px) / self.fy_px,
        ]
    }

    /// Pixel of a point (camera axes, m); `None` for a point that is not in front of the camera.
    pub fn project(&self, point: &Vector3<f64>) -> Option<[f64; 2]> {
        (point.z > 1e-6).then(|| {
            [
                self.cx_px + self.fx_px * point.x / point.z,
                self.cy_px + self.fy_px * point.y / point.z,
            ]
        })
    }

    /// Whether all values are finite and the focal lengths positive.
    pub fn is_sound(&self) -> bool {
        let focal = [self.fx_px, self.fy_px];
        focal.iter().all(|f| f.is_finite() && *f > 1e-3)
            && self.cx_px.is_finite()
            && self.cy_px.is_finite()
    }
}

/// A borrowed depth image, row by row.
///
/// ```
/// use tangent_estimation::depth_normal::DepthImage;
///
/// let depth_m = [0.30, 0.31, 0.32, 0.33, 0.34, 0.35];
/// let image = DepthImage::new(3, 2, &depth_m).unwrap();
/// assert_eq!(image.row(1), [0.33, 0.34, 0.35]);
/// assert!(DepthImage::new(4, 2, &depth_m).is_none());
/// ```
#[derive(Clone, Copy, Debug)]
pub struct DepthImage<'a> {
    width: usize,
    height: usize,
    depth_m: &'a [f32],
}

impl<'a> DepthImage<'a> {
    /// `depth_m` is along the optical axis, m; 0, negative values and NaN mean no reading. `None`
    /// if the size does not match the data.
    pub fn new(width: usize, height: usize, depth_m: &'a [f32]) -> Option<Self> {
        (width > 0 && height > 0 && width.checked_mul(height) == Some(depth_m.len())).then_some(
            Self {
                width,
                height,
                depth_m,
            },
        )
    }

    /// Pixels along a row.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Number of rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// All depths, row by row, m.
    pub fn depth_m(&self) -> &'a [f32] {
        self.depth_m
    }

    /// Depths of one row, m.
    pub fn row(&self, v: usize) -> &'a [f32] {
        &self.depth_m[v * self.width..(v + 1) * self.width]
    }
}
