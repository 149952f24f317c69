//! `[base]`: how the poses of a moving base are checked and filtered.

use serde::{Deserialize, Serialize};

use crate::SensingError;

/// `[base]` of a cell or scenario. Whether the base moves is not configured: it moves if
/// `base/pose` is published.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BaseConfig {
    /// Whether the base is a mobile platform. If true, no task runs without `base/pose`. If false,
    /// the base counts as fixed until a pose is received.
    pub required: bool,
    /// Time from a pose's stamp to its publication by the platform, s, as far as it is known. A
    /// latency that is not stated here makes the path lag by that time. It does not affect the
    /// force while the velocity of the base is constant.
    pub latency_s: f64,
    /// Time without a pose after which the motion of the base counts as unknown, s.
    pub patience_s: f64,
    /// Bandwidth of the filter that estimates velocity from poses, rad/s.
    pub filter_rad_per_s: f64,
    /// Time for which the poses must have been steady before they are used, s.
    pub settle_s: f64,
    /// Largest deviation of the step between two poses from the estimated motion, m; a larger one
    /// is a jump.
    pub jump_m: f64,
    /// Largest deviation of the rotation between two poses from the estimated motion, rad; a larger
    /// one is a jump.
    pub jump_rad: f64,
    /// Largest standard deviation of a pose's position in any axis, m; a pose with a larger one is
    /// refused.
    pub position_sd_max_m: f64,
    /// Largest standard deviation of a pose's orientation in any axis, rad; a pose with a larger
    /// one is refused.
    pub orientation_sd_max_rad: f64,
    /// Largest speed of the base at which a tool is kept on a surface, m/s.
    pub speed_max_m_per_s: f64,
    /// Largest turn rate of the base at which a tool is kept on a surface, rad/s.
    pub turn_rate_max_rad_per_s: f64,
}

impl Default for BaseConfig {
    fn default() -> Self {
        Self {
            required: false,
            latency_s: 0.0,
            patience_s: 0.2,
            filter_rad_per_s: 8.0,
            settle_s: 0.5,
            jump_m: 0.002,
            jump_rad: 0.004,
            position_sd_max_m: 0.1,
            orientation_sd_max_rad: 0.1,
            speed_max_m_per_s: 0.06,
            turn_rate_max_rad_per_s: 0.1,
        }
    }
}

impl BaseConfig {
    /// # Errors
    /// A setting is out of its range. The error names the key, the value and the allowed range.
    pub fn check(&self) -> Result<(), SensingError> {
        let range = |key, value: f64, lower: f64, upper: f64| {
            SensingError::unless(
                (lower..=upper).contains(&value),
                key,
                value,
                format!("from {lower} to {upper}"),
            )
        };
        range("base.latency_s", self.latency_s, 0.0, 1.0)?;
        range("base.patience_s", self.patience_s, 0.02, 2.0)?;
        range("base.filter_rad_per_s", self.filter_rad_per_s, 0.5, 50.0)?;
        range("base.settle_s", self.settle_s, 0.0, 10.0)?;
        range("base.jump_m", self.jump_m, 1e-5, 1.0)?;
        range("base.jump_rad", self.jump_rad, 1e-5, 1.0)?;
        range("base.position_sd_max_m", self.position_sd_max_m, 1e-5, 10.0)?;
        range(
            "base.orientation_sd_max_rad",
            self.orientation_sd_max_rad,
            1e-5,
            10.0,
        )?;
        range("base.speed_max_m_per_s", self.speed_max_m_per_s, 1e-3, 0.5)?;
        range(
            "base.turn_rate_max_rad_per_s",
            self.turn_rate_max_rad_per_s,
            1e-3,
            1.0,
        )
    }
}
