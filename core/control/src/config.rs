//! Parameters of the control law, and the two presets: `paper` (Tugal et al., Table 1) and
//! `default`.

mod ranges;

use serde::{Deserialize, Serialize};

use crate::energy_tank::EnergyTank;
use crate::{ControlError, LeaveConfig};

/// Parameters of the law. `ControllerConfig::preset` gives a complete one; a file may change single
/// keys of it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Default)]
#[serde(deny_unknown_fields, default)]
pub struct ControllerConfig {
    /// Force along the normal, eq. (1).
    pub force: ForceConfig,
    /// Torque about the tangential axes, eq. (1).
    pub torque: TorqueConfig,
    /// Keeping the tool square, eq. (4).
    pub alignment: AlignmentConfig,
    /// Which normal to use.
    pub normal: NormalConfig,
    /// Following the path.
    pub path: PathConfig,
    /// When the tool touches.
    pub contact: ContactConfig,
    /// How long to bear with silence.
    pub patience: PatienceConfig,
    /// How the tool leaves a surface, and what shows that it did.
    pub leave: LeaveConfig,
}

/// Translational part of the admittance.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ForceConfig {
    /// Virtual mass `m_p`, kg.
    pub mass_kg: f64,
    /// Virtual damping `d_p`, Ns/m: the one in use when not adaptive, the least one when adaptive.
    pub damping_n_s_per_m: f64,
    /// Damping follows the contact stiffness: `d = k * loop_delay / delay_margin`.
    pub adaptive: bool,
    /// Largest adaptive damping, Ns/m.
    pub damping_max_n_s_per_m: f64,
    /// From command to measured force, s: transport, servo, filter.
    pub loop_delay_s: f64,
    /// Product of crossover and delay aimed at, rad: 0.3 is well damped, above 1 rings.
    pub delay_margin_rad: f64,
    /// Stiffest contact to expect, N/m: taken until touchdown shows better.
    pub stiffness_expected_n_per_m: f64,
    /// Overshoot accepted at touchdown on the expected stiffness, as a share of the reference;
    /// bounds the approach speed.
    pub overshoot_accepted: f64,
    /// The approach is slowed for the expected stiffness.
    pub approach_slowed: bool,
    /// Integral over the force error, in multiples of the crossover's period; 0 is off.
    pub integral_ratio: f64,
    /// Speed along the normal that the integral may ask for, m/s.
    pub integral_speed_max_m_per_s: f64,
    /// Speed along the normal that the force law may ask for, m/s.
    pub speed_max_m_per_s: f64,
    /// Rate at which a changed reference comes into force, N/s.
    pub reference_rate_n_per_s: f64,
    /// Bounds the energy that a task may put into the surface along the normal, however long it
    /// lasts: a surface that gives way for ever, or a normal that is wrong. None:
    /// `limits.power_max_w` alone.
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
    /// Turn rate that it may ask for, rad/s.
    pub turn_rate_max_rad_per_s: f64,
}

/// Keeping the tool square to the surface.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct AlignmentConfig {
    /// Gain `k_R` of eq. (4), 1/s.
    pub gain_per_s: f64,
    /// Turn with the surface: its curvature times the tool's velocity is fed forward.
    pub feed_forward: bool,
    /// Turn rate that alignment may ask for, rad/s.
    pub turn_rate_max_rad_per_s: f64,
}

/// Which normal to use.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct NormalConfig {
    /// Low pass on the way from the estimate to the normal in use, s; 0 is none.
    pub filter_s: f64,
    /// Standard deviation per axis at which an estimate is filtered twice as long, rad; 0 takes
    /// every estimate alike.
    pub sure_rad: f64,
    /// Rate at which the normal in use may turn, rad/s.
    pub turn_rate_max_rad_per_s: f64,
    /// An estimate further than this from the normal in use is refused, rad.
    pub gate_rad: f64,
    /// A newly chosen estimator must agree this well with the normal in use, rad.
    pub switch_gate_rad: f64,
    /// Way along the surface without a valid estimate before the next estimator is taken, m.
    pub blind_distance_m: f64,
    /// Way over which the surface's curvature is learnt from the turning of the normal when the
    /// estimator gives none, m.
    pub curvature_distance_m: f64,
    /// Largest curvature believed, 1/m.
    pub curvature_max_per_m: f64,
    /// An estimate is turned on by its age along the path, with the surface's curvature, but by no
    /// more than this, rad; 0 takes it as it is.
    pub prediction_max_rad: f64,
}

/// Following the path.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PathConfig {
    /// Gain of the position error's feedback in the tangent plane, 1/s; 0 is the paper's velocity
    /// profile alone.
    pub gain_per_s: f64,
    /// Speed that the feedback may add, m/s.
    pub feedback_speed_max_m_per_s: f64,
    /// Path error at which the path begins to wait for the arm, m; it stands still at twice that.
    pub wait_error_m: f64,
    /// Acceleration along the path, m/s².
    pub acceleration_m_per_s2: f64,
    /// Jerk along the path, m/s³.
    pub jerk_m_per_s3: f64,
    /// Time in which the path's clock comes to a stop or to speed on pause and resume, s.
    pub clock_ramp_s: f64,
}

/// How a law of torques goes along its path: it follows the reference by its own gains, and does
/// not wait for the arm.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PathProfileConfig {
    /// Acceleration along the path, m/s².
    pub acceleration_m_per_s2: f64,
    /// Jerk along the path, m/s³.
    pub jerk_m_per_s3: f64,
    /// Time in which the path's clock comes to a stop or to speed on pause and resume, s.
    pub clock_ramp_s: f64,
}

impl Default for PathProfileConfig {
    fn default() -> Self {
        let path = PathConfig::default();
        Self {
            acceleration_m_per_s2: path.acceleration_m_per_s2,
            jerk_m_per_s3: path.jerk_m_per_s3,
            clock_ramp_s: path.clock_ramp_s,
        }
    }
}

/// When the tool touches.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ContactConfig {
    /// Pressing force that counts as a touch, as a share of the reference.
    pub touch_share: f64,
    /// Pressing force below which contact counts as lost, as a share of the reference.
    pub lost_share: f64,
    /// Least of the two in newtons: what noise and a payload error can fake.
    pub noise_n: f64,
    /// Cycles below it before contact is lost.
    pub lost_cycles: u32,
    /// Contact losses in one task after which it ends: a loop that bounces does not heal itself.
    pub lost_count_max: u32,
    /// Force error that counts as settled, as a share of the reference.
    pub settled_share: f64,
    /// Time that it must stay settled before the path starts, s.
    pub settled_s: f64,
    /// Speed while seeking a lost surface, m/s.
    pub seek_speed_m_per_s: f64,
}

/// How long to bear with silence.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PatienceConfig {
    /// Age of the wrench, in cycles, at which everything stops.
    pub wrench_cycles: f64,
    /// Added to it for the jitter of unsynchronised clocks, s.
    pub wrench_jitter_s: f64,
    /// Bad wrench in a row, in cycles, at which everything stops.
    pub wrench_bad_cycles: u32,
    /// From then to the retraction when the wrench is only silent, s.
    pub wrench_retract_s: f64,
    /// Age of the estimate at which sliding stops, s.
    pub estimate_s: f64,
    /// From then to the retraction, s.
    pub estimate_retract_s: f64,
    /// From the moment that the motion of a moving base is not known to the retraction, s.
    pub base_retract_s: f64,
}

impl Default for ForceConfig {
    fn default() -> Self {
        Self {
            mass_kg: 1.0,
            damping_n_s_per_m: 150.0,
            adaptive: true,
            damping_max_n_s_per_m: 6000.0,
            loop_delay_s: 0.04,
            delay_margin_rad: 0.45,
            stiffness_expected_n_per_m: 50_000.0,
            overshoot_accepted: 0.2,
            approach_slowed: true,
            integral_ratio: 4.0,
            integral_speed_max_m_per_s: 0.02,
            speed_max_m_per_s: 0.02,
            reference_rate_n_per_s: 5.0,
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
            gain_per_s: 2.5,
            feed_forward: true,
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
        Self {
            gain_per_s: 2.0,
            feedback_speed_max_m_per_s: 0.02,
            wait_error_m: 0.005,
            acceleration_m_per_s2: 0.1,
            jerk_m_per_s3: 1.0,
            clock_ramp_s: 0.2,
        }
    }
}

impl Default for ContactConfig {
    fn default() -> Self {
        Self {
            touch_share: 0.2,
            lost_share: 0.1,
            noise_n: 0.3,
            lost_cycles: 3,
            lost_count_max: 30,
            settled_share: 0.15,
            settled_s: 0.3,
            seek_speed_m_per_s: 0.005,
        }
    }
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

impl ControllerConfig {
    /// Names that [`ControllerConfig::preset`] knows.
    pub const PRESETS: [&'static str; 2] = ["default", "paper"];

    /// A complete set of parameters by name: `default`, or `paper` (Table 1: `m_p` 1, `m_o` 0.04,
    /// `d_p` 150, `d_o` 1.5, `k_R` 0.08; proportional, without feed-forward and without position
    /// feedback, as published).
    pub fn preset(name: &str) -> Result<Self, ControlError> {
        match name {
            "default" => Ok(Self::default()),
            "paper" => Ok(Self::paper()),
            other => Err(ControlError::UnknownPreset { name: other.into() }),
        }
    }

    /// A preset with single keys changed, as in `[controller.settings]` of a cell file.
    pub fn preset_with(name: &str, changes: &toml::Table) -> Result<Self, ControlError> {
        let config = with_changes(Self::preset(name)?, changes)?;
        config.check()?;
        Ok(config)
    }

    fn paper() -> Self {
        let default = Self::default();
        Self {
            force: ForceConfig {
                mass_kg: 1.0,
                damping_n_s_per_m: 150.0,
                adaptive: false,
                approach_slowed: false,
                integral_ratio: 0.0,
                // A step, in effect: the published law has no ramp.
                reference_rate_n_per_s: 100.0,
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
                ..default.alignment
            },
            normal: NormalConfig {
                filter_s: 0.0,
                sure_rad: 0.0,
                prediction_max_rad: 0.0,
                ..default.normal
            },
            path: PathConfig {
                gain_per_s: 0.0,
                ..default.path
            },
            ..default
        }
    }
}

/// A complete set of parameters with single ones changed.
pub(crate) fn with_changes<T: Serialize + serde::de::DeserializeOwned>(
    preset: T,
    changes: &toml::Table,
) -> Result<T, ControlError> {
    let wrong = |e: String| ControlError::Syntax(format!("controller settings: {e}"));
    let mut table = toml::Table::try_from(preset).map_err(|e| wrong(e.to_string()))?;
    overlay(&mut table, changes);
    serde_path_to_error::deserialize(toml::Value::Table(table))
        .map_err(|e| wrong(format!("`{}`: {}", e.path(), e.inner().message())))
}

/// Puts `changes` over `base`, table by table.
fn overlay(base: &mut toml::Table, changes: &toml::Table) {
    for (key, value) in changes {
        match (base.get_mut(key), value) {
            (Some(toml::Value::Table(inner)), toml::Value::Table(changes)) => {
                overlay(inner, changes);
            }
            _ => {
                base.insert(key.clone(), value.clone());
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
