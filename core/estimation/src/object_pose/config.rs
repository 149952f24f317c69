//! Settings of the estimators of an object's pose.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::{CORNERS, ObjectShape, PlanarTarget};
use crate::EstimationError;
use crate::ranges::check_ranges;

/// Which measurements are used.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Measurements {
    /// Camera only: the paper's first simulation.
    Vision,
    /// Camera, force and joints: the paper's second simulation.
    #[default]
    All,
}

/// The visual target, and the surface that it is on.
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
            surface: ObjectShape::Plane {},
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

/// Uncertainty before the first measurement.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PriorConfig {
    /// Error of the camera's position per axis, standard deviation, m. A uniform ±1 cm is 5.8 mm.
    pub camera_position_sd_m: f64,
    /// Error of the camera's orientation per axis, standard deviation, rad. A uniform ±3° is 30
    /// mrad.
    pub camera_orientation_sd_rad: f64,
    /// Error of the focal length, standard deviation, as a share of it.
    pub focal_sd_share: f64,
    /// Error of the principal point per axis, standard deviation, share of the focal length.
    pub principal_sd_share: f64,
    /// Compliance of the object along its normal, m/N.
    pub compliance_m_per_n: f64,
    /// Standard deviation of the compliance of the whole object along its normal, m/N.
    pub compliance_sd_m_per_n: f64,
    /// Standard deviation of the compliance of the spot under the tip, m/N. The camera does not see
    /// this part of the give.
    pub local_compliance_sd_m_per_n: f64,
    /// Error of the tip's stated position on the flange, standard deviation per axis, m.
    pub tip_sd_m: f64,
    /// Error of the arm's measured flange position in the base, standard deviation per axis, m. It
    /// is common to all measurements and is not observable: it is part of the covariance alone.
    pub arm_position_sd_m: f64,
    /// Error of the arm's measured flange orientation in the base, standard deviation per axis,
    /// rad.
    pub arm_turn_sd_rad: f64,
    /// Constant tilt of the measured force about each of the tool's x and y axes, standard
    /// deviation, rad: rotation of the sensor on the flange, and zero error over force.
    pub force_tilt_sd_rad: f64,
    /// Standard deviation of the object's speed, per axis, m/s.
    pub speed_sd_m_per_s: f64,
    /// Standard deviation of the object's angular speed, per axis, rad/s.
    pub turn_rate_sd_rad_per_s: f64,
    /// Random walk of the object's speed, m/s/√s.
    pub speed_change_m_per_s_per_sqrt_s: f64,
    /// Random walk of the object's angular speed, rad/s/√s.
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
            local_compliance_sd_m_per_n: 2e-4,
            tip_sd_m: 0.0,
            arm_position_sd_m: 0.0,
            arm_turn_sd_rad: 0.0,
            force_tilt_sd_rad: 0.0,
            speed_sd_m_per_s: 1e-4,
            turn_rate_sd_rad_per_s: 1e-4,
            speed_change_m_per_s_per_sqrt_s: 2e-5,
            turn_rate_change_rad_per_s_per_sqrt_s: 2e-5,
        }
    }
}

/// Noise of the measurements by contact.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ContactNoiseConfig {
    /// Pressing force above which the tool is in contact, N.
    pub force_on_n: f64,
    /// Pressing force below which contact is lost, N.
    pub force_off_n: f64,
    /// Time between two updates from force and joints, s.
    pub period_s: f64,
    /// Error of a force component, standard deviation, N: noise and zero.
    pub force_sd_n: f64,
    /// Further error of the force's direction, standard deviation, rad.
    pub direction_sd_rad: f64,
    /// Standard deviation of the unknown friction coefficient. Friction tilts the force along the
    /// sliding direction, or in any tangential direction at rest.
    pub friction_sd: f64,
    /// Error of the tip's position, standard deviation, m.
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
    /// The visual target, and the surface that it is on.
    pub target: TargetConfig,
    /// Which measurements are used.
    pub measurements: Measurements,
    /// Noise of a corner along each image axis, standard deviation, pixels.
    pub corner_sd_px: f64,
    /// Weight of the second-order term that the linear model neglects. It is above 1 because this
    /// error does not change from frame to frame.
    pub curvature_weight: f64,
    /// Corners further than this many standard deviations from their prediction are rejected.
    pub gate_sd: f64,
    /// Largest root mean square residual of the first frame, pixels. Above it, the image does not
    /// show the target.
    pub start_rms_max_px: f64,
    /// Number of rejected frames in a row, without contact, after which the estimate is discarded
    /// and started again.
    pub restart_frames: u32,
    /// Time without a frame after which the estimate is stale, s.
    pub vision_patience_s: f64,
    /// Uncertainty before the first measurement.
    pub prior: PriorConfig,
    /// Contact thresholds, and noise of the measurements by contact.
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
    /// A setting is out of its range; the error names it.
    pub fn check(&self) -> Result<(), EstimationError> {
        let (p, c) = (&self.prior, &self.contact);
        let radius = match self.target.surface {
            ObjectShape::Plane {} => 1.0,
            ObjectShape::Cylinder { radius_m } | ObjectShape::Sphere { radius_m } => radius_m,
        };
        check_ranges(&[
            ("corner_sd_px", self.corner_sd_px, 1e-3, 100.0),
            ("curvature_weight", self.curvature_weight, 0.0, 1000.0),
            ("gate_sd", self.gate_sd, 1.0, 1000.0),
            ("start_rms_max_px", self.start_rms_max_px, 0.01, 1000.0),
            ("vision_patience_s", self.vision_patience_s, 0.01, 3600.0),
            // With 0, every rejected frame would discard a good estimate.
            ("restart_frames", f64::from(self.restart_frames), 1.0, 1e6),
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
            (
                "prior.local_compliance_sd_m_per_n",
                p.local_compliance_sd_m_per_n,
                0.0,
                0.1,
            ),
            ("prior.tip_sd_m", p.tip_sd_m, 0.0, 0.1),
            ("prior.arm_position_sd_m", p.arm_position_sd_m, 0.0, 0.1),
            ("prior.arm_turn_sd_rad", p.arm_turn_sd_rad, 0.0, 0.1),
            ("prior.force_tilt_sd_rad", p.force_tilt_sd_rad, 0.0, 1.0),
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
            ("target.surface.radius_m", radius, 1e-3, 100.0),
        ])?;
        if PlanarTarget::new(&self.target.corners()).is_none() {
            return Err(EstimationError::CollinearCorners);
        }
        Ok(())
    }
}
