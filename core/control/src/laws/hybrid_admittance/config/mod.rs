//! Parameters of the control law, and the two presets: `paper` (Tugal et al., Table 1) and
//! `default`.

mod ranges;

use serde::{Deserialize, Serialize};

use crate::contact::energy_tank::EnergyTank;
use crate::leaving::config::LeaveConfig;
use crate::parameters::presets::Presets;
use crate::parameters::{PathProfileConfig, PatienceConfig};

/// Parameters of the law. `ControllerConfig::preset` gives a complete set; a file may change single
/// keys of it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Default)]
#[serde(deny_unknown_fields, default)]
pub struct ControllerConfig {
    /// Force along the normal, eq. (1).
    pub force: ForceConfig,
    /// Torque about the tangential axes, eq. (1).
    pub torque: TorqueConfig,
    /// Alignment of the tool with the normal, eq. (4).
    pub alignment: AlignmentConfig,
    /// How the normal in use follows the estimates.
    pub normal: NormalConfig,
    /// How the tool follows the path.
    pub path: PathConfig,
    /// Speed of the path by the certainty of the normal, and the exploration before it.
    pub pace: PaceConfig,
    /// Detection of contact and of its loss.
    pub contact: ContactConfig,
    /// Timeouts of missing and of invalid input.
    pub patience: PatienceConfig,
    /// How the tool leaves a surface, and how it is shown to be free.
    pub leave: LeaveConfig,
}

/// Translational part of the admittance.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ForceConfig {
    /// Virtual mass `m_p`, kg.
    pub mass_kg: f64,
    /// Virtual damping `d_p`, Ns/m: the damping in use if not adaptive, the minimum if adaptive.
    pub damping_n_s_per_m: f64,
    /// Whether the damping follows the contact stiffness: `d = k * loop_delay / delay_margin`.
    pub adaptive: bool,
    /// Maximum adaptive damping, Ns/m.
    pub damping_max_n_s_per_m: f64,
    /// Delay from command to measured force, s: transport, servo, filter. In the configuration in
    /// effect, it is the mean of this setting and of the delay measured in free space.
    pub loop_delay_s: f64,
    /// Standard deviation of that delay, s; 0: the setting is used as it is, whatever is measured.
    pub loop_delay_sd_s: f64,
    /// Desired product of crossover frequency and delay, rad: 0.3 is well damped, above 1 rings.
    pub delay_margin_rad: f64,
    /// Stiffest contact expected, N/m: used until touchdown gives a measurement.
    pub stiffness_expected_n_per_m: f64,
    /// Accepted overshoot at touchdown on the expected stiffness, as a share of the reference;
    /// bounds the approach speed.
    pub overshoot_accepted: f64,
    /// Whether the approach is slowed for the expected stiffness.
    pub approach_slowed: bool,
    /// Integral over the force error, in multiples of the crossover's period; 0 is off.
    pub integral_ratio: f64,
    /// Maximum speed along the normal from the integral, m/s.
    pub integral_speed_max_m_per_s: f64,
    /// Maximum speed along the normal from the force law, m/s.
    pub speed_max_m_per_s: f64,
    /// Rate at which a changed reference takes effect, N/s.
    pub reference_rate_n_per_s: f64,
    /// Share of the reference by which it is lowered at most, for a moment, to see whether the
    /// reading still follows: a reading that has died looks like a surface that recedes. 0: never.
    pub probe_share: f64,
    /// Bounds the energy that a task may put into the surface along the normal, however long it
    /// lasts: covers a surface that yields without end, and a wrong normal. `None`: only
    /// `limits.power_max_w` applies.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tank: Option<EnergyTank>,
}

/// Rotational part of the admittance.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TorqueConfig {
    /// Virtual inertia `m_o`, kg m² (the paper prints kg).
    pub inertia_kg_m2: f64,
    /// Virtual damping `d_o`, Nms/rad (the paper prints Ns/m).
    pub damping_n_m_s_per_rad: f64,
    /// Maximum turn rate from the torque, rad/s.
    pub turn_rate_max_rad_per_s: f64,
}

/// Alignment of the tool with the surface normal.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct AlignmentConfig {
    /// Gain `k_R` of eq. (4), 1/s.
    pub gain_per_s: f64,
    /// Whether the surface's curvature times the tool's velocity is fed forward, so that the tool
    /// turns with the surface.
    pub feed_forward: bool,
    /// Whether the tool turns about the point where the force acts instead of about its origin.
    pub about_contact: bool,
    /// Maximum turn rate from the alignment, rad/s.
    pub turn_rate_max_rad_per_s: f64,
}

/// How the normal in use follows the estimates.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct NormalConfig {
    /// Time constant of the low-pass filter from the estimate to the normal in use, s; 0: no
    /// filter.
    pub filter_s: f64,
    /// Standard deviation per axis at which an estimate is filtered twice as long, rad; 0 treats
    /// all estimates equally.
    pub sure_rad: f64,
    /// Maximum turn rate of the normal in use, rad/s.
    pub turn_rate_max_rad_per_s: f64,
    /// Maximum turn of the normal in use beyond what the way along a surface explains, rad: further
    /// is a false force.
    pub turn_max_rad: f64,
    /// Maximum angle between an estimate and the normal in use, rad; estimates beyond it are
    /// rejected.
    pub gate_rad: f64,
    /// Maximum angle between a newly chosen estimator's normal and the normal in use, rad.
    pub switch_gate_rad: f64,
    /// Distance along the surface without a valid estimate before the next estimator is chosen, m.
    pub blind_distance_m: f64,
    /// Distance over which the surface's curvature is learnt from the rotation of the normal if the
    /// estimator gives none, m.
    pub curvature_distance_m: f64,
    /// Largest plausible curvature, 1/m.
    pub curvature_max_per_m: f64,
    /// Maximum angle by which an estimate is rotated to compensate its age along the path, using
    /// the surface's curvature, rad; 0: no compensation.
    pub prediction_max_rad: f64,
}

/// How the tool follows the path.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PathConfig {
    /// Gain of the position feedback in the tangent plane, 1/s; 0: the paper's velocity profile
    /// alone.
    pub gain_per_s: f64,
    /// Maximum speed from the feedback, m/s.
    pub feedback_speed_max_m_per_s: f64,
    /// Path error at which the path begins to wait for the arm, m; it stands still at twice that.
    pub wait_error_m: f64,
    /// Acceleration along the path, m/s².
    pub acceleration_m_per_s2: f64,
    /// Jerk along the path, m/s³.
    pub jerk_m_per_s3: f64,
    /// Time in which the path's clock stops or reaches full speed on pause and resume, s.
    pub clock_ramp_s: f64,
    /// Whether commands are those for where the tool will be when the arm makes them, one delay of
    /// the arm ahead, and not for where it is.
    pub delay_compensated: bool,
}

/// Speed of the path by the certainty of the normal, and the exploration before it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PaceConfig {
    /// Share of the reference that a force error from an unknown slope may take; 0.3 N if that is
    /// more, but no more than a third of the reference. It bounds the path's speed. 0: the path
    /// runs at its own speed however uncertain the normal is.
    pub slope_share: f64,
    /// Share of the force between the reference and `limits.force_max_n` that something in the way
    /// may take before the arm answers; it bounds the path's speed. 0: no bound.
    pub hit_share: f64,
    /// Force error, as a share of the reference, from which the path slows down; 0: never.
    pub force_share: f64,
    /// Force above its reference, as a share of it, from which the path slows down, to a fifth of
    /// its speed at the least; 0: never.
    pub excess_share: f64,
    /// Load along the surface, beyond 1.5 times the friction that the contact has shown, from which
    /// the path stops and the tool gives way, N; half of it, beyond 1.3 times that friction, slows
    /// the path. 0: never.
    pub side_least_n: f64,
    /// Length of the path over which the tool lifts where something stands in the way, m; 0: never.
    pub over_m: f64,
    /// Lowest speed because of an uncertain normal, m/s.
    pub speed_min_m_per_s: f64,
    /// Radius of the first circle of the exploration after a touch, m; 0: none.
    pub explore_radius_m: f64,
    /// Standard deviation of the normal in any direction above which the tool explores, rad.
    pub explore_above_rad: f64,
    /// Standard deviation of the normal in any direction above which the tool stops on its path and
    /// draws a circle of half that radius, rad; 0: never. Paths with lifts, a dose or learning have
    /// none.
    pub explore_again_rad: f64,
    /// Distance from a place where contact was lost again and again at which the tool touches the
    /// surface beside it, m; 0: never.
    pub hop_m: f64,
}

/// Detection of contact and of its loss.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ContactConfig {
    /// Pressing force above which contact is detected, as a share of the reference.
    pub touch_share: f64,
    /// Pressing force below which contact counts as lost, as a share of the reference.
    pub lost_share: f64,
    /// Lower bound of both thresholds, N: forces that noise and a payload error can produce.
    pub noise_n: f64,
    /// Time below the threshold after which contact counts as lost, s: a whole number of cycles,
    /// rounded.
    pub lost_s: f64,
    /// Number of contact losses after which the task ends: a bouncing loop does not recover by
    /// itself.
    pub lost_count_max: u32,
    /// Number of contact losses at one place after which the task ends: the surface ends there; 0:
    /// not judged.
    pub lost_here_max: u32,
    /// Distance into the surface after which the search for a lost surface ends, m, if
    /// `limits.blind_distance_max_m` is not shorter: a sensor that has died looks like a lost
    /// surface.
    pub seek_distance_max_m: f64,
    /// Force error that counts as settled, as a share of the reference.
    pub settled_share: f64,
    /// Time for which the force must stay settled before the path starts, s.
    pub settled_s: f64,
    /// Speed towards a lost surface, m/s.
    pub seek_speed_m_per_s: f64,
}

impl Default for ForceConfig {
    fn default() -> Self {
        Self {
            mass_kg: 1.0,
            damping_n_s_per_m: 150.0,
            adaptive: true,
            damping_max_n_s_per_m: 12_000.0,
            loop_delay_s: 0.04,
            loop_delay_sd_s: 0.0,
            delay_margin_rad: 0.45,
            stiffness_expected_n_per_m: 50_000.0,
            overshoot_accepted: 0.2,
            approach_slowed: true,
            integral_ratio: 3.0,
            integral_speed_max_m_per_s: 0.02,
            speed_max_m_per_s: 0.02,
            reference_rate_n_per_s: 8.0,
            probe_share: 0.5,
            tank: None,
        }
    }
}

impl Default for TorqueConfig {
    fn default() -> Self {
        Self {
            inertia_kg_m2: 0.04,
            damping_n_m_s_per_rad: 1.5,
            turn_rate_max_rad_per_s: 0.5,
        }
    }
}

impl Default for AlignmentConfig {
    fn default() -> Self {
        Self {
            gain_per_s: 4.0,
            feed_forward: true,
            about_contact: true,
            turn_rate_max_rad_per_s: 0.8,
        }
    }
}

impl Default for NormalConfig {
    fn default() -> Self {
        Self {
            filter_s: 0.06,
            sure_rad: 2f64.to_radians(),
            turn_rate_max_rad_per_s: 0.8,
            turn_max_rad: 0.65,
            gate_rad: 60f64.to_radians(),
            switch_gate_rad: 20f64.to_radians(),
            blind_distance_m: 0.03,
            curvature_distance_m: 0.015,
            curvature_max_per_m: 50.0,
            prediction_max_rad: 0.1,
        }
    }
}

impl Default for PathConfig {
    fn default() -> Self {
        let profile = PathProfileConfig::default();
        Self {
            gain_per_s: 2.0,
            feedback_speed_max_m_per_s: 0.02,
            wait_error_m: 0.005,
            acceleration_m_per_s2: profile.acceleration_m_per_s2,
            jerk_m_per_s3: profile.jerk_m_per_s3,
            clock_ramp_s: profile.clock_ramp_s,
            delay_compensated: false,
        }
    }
}

impl Default for PaceConfig {
    fn default() -> Self {
        Self {
            slope_share: 0.35,
            hit_share: 0.7,
            force_share: 0.0,
            excess_share: 0.4,
            side_least_n: 2.0,
            over_m: 0.03,
            speed_min_m_per_s: 0.0025,
            explore_radius_m: 0.005,
            explore_above_rad: 0.03,
            explore_again_rad: 0.06,
            hop_m: 0.003,
        }
    }
}

impl Default for ContactConfig {
    fn default() -> Self {
        Self {
            touch_share: 0.2,
            lost_share: 0.1,
            noise_n: 0.3,
            lost_s: 0.024,
            lost_count_max: 30,
            lost_here_max: 8,
            seek_distance_max_m: 0.01,
            settled_share: 0.15,
            settled_s: 0.1,
            seek_speed_m_per_s: 0.005,
        }
    }
}

impl Presets for ControllerConfig {
    /// Table 1: `m_p` 1, `m_o` 0.04, `d_p` 150, `d_o` 1.5, `k_R` 0.08; proportional, without
    /// feed-forward and without position feedback, as published.
    fn paper() -> Self {
        let default = Self::default();
        Self {
            force: ForceConfig {
                mass_kg: 1.0,
                damping_n_s_per_m: 150.0,
                adaptive: false,
                approach_slowed: false,
                integral_ratio: 0.0,
                loop_delay_sd_s: 0.0,
                // In effect a step: the published law has no ramp.
                reference_rate_n_per_s: 100.0,
                probe_share: 0.0,
                ..default.force
            },
            torque: TorqueConfig {
                inertia_kg_m2: 0.04,
                damping_n_m_s_per_rad: 1.5,
                ..default.torque
            },
            alignment: AlignmentConfig {
                gain_per_s: 0.08,
                feed_forward: false,
                about_contact: false,
                ..default.alignment
            },
            normal: NormalConfig {
                filter_s: 0.0,
                sure_rad: 0.0,
                turn_max_rad: std::f64::consts::PI,
                prediction_max_rad: 0.0,
                ..default.normal
            },
            path: PathConfig {
                gain_per_s: 0.0,
                ..default.path
            },
            contact: ContactConfig {
                settled_s: 0.3,
                lost_here_max: 0,
                seek_distance_max_m: 0.5,
                ..default.contact
            },
            pace: PaceConfig {
                slope_share: 0.0,
                hit_share: 0.0,
                force_share: 0.0,
                excess_share: 0.0,
                side_least_n: 0.0,
                over_m: 0.0,
                explore_radius_m: 0.0,
                explore_again_rad: 0.0,
                hop_m: 0.0,
                ..default.pace
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
    fn presets_are_in_range_and_the_paper_is_table_1() {
        for name in ControllerConfig::PRESETS {
            ControllerConfig::preset(name).unwrap().check().unwrap();
        }
        let paper = ControllerConfig::preset("paper").unwrap();
        assert_eq!(paper.force.mass_kg, 1.0);
        assert_eq!(paper.force.damping_n_s_per_m, 150.0);
        assert_eq!(paper.torque.inertia_kg_m2, 0.04);
        assert_eq!(paper.torque.damping_n_m_s_per_rad, 1.5);
        assert_eq!(paper.alignment.gain_per_s, 0.08);
        assert!(!paper.force.adaptive && paper.force.integral_ratio == 0.0);
        assert!(!paper.alignment.feed_forward);
    }

    #[test]
    fn one_key_changes_one_key() {
        let config: ControllerConfig = toml::from_str("alignment.gain_per_s = 1.0").unwrap();
        let mut expected = ControllerConfig::default();
        expected.alignment.gain_per_s = 1.0;
        assert_eq!(config, expected);
        assert!(toml::from_str::<ControllerConfig>("alignment.gain = 1.0").is_err());
    }

    #[test]
    fn changes_lie_over_a_preset() {
        let changes: toml::Table = toml::from_str("[force]\ndamping_n_s_per_m = 400.0").unwrap();
        let config = ControllerConfig::preset_with("paper", &changes).unwrap();
        let mut expected = ControllerConfig::preset("paper").unwrap();
        expected.force.damping_n_s_per_m = 400.0;
        assert_eq!(config, expected);
        for bad in [
            "[force]\ndamping = 1.0",
            "force = 1",
            "[force]\ndamping_n_s_per_m = -1.0",
        ] {
            let changes: toml::Table = toml::from_str(bad).unwrap();
            assert!(
                ControllerConfig::preset_with("paper", &changes).is_err(),
                "{bad}"
            );
        }
    }
}
