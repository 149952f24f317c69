//! Parameters that several laws share, their ranges, and those that can be set while a task runs.

pub mod law_config;
pub mod live;
pub(crate) mod overlay;
pub mod presets;
pub(crate) mod ranges;

use serde::{Deserialize, Serialize};
use tangent_mechanics::JointFriction;

/// Path profile of a torque law, which follows the reference with its own gains and does not wait
/// for the arm. Its default is also that of the hybrid admittance.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PathProfileConfig {
    /// Acceleration along the path, m/s².
    pub acceleration_m_per_s2: f64,
    /// Jerk along the path, m/s³.
    pub jerk_m_per_s3: f64,
    /// Time in which the path's clock stops or reaches full speed on pause and resume, s.
    pub clock_ramp_s: f64,
}

impl Default for PathProfileConfig {
    fn default() -> Self {
        Self {
            acceleration_m_per_s2: 0.1,
            jerk_m_per_s3: 1.0,
            clock_ramp_s: 0.2,
        }
    }
}

/// Timeouts of missing and of invalid input.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PatienceConfig {
    /// Age of the wrench, in cycles, at which the arm stops.
    pub wrench_cycles: f64,
    /// Addition to that age for the jitter of unsynchronised clocks, s.
    pub wrench_jitter_s: f64,
    /// Number of consecutive cycles with an invalid wrench after which the arm stops.
    pub wrench_bad_cycles: u32,
    /// Time from the stop to the retraction if the wrench is only missing, s.
    pub wrench_retract_s: f64,
    /// Age of the estimate at which sliding stops, s.
    pub estimate_s: f64,
    /// Time from that stop to the retraction, s.
    pub estimate_retract_s: f64,
    /// Time without a known motion of a moving base until the retraction, s.
    pub base_retract_s: f64,
}

impl Default for PatienceConfig {
    fn default() -> Self {
        Self {
            wrench_cycles: 2.0,
            wrench_jitter_s: 0.004,
            wrench_bad_cycles: 2,
            wrench_retract_s: 0.1,
            estimate_s: 0.1,
            estimate_retract_s: 1.0,
            base_retract_s: 1.0,
        }
    }
}

/// Friction that the law compensates. One entry per joint, or one for all.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FrictionConfig {
    /// Viscous friction, Nm s/rad.
    pub viscous_nm_s_per_rad: Vec<f64>,
    /// Coulomb friction, Nm.
    pub coulomb_nm: Vec<f64>,
    /// Speed at which Coulomb friction has reached 71 %, rad/s.
    pub coulomb_speed_rad_per_s: f64,
}

impl FrictionConfig {
    /// Friction model of an arm with `N` joints.
    pub(crate) fn model<const N: usize>(&self) -> JointFriction<N> {
        JointFriction::from_lists(
            &self.viscous_nm_s_per_rad,
            &self.coulomb_nm,
            self.coulomb_speed_rad_per_s,
        )
    }
}

impl Default for FrictionConfig {
    fn default() -> Self {
        Self {
            viscous_nm_s_per_rad: vec![0.0],
            coulomb_nm: vec![0.0],
            coulomb_speed_rad_per_s: 0.01,
        }
    }
}
