//! `[base]`: how the pose of a moving base is judged.

use serde::{Deserialize, Serialize};

use crate::SensingError;

/// `[base]` of a cell or scenario. Whether the base moves is not configured: it does where `base/pose` is published.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BaseConfig {
    /// The base is a mobile platform: no task runs without `base/pose`. False: without it, the base stands.
    pub required: bool,
    /// From a pose's stamp to its publication on the platform, s, as far as it is known. An unknown latency leaves the path
    /// behind by that time; the force does not see it while the velocity is steady.
    pub latency_s: f64,
    /// Silence after which the base is unknown, s.
    pub patience_s: f64,
    /// Bandwidth of the filter that makes velocity out of poses, rad/s.
    pub filter_rad_per_s: f64,
    /// Poses must have been steady for so long to be worked with, s.
    pub settle_s: f64,
    /// A step between two poses beyond the motion by more than this is a jump, m.
    pub jump_m: f64,
    /// The same of the orientation, rad.
    pub jump_rad: f64,
    /// A pose with a larger standard deviation on one of its axes is refused, m.
    pub position_sd_max_m: f64,
    /// The same of the orientation, rad.
    pub orientation_sd_max_rad: f64,
    /// Faster, and no tool is kept on a surface, m/s.
    pub speed_max_m_per_s: f64,
    /// The same of its turning, rad/s.
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
    /// Names the key, the value and what is allowed.
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
