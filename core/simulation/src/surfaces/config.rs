//! A surface as configured: its shape, its dimensions and its pose.

use serde::{Deserialize, Serialize};

use super::height_field::HeightFieldError;
use crate::pose_config::PoseConfig;

/// The surface and its pose.
///
/// ```
/// use tangent_simulation::{ShapeConfig, SurfaceConfig};
///
/// let text = "shape = 'cylinder'\nradius_m = 0.25\nposition_m = [0.45, 0.0, 0.0]";
/// let pipe: SurfaceConfig = toml::from_str(text)?;
/// assert_eq!(pipe.shape, ShapeConfig::Cylinder { radius_m: 0.25 });
/// assert_eq!(pipe.roll_pitch_yaw_rad, [0.0; 3]);
/// # Ok::<(), toml::de::Error>(())
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SurfaceConfig {
    /// `base_from_surface`: origin, m.
    #[serde(default)]
    pub position_m: [f64; 3],
    /// `base_from_surface`: rotations about the fixed x, then y, then z axis, rad.
    #[serde(default)]
    pub roll_pitch_yaw_rad: [f64; 3],
    /// Shape and dimensions.
    #[serde(flatten)]
    pub shape: ShapeConfig,
}

impl SurfaceConfig {
    /// `base_from_surface`.
    pub fn pose(&self) -> PoseConfig {
        PoseConfig {
            position_m: self.position_m,
            roll_pitch_yaw_rad: self.roll_pitch_yaw_rad,
        }
    }
}

/// Shape and dimensions; the tagged form of the `[plant.surface]` table.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "shape", rename_all = "snake_case", deny_unknown_fields)]
pub enum ShapeConfig {
    /// Half space below `z = 0`. With braces, so that unknown keys are refused.
    Plane {},
    /// Infinite cylinder around the local z axis.
    Cylinder {
        /// Radius, m.
        radius_m: f64,
    },
    /// Cone around the local z axis with its base at `z = 0` and its tip at `z = height_m`.
    Cone {
        /// Height of the tip over the base, m.
        height_m: f64,
        /// Radius at `z = 0`, m.
        base_radius_m: f64,
    },
    /// Sphere around the origin.
    Sphere {
        /// Radius, m.
        radius_m: f64,
    },
    /// Ellipsoid around the origin.
    Ellipsoid {
        /// Semi-axes along x, y and z, m.
        semi_axes_m: [f64; 3],
    },
    /// A plate with its top at `z = 0` that ends at `x = 0`.
    Edge {
        /// Radius of the edge, m.
        edge_radius_m: f64,
    },
    /// `z = 0` before `x = 0`, `z = height_m` beyond.
    Step {
        /// Height, m; negative steps down.
        height_m: f64,
        /// Radius of the edge, m.
        edge_radius_m: f64,
    },
    /// A plane `z = 0` with a straight groove around `x = 0`: a seam, or a gap.
    Groove {
        /// Width, m.
        width_m: f64,
        /// Depth, m.
        depth_m: f64,
        /// Radius of the edges, m.
        edge_radius_m: f64,
    },
    /// Torus around the local z axis.
    Torus {
        /// Distance from the axis to the middle of the tube, m.
        major_radius_m: f64,
        /// Radius of the tube, m.
        minor_radius_m: f64,
    },
    /// `z = a_x sin(2 pi x / l_x) + a_y sin(2 pi y / l_y)`.
    Sheet {
        /// `[a_x, a_y]`, m.
        amplitude_m: [f64; 2],
        /// `[l_x, l_y]`, m.
        wavelength_m: [f64; 2],
    },
    /// `z = a sin(2 pi y / l + phase) + offset` over a rectangle around the origin, with vertical
    /// sides.
    Wave {
        /// `a`, m.
        amplitude_m: f64,
        /// `l`, m.
        wavelength_m: f64,
        /// Phase, rad.
        phase_rad: f64,
        /// Offset, m.
        offset_m: f64,
        /// Size along x and y, m.
        size_m: [f64; 2],
    },
    /// A table of heights, interpolated by a cubic spline.
    HeightField {
        /// The table as CSV text: first row `,x0,x1,…`, then `y0,z00,z01,…` (m). Either this or
        /// `csv_file`.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        csv: Option<String>,
        /// Name of a file with that text, read when the scenario is loaded.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        csv_file: Option<String>,
    },
}

/// Error in the shape or dimensions of a surface.
#[derive(Debug, thiserror::Error)]
pub enum SurfaceError {
    /// A dimension is not a positive, finite length.
    #[error("surface {shape}: `{key}` is {value}, but must be a positive length in metres{advice}")]
    Dimension {
        /// Name of the shape.
        shape: &'static str,
        /// Key of the dimension.
        key: &'static str,
        /// Value given.
        value: f64,
        /// Additional advice; may be empty.
        advice: &'static str,
    },
    /// The table of heights is malformed.
    #[error("surface height_field: {0}")]
    HeightField(#[from] HeightFieldError),
    /// The table of heights was not loaded.
    #[error(
        "surface height_field: give the table as `csv`, or load the file named in `csv_file` first"
    )]
    HeightFieldMissing,
}
