//! Settings of the estimators of an object's pose.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::{CORNERS, ObjectShape, PlanarTarget};
use crate::EstimationError;

/// Which measurements are used.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Measurements {
    /// Camera only: the paper's first simulation.
    Vision,
    /// Camera, force and joints: its second.
    #[default]
    All,
}

/// The target and the surface that carries it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TargetConfig {
    /// The surface, φ = 0 in object axes.
    pub surface: ObjectShape,
    /// Corners, counter-clockwise seen from outside, coplanar; object axes, m.
    pub corners_m: [[f64; 3]; CORNERS],
}

impl Default for TargetConfig {
    /// The paper's square of 10 cm on a plane.
    fn default() -> Self {
        Self {
            surface: ObjectShape::Plane,
            corners_m: [
                [-0.05, -0.05, 0.0],
                [0.05, -0.05, 0.0],
                [0.05, 0.05, 0.0],
                [-0.05, 0.05, 0.0],
            ],
        }
    }
}

impl TargetConfig {
    /// The corners as vectors, m.
    pub fn corners(&self) -> [Vector3<f64>; CORNERS] {
        self.corners_m.map(Vector3::from)
    }
}

/// What is believed before anything is seen.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PriorConfig {
    /// Error of the camera's position per axis, standard deviation, m: ±1 cm evenly is 5.8 mm.
    pub camera_position_sd_m: f64,
    /// Error of its orientation per axis, rad: ±3° evenly is 30 mrad.
    pub camera_orientation_sd_rad: f64,
    /// Error of the focal length, share.
    pub focal_sd_share: f64,
    /// Error of the principal point per axis, share of the focal length.
    pub principal_sd_share: f64,
    /// The object's compliance along its normal, m/N.
    pub compliance_m_per_n: f64,
    /// The same, standard deviation.
    pub compliance_sd_m_per_n: f64,
    /// The object's speed, per axis, m/s.
    pub speed_sd_m_per_s: f64,
    /// The object's angular speed, per axis, rad/s.
    pub turn_rate_sd_rad_per_s: f64,
    /// How the object's speed may change, m/s/√s.
    pub speed_change_m_per_s_per_sqrt_s: f64,
    /// The same of its angular speed, rad/s/√s.
    pub turn_rate_change_rad_per_s_per_sqrt_s: f64,
}

impl Default for PriorConfig {
    fn default() -> Self {
        Self {
            camera_position_sd_m: 0.0058,
            camera_orientation_sd_rad: 0.030,
            focal_sd_share: 0.0173,
            principal_sd_share: 0.014,
            compliance_m_per_n: 0.0,
            compliance_sd_m_per_n: 2e-4,
            speed_sd_m_per_s: 1e-4,
            turn_rate_sd_rad_per_s: 1e-4,
            speed_change_m_per_s_per_sqrt_s: 2e-5,
            turn_rate_change_rad_per_s_per_sqrt_s: 2e-5,
        }
    }
}

/// Noise of what touching tells.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ContactNoiseConfig {
    /// Pressing force above which the tool touches, N.
    pub force_on_n: f64,
    /// Pressing force below which it does not, N.
    pub force_off_n: f64,
    /// Time between two looks at the force and the joints, s.
    pub period_s: f64,
    /// Error of a force component, N: noise and zero.
    pub force_sd_n: f64,
    /// Error of the force's direction beyond that, rad.
    pub direction_sd_rad: f64,
    /// Friction coefficient that cannot be excluded: tilts the force along the sliding, or anywhere at rest.
    pub friction_sd: f64,
    /// Error of the tip's position, m.
    pub tip_sd_m: f64,
}

impl Default for ContactNoiseConfig {
    fn default() -> Self {
        Self {
            force_on_n: 1.5,
            force_off_n: 0.5,
            period_s: 0.01,
            force_sd_n: 0.1,
            direction_sd_rad: 0.001,
            friction_sd: 0.0,
            tip_sd_m: 1e-4,
        }
    }
}

/// The `[estimation]` table of an object scenario.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ObjectPoseConfig {
    /// What is looked at and touched.
    pub target: TargetConfig,
    /// What is used.
    pub measurements: Measurements,
    /// Noise of a corner along each image axis, pixels.
    pub corner_sd_px: f64,
    /// Weight of the second-order term that the linear model leaves out; above 1 because it does not change from frame to frame.
    pub curvature_weight: f64,
    /// Corners further than this many standard deviations from where they are expected are refused.
    pub gate_sd: f64,
    /// Root mean square left of the first frame, pixels: above, it is not the target.
    pub start_rms_max_px: f64,
    /// Frames refused in a row, without contact, after which the estimate is given up and begun anew.
    pub restart_frames: u32,
    /// Without a frame for longer than this, the estimate is stale, s.
    pub vision_patience_s: f64,
    /// Beliefs at the start.
    pub prior: PriorConfig,
    /// Touch.
    pub contact: ContactNoiseConfig,
}

impl Default for ObjectPoseConfig {
    fn default() -> Self {
        Self {
            target: TargetConfig::default(),
            measurements: Measurements::All,
            corner_sd_px: 0.3,
            curvature_weight: 4.0,
            gate_sd: 4.5,
            start_rms_max_px: 8.0,
            restart_frames: 25,
            vision_patience_s: 0.1,
            prior: PriorConfig::default(),
            contact: ContactNoiseConfig::default(),
        }
    }
}

impl ObjectPoseConfig {
    /// # Errors
    /// Names the setting that is out of its range.
    pub fn check(&self) -> Result<(), EstimationError> {
        let within = |key, value: f64, lower, upper| {
            if value >= lower && value <= upper {
                Ok(())
            } else {
                Err(EstimationError::OutOfRange {
                    key,
                    value,
                    lower,
                    upper,
                })
            }
        };
        let (p, c) = (&self.prior, &self.contact);
        for (key, value, lower, upper) in [
            ("corner_sd_px", self.corner_sd_px, 1e-3, 100.0),
            ("curvature_weight", self.curvature_weight, 0.0, 1000.0),
            ("gate_sd", self.gate_sd, 1.0, 1000.0),
            ("start_rms_max_px", self.start_rms_max_px, 0.01, 1000.0),
            ("vision_patience_s", self.vision_patience_s, 0.01, 3600.0),
            (
                "prior.camera_position_sd_m",
                p.camera_position_sd_m,
                0.0,
                1.0,
            ),
            (
                "prior.camera_orientation_sd_rad",
                p.camera_orientation_sd_rad,
                0.0,
                1.0,
            ),
            ("prior.focal_sd_share", p.focal_sd_share, 0.0, 0.5),
            ("prior.principal_sd_share", p.principal_sd_share, 0.0, 0.5),
            ("prior.compliance_m_per_n", p.compliance_m_per_n, 0.0, 0.1),
            (
                "prior.compliance_sd_m_per_n",
                p.compliance_sd_m_per_n,
                0.0,
                0.1,
            ),
            ("prior.speed_sd_m_per_s", p.speed_sd_m_per_s, 0.0, 10.0),
            (
                "prior.turn_rate_sd_rad_per_s",
                p.turn_rate_sd_rad_per_s,
                0.0,
                10.0,
            ),
            (
                "prior.speed_change_m_per_s_per_sqrt_s",
                p.speed_change_m_per_s_per_sqrt_s,
                0.0,
                10.0,
            ),
            (
                "prior.turn_rate_change_rad_per_s_per_sqrt_s",
                p.turn_rate_change_rad_per_s_per_sqrt_s,
                0.0,
                10.0,
            ),
            ("contact.force_on_n", c.force_on_n, 1e-3, 1000.0),
            ("contact.force_off_n", c.force_off_n, 1e-4, c.force_on_n),
            ("contact.period_s", c.period_s, 0.0, 1.0),
            ("contact.force_sd_n", c.force_sd_n, 1e-6, 100.0),
            ("contact.direction_sd_rad", c.direction_sd_rad, 1e-6, 1.0),
            ("contact.friction_sd", c.friction_sd, 0.0, 2.0),
            ("contact.tip_sd_m", c.tip_sd_m, 1e-6, 0.1),
        ] {
            within(key, value, lower, upper)?;
        }
        let radius = match self.target.surface {
            ObjectShape::Plane => 1.0,
            ObjectShape::Cylinder { radius_m } | ObjectShape::Sphere { radius_m } => radius_m,
        };
        within("target.surface.radius_m", radius, 1e-3, 100.0)?;
        if PlanarTarget::new(&self.target.corners()).is_none() {
            return Err(EstimationError::CollinearCorners);
        }
        Ok(())
    }
}
