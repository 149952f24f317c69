//! Parameters of `hybrid_dynamics`, with the presets `paper` and `default`.

mod ranges;

use serde::{Deserialize, Serialize};

use crate::leaving::config::LeaveConfig;
use crate::parameters::presets::Presets;
use crate::parameters::{FrictionConfig, PathProfileConfig, PatienceConfig};

/// All parameters of the law.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct HybridDynamicsConfig {
    /// Motion control, eq. (31).
    pub motion: MotionGains,
    /// Force control, eq. (32).
    pub force: ForceGains,
    /// Known friction of the joints.
    pub friction: FrictionConfig,
    /// What the model of that friction may miss, and how it is estimated.
    pub friction_doubt: FrictionDoubtConfig,
    /// Whether friction is compensated at the reference's joint speeds instead of the measured
    /// ones: friction then still damps deviations.
    pub friction_at_reference: bool,
    /// How the pose in use follows the estimated pose.
    pub estimate: EstimateUseConfig,
    /// Detection of contact and of its loss.
    pub touch: TouchConfig,
    /// Acceleration, jerk and clock of the path.
    pub path: PathProfileConfig,
    /// Timeouts of missing and of invalid input.
    pub patience: PatienceConfig,
    /// How the tool leaves a surface, and how it is shown to be free.
    pub leave: LeaveConfig,
}

/// Gains of the resolved acceleration, eq. (31).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MotionGains {
    /// K_Pr of positions, 1/s².
    pub position_per_s2: f64,
    /// K_Dr of positions, 1/s.
    pub position_damping_per_s: f64,
    /// K_Pr of orientation, 1/s².
    pub orientation_per_s2: f64,
    /// K_Dr of orientation, 1/s.
    pub orientation_damping_per_s: f64,
    /// Integral of both errors, 1/s³, against model errors; 0: none, as published.
    pub integral_per_s3: f64,
}

/// How a force error acts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ForceChannel {
    /// Added to the torques along the constraint, as published: an error also moves the
    /// unconstrained directions.
    Torque,
    /// The measured force is subtracted completely from the torques, and its error becomes an
    /// acceleration along the normal alone.
    Acceleration,
}

/// Force control along the normal, eq. (32).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ForceGains {
    /// How a force error acts.
    pub channel: ForceChannel,
    /// k_Iλ, 1/s.
    pub integral_per_s: f64,
    /// Acceleration per newton of error, 1/kg; only in the acceleration channel.
    pub error_per_kg: f64,
    /// Damping of the motion along the normal, 1/s; the published law has none.
    pub damping_per_s: f64,
    /// Bound of the integral, N.
    pub integral_max_n: f64,
    /// How fast the reference rises from the force at touchdown, N/s.
    pub reference_rate_n_per_s: f64,
}

/// Joint friction that its model misses.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FrictionDoubtConfig {
    /// Share of the modelled friction by which the true one may differ. Within it, the difference
    /// is estimated and compensated; 0: none.
    pub share: f64,
    /// Bandwidth of that estimate, 1/s.
    pub observer_per_s: f64,
}

/// How the pose in use follows the estimated pose.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EstimateUseConfig {
    /// The pose in use follows the estimate as a critically damped system of this time constant, s;
    /// 0: at once.
    pub follow_s: f64,
    /// Maximum speed of the pose in use, m/s.
    pub speed_max_m_per_s: f64,
    /// Maximum angular speed of the pose in use, rad/s.
    pub turn_rate_max_rad_per_s: f64,
    /// The approach ends slowly within this many standard deviations of the estimated surface; 0:
    /// at the surface itself.
    pub slow_within_sd: f64,
}

/// Detection of contact and of its loss.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TouchConfig {
    /// Force above which contact is detected, N.
    pub on_n: f64,
    /// Force below which contact is no longer detected, N.
    pub off_n: f64,
    /// Time below `off_n` after which contact counts as lost, s.
    pub lost_s: f64,
    /// Number of losses after which the task ends.
    pub lost_count_max: u32,
    /// Speed towards a surface that is lost, or not at its estimated distance, m/s.
    pub seek_speed_m_per_s: f64,
    /// Distance beyond the estimated surface at which the approach gives up, m.
    pub seek_distance_max_m: f64,
    /// Minimum time between touchdown and path, s.
    pub settle_s: f64,
    /// Radius of the circle that the tool slides after touchdown if the estimate's normal is
    /// uncertain, m; 0: none.
    pub explore_radius_m: f64,
    /// Standard deviation of the normal above which that circle is slid, rad.
    pub explore_above_rad: f64,
}

impl Default for HybridDynamicsConfig {
    fn default() -> Self {
        Self {
            motion: MotionGains::default(),
            force: ForceGains::default(),
            friction: FrictionConfig::default(),
            friction_doubt: FrictionDoubtConfig::default(),
            friction_at_reference: true,
            estimate: EstimateUseConfig::default(),
            touch: TouchConfig::default(),
            path: PathProfileConfig::default(),
            patience: PatienceConfig {
                // Two periods of the sensor and the filter's own last sample.
                wrench_jitter_s: 0.002,
                ..PatienceConfig::default()
            },
            leave: LeaveConfig::default(),
        }
    }
}

impl Default for MotionGains {
    fn default() -> Self {
        Self {
            position_per_s2: 2500.0,
            position_damping_per_s: 100.0,
            orientation_per_s2: 1600.0,
            orientation_damping_per_s: 80.0,
            integral_per_s3: 4000.0,
        }
    }
}

impl Default for ForceGains {
    fn default() -> Self {
        Self {
            channel: ForceChannel::Acceleration,
            integral_per_s: 12.0,
            error_per_kg: 0.1,
            damping_per_s: 65.0,
            integral_max_n: 20.0,
            reference_rate_n_per_s: 40.0,
        }
    }
}

impl Default for FrictionDoubtConfig {
    fn default() -> Self {
        Self {
            share: 0.5,
            observer_per_s: 100.0,
        }
    }
}

impl Default for EstimateUseConfig {
    fn default() -> Self {
        Self {
            follow_s: 0.05,
            speed_max_m_per_s: 0.05,
            turn_rate_max_rad_per_s: 0.3,
            slow_within_sd: 2.5,
        }
    }
}

impl Default for TouchConfig {
    fn default() -> Self {
        Self {
            on_n: 1.0,
            off_n: 0.4,
            lost_s: 0.003,
            lost_count_max: 30,
            seek_speed_m_per_s: 0.01,
            seek_distance_max_m: 0.05,
            settle_s: 2.0,
            explore_radius_m: 0.01,
            explore_above_rad: 0.006,
        }
    }
}

impl Presets for HybridDynamicsConfig {
    /// Section V: K_Pr 250 and 15, K_Dr 220 and 10, k_Iλ 0.05.
    fn paper() -> Self {
        let default = Self::default();
        Self {
            motion: MotionGains {
                position_per_s2: 250.0,
                position_damping_per_s: 220.0,
                orientation_per_s2: 15.0,
                orientation_damping_per_s: 10.0,
                integral_per_s3: 0.0,
            },
            force: ForceGains {
                channel: ForceChannel::Torque,
                integral_per_s: 0.05,
                error_per_kg: 0.0,
                damping_per_s: 0.0,
                // In effect a step: the published law has no ramp.
                reference_rate_n_per_s: 1e5,
                ..default.force
            },
            friction_doubt: FrictionDoubtConfig {
                share: 0.0,
                ..default.friction_doubt
            },
            // At the measured speed, compensation would remove the last damping along the normal:
            // on an elastic plane m s³ + k s + k k_I has no stable roots.
            estimate: EstimateUseConfig {
                follow_s: 0.0,
                slow_within_sd: 0.0,
                ..default.estimate
            },
            // The published law bounces and recovers by itself.
            touch: TouchConfig {
                lost_s: 0.5,
                explore_radius_m: 0.0,
                ..default.touch
            },
            ..default
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::parameters::law_config::LawConfig;

    #[test]
    fn presets_are_in_range_and_the_paper_is_section_v() {
        for name in HybridDynamicsConfig::PRESETS {
            HybridDynamicsConfig::preset(name).unwrap().check().unwrap();
        }
        let paper = HybridDynamicsConfig::preset("paper").unwrap();
        assert_eq!(paper.motion.position_per_s2, 250.0);
        assert_eq!(paper.motion.position_damping_per_s, 220.0);
        assert_eq!(paper.motion.orientation_per_s2, 15.0);
        assert_eq!(paper.motion.orientation_damping_per_s, 10.0);
        assert_eq!(paper.force.integral_per_s, 0.05);
        assert_eq!(paper.force.damping_per_s, 0.0);
        assert_eq!(paper.touch.settle_s, 2.0);
        let error = HybridDynamicsConfig::preset("best").unwrap_err();
        assert!(error.to_string().contains("best"));
    }
}
