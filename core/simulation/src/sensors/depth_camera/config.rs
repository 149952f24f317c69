//! Settings of the simulated depth camera, based on the data sheet of a stereo camera like the
//! D435i.

use serde::{Deserialize, Serialize};
use tangent_estimation::depth_normal::Intrinsics;

use crate::pose_config::PoseConfig;

/// The `[plant.depth_camera]` table.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DepthCameraConfig {
    /// Frames per second; 0 for no camera.
    pub rate_hz: f64,
    /// Time from exposure to arrival, s: uniformly distributed over this range, drawn for each
    /// frame.
    pub delay_s: [f64; 2],
    /// Stated pose of the optical centre of the left imager; z forward, x right, y down in the
    /// image.
    pub flange_from_camera: PoseConfig,
    /// Largest error of the camera's position along each axis of the flange, m; drawn with the
    /// seed.
    pub position_error_m: f64,
    /// Largest error of the camera's orientation about each axis of the flange, rad; drawn with the
    /// seed.
    pub orientation_error_rad: f64,
    /// Width and height of the whole image, pixels.
    pub image_px: [usize; 2],
    /// Focal length of the whole image, pixels.
    pub focal_px: f64,
    /// Principal point of the whole image, pixels, counted from the centre of the upper left pixel.
    /// The default is the centre of the image.
    pub principal_px: Option<[f64; 2]>,
    /// Part of the image that is rendered and sent: left, top, width, height in pixels. The default
    /// is the whole image.
    pub region_px: Option<[usize; 4]>,
    /// Only every `decimation`-th pixel along either axis is rendered and sent.
    pub decimation: usize,
    /// Nearest and furthest depth that the camera reads, m.
    pub range_m: [f64; 2],
    /// Box in the surface's axes outside which there is no material: lower and upper corner, m.
    /// Unbounded if absent.
    pub extent_m: Option<[[f64; 3]; 2]>,
    /// Height of the table around the surface above the base's origin, m. If absent, there is
    /// nothing behind the surface.
    pub table_height_m: Option<f64>,
    /// The tool in the camera's view.
    pub tool: Option<ToolInViewConfig>,
    /// Errors of the depth.
    pub noise: DepthNoiseConfig,
}

/// A rod along the tool's z axis with its end at the contact point.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ToolInViewConfig {
    /// Radius, m.
    pub radius_m: f64,
    /// Length, m.
    pub length_m: f64,
}

/// The `[plant.depth_camera.noise]` table.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DepthNoiseConfig {
    /// Standard deviation of depth at 0.5 m, m; it grows with the square of the depth.
    pub sd_at_half_metre_m: f64,
    /// Standard deviation of the correlated error of depth at 0.5 m, m; 0 for none. It grows with
    /// the square of the depth and is what a larger patch or more frames do not average out.
    pub correlated_at_half_metre_m: f64,
    /// Distance in the image over which that error is correlated, pixels of the images sent.
    pub correlation_px: f64,
    /// Time over which it is correlated, s.
    pub correlation_s: f64,
    /// Share of each neighbour's noise that a pixel includes (the stereo matcher compares blocks),
    /// 0 to 0.25.
    pub neighbour_share: f64,
    /// Distance between the two imagers, m.
    pub baseline_m: f64,
    /// Number of steps per pixel of disparity; 0 for continuous disparity.
    pub disparity_steps: u32,
    /// Share of pixels lost individually.
    pub lost_share: f64,
    /// Mean number of round holes per frame.
    pub holes_per_frame: f64,
    /// Largest radius of a hole, pixels.
    pub hole_radius_px: f64,
    /// Angle between ray and normal beyond which pixels begin to be lost, rad.
    pub grazing_from_rad: f64,
    /// Angle between ray and normal beyond which all pixels are lost, rad.
    pub grazing_to_rad: f64,
    /// Share of the pixels at an edge whose depth lies between foreground and background.
    pub flying_share: f64,
    /// Whether the strip beside near objects that the right imager cannot see is left out.
    pub stereo_shadow: bool,
}

impl Default for DepthCameraConfig {
    fn default() -> Self {
        Self {
            rate_hz: 30.0,
            delay_s: [0.03, 0.06],
            flange_from_camera: PoseConfig::default(),
            position_error_m: 0.0,
            orientation_error_rad: 0.0,
            image_px: [640, 480],
            focal_px: 385.0,
            principal_px: None,
            region_px: None,
            decimation: 1,
            range_m: [0.1, 3.0],
            extent_m: None,
            table_height_m: None,
            tool: None,
            noise: DepthNoiseConfig::default(),
        }
    }
}

impl Default for DepthNoiseConfig {
    fn default() -> Self {
        Self {
            sd_at_half_metre_m: 0.0015,
            correlated_at_half_metre_m: 0.0,
            correlation_px: 20.0,
            correlation_s: 0.5,
            neighbour_share: 0.05,
            baseline_m: 0.05,
            disparity_steps: 32,
            lost_share: 0.002,
            holes_per_frame: 6.0,
            hole_radius_px: 8.0,
            grazing_from_rad: 1.2,
            grazing_to_rad: 1.45,
            flying_share: 0.5,
            stereo_shadow: true,
        }
    }
}

impl DepthNoiseConfig {
    /// A camera whose only error is the rounding of its output to millimetres.
    pub fn none() -> Self {
        Self {
            sd_at_half_metre_m: 0.0,
            neighbour_share: 0.0,
            disparity_steps: 0,
            lost_share: 0.0,
            holes_per_frame: 0.0,
            grazing_from_rad: 1.57,
            grazing_to_rad: 1.58,
            flying_share: 0.0,
            stereo_shadow: false,
            ..Self::default()
        }
    }
}

/// Error in the settings of a depth camera.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum DepthCameraError {
    /// A setting is out of its range.
    #[error("depth_camera: {key} = {value} is out of range: {lower} to {upper} is allowed")]
    OutOfRange {
        /// Dotted key.
        key: &'static str,
        /// Value given.
        value: f64,
        /// Smallest value allowed.
        lower: f64,
        /// Largest value allowed.
        upper: f64,
    },
    /// The region reaches beyond the image.
    #[error(
        "depth_camera: region_px = {region:?} does not lie in the image of {width} x {height} pixels"
    )]
    Region {
        /// Region given.
        region: [usize; 4],
        /// Width of the image, pixels.
        width: usize,
        /// Height of the image, pixels.
        height: usize,
    },
    /// The box is empty.
    #[error(
        "depth_camera: extent_m must be a lower corner, then an upper one; axis {axis} goes from {from} to {to}"
    )]
    Extent {
        /// Axis, 0 to 2.
        axis: usize,
        /// Lower bound given, m.
        from: f64,
        /// Upper bound given, m.
        to: f64,
    },
}

impl DepthCameraConfig {
    /// # Errors
    /// Names the setting, its value and what is allowed.
    pub fn check(&self) -> Result<(), DepthCameraError> {
        let n = &self.noise;
        let [width, height] = self.image_px;
        let size = 1e4;
        let mut rows = vec![
            ("rate_hz", self.rate_hz, 0.0, 1000.0),
            ("delay_s[0]", self.delay_s[0], 0.0, 1.0),
            ("delay_s[1]", self.delay_s[1], self.delay_s[0], 1.0),
            ("position_error_m", self.position_error_m, 0.0, 0.1),
            (
                "orientation_error_rad",
                self.orientation_error_rad,
                0.0,
                0.3,
            ),
            ("image_px[0]", width as f64, 1.0, size),
            ("image_px[1]", height as f64, 1.0, size),
            ("focal_px", self.focal_px, 1.0, size),
            ("decimation", self.decimation as f64, 1.0, 64.0),
            ("range_m[0]", self.range_m[0], 0.01, 65.0),
            ("range_m[1]", self.range_m[1], self.range_m[0], 65.0),
            ("noise.sd_at_half_metre_m", n.sd_at_half_metre_m, 0.0, 0.1),
            (
                "noise.correlated_at_half_metre_m",
                n.correlated_at_half_metre_m,
                0.0,
                0.1,
            ),
            ("noise.correlation_px", n.correlation_px, 0.1, size),
            ("noise.correlation_s", n.correlation_s, 0.001, 1e6),
            ("noise.neighbour_share", n.neighbour_share, 0.0, 0.25),
            ("noise.baseline_m", n.baseline_m, 1e-3, 1.0),
            (
                "noise.disparity_steps",
                f64::from(n.disparity_steps),
                0.0,
                1024.0,
            ),
            ("noise.lost_share", n.lost_share, 0.0, 1.0),
            ("noise.holes_per_frame", n.holes_per_frame, 0.0, 1000.0),
            ("noise.hole_radius_px", n.hole_radius_px, 0.0, 1000.0),
            ("noise.grazing_from_rad", n.grazing_from_rad, 0.0, 1.58),
            (
                "noise.grazing_to_rad",
                n.grazing_to_rad,
                n.grazing_from_rad,
                1.59,
            ),
            ("noise.flying_share", n.flying_share, 0.0, 1.0),
        ];
        if let Some(tool) = &self.tool {
            rows.push(("tool.radius_m", tool.radius_m, 1e-4, 1.0));
            rows.push(("tool.length_m", tool.length_m, 1e-4, 2.0));
        }
        if let Some([u, v]) = self.principal_px {
            rows.push(("principal_px[0]", u, -size, size));
            rows.push(("principal_px[1]", v, -size, size));
        }
        if let Some(height_m) = self.table_height_m {
            rows.push(("table_height_m", height_m, -10.0, 10.0));
        }
        for (key, value, lower, upper) in rows {
            // Tests for "inside", so that NaN fails too.
            let inside = value >= lower && value <= upper;
            if !inside {
                return Err(DepthCameraError::OutOfRange {
                    key,
                    value,
                    lower,
                    upper,
                });
            }
        }
        if let Some(region) = self.region_px {
            let [left, top, w, h] = region;
            if w == 0 || h == 0 || left + w > width || top + h > height {
                return Err(DepthCameraError::Region {
                    region,
                    width,
                    height,
                });
            }
        }
        if let Some([lower, upper]) = self.extent_m {
            for axis in 0..3 {
                let (from, to) = (lower[axis], upper[axis]);
                let some = from < to;
                if !some {
                    return Err(DepthCameraError::Extent { axis, from, to });
                }
            }
        }
        Ok(())
    }

    /// Left, top, width and height of the part that is sent, in pixels of the whole image.
    pub fn region(&self) -> [usize; 4] {
        self.region_px
            .unwrap_or([0, 0, self.image_px[0], self.image_px[1]])
    }

    /// Width and height of the images sent, pixels.
    pub fn sent_px(&self) -> [usize; 2] {
        let [_, _, width, height] = self.region();
        [
            width.div_ceil(self.decimation),
            height.div_ceil(self.decimation),
        ]
    }

    /// Intrinsics of the images sent.
    pub fn intrinsics(&self) -> Intrinsics {
        let middle = self.image_px.map(|n| (n as f64 - 1.0) / 2.0);
        let [cx, cy] = self.principal_px.unwrap_or(middle);
        let [left, top, ..] = self.region();
        let every = self.decimation as f64;
        Intrinsics {
            fx_px: self.focal_px / every,
            fy_px: self.focal_px / every,
            cx_px: (cx - left as f64) / every,
            cy_px: (cy - top as f64) / every,
        }
    }
}
