//! What each parameter of the law may be.

use toml::{Table, Value};

use super::ControllerConfig;
use crate::ControlError;
use crate::error::check_range;

/// Key, least and greatest value.
const RANGES: &[(&str, f64, f64)] = &[
    ("force.mass_kg", 0.0, 100.0),
    ("force.damping_n_s_per_m", 10.0, 1e5),
    ("force.damping_max_n_s_per_m", 10.0, 1e5),
    ("force.loop_delay_s", 0.001, 0.5),
    ("force.delay_margin_rad", 0.01, 1.0),
    ("force.stiffness_expected_n_per_m", 100.0, 2e5),
    ("force.overshoot_accepted", 0.0, 5.0),
    ("force.integral_ratio", 0.0, 100.0),
    ("force.integral_speed_max_m_per_s", 0.0, 0.1),
    ("force.speed_max_m_per_s", 0.001, 0.1),
    ("force.reference_rate_n_per_s", 0.1, 100.0),
    ("torque.inertia_kg_m2", 0.0, 10.0),
    ("torque.damping_n_m_s_per_rad", 0.01, 1e4),
    ("torque.turn_rate_max_rad_per_s", 0.0, 3.0),
    ("alignment.gain_per_s", 0.0, 10.0),
    ("alignment.turn_rate_max_rad_per_s", 0.0, 3.0),
    ("normal.filter_s", 0.0, 2.0),
    ("normal.sure_rad", 0.0, 1.0),
    ("normal.turn_rate_max_rad_per_s", 0.01, 6.0),
    ("normal.gate_rad", 0.05, 3.0),
    ("normal.switch_gate_rad", 0.01, 3.0),
    ("normal.blind_distance_m", 0.001, 1.0),
    ("normal.curvature_distance_m", 0.001, 1.0),
    ("normal.curvature_max_per_m", 0.0, 500.0),
    ("normal.prediction_max_rad", 0.0, 1.0),
    ("path.gain_per_s", 0.0, 10.0),
    ("path.feedback_speed_max_m_per_s", 0.0, 0.2),
    ("path.wait_error_m", 0.0005, 0.1),
    ("path.acceleration_m_per_s2", 0.005, 5.0),
    ("path.jerk_m_per_s3", 0.01, 100.0),
    ("path.clock_ramp_s", 0.01, 5.0),
    ("contact.touch_share", 0.01, 0.9),
    ("contact.lost_share", 0.0, 0.9),
    ("contact.noise_n", 0.0, 10.0),
    ("contact.lost_cycles", 1.0, 100.0),
    ("contact.lost_count_max", 1.0, 1e6),
    ("contact.settled_share", 0.01, 0.9),
    ("contact.settled_s", 0.0, 10.0),
    ("contact.seek_speed_m_per_s", 0.0005, 0.05),
    ("patience.wrench_cycles", 1.0, 100.0),
    ("patience.wrench_jitter_s", 0.0, 0.5),
    ("patience.wrench_bad_cycles", 1.0, 10.0),
    ("patience.wrench_retract_s", 0.0, 2.0),
    ("patience.estimate_s", 0.01, 2.0),
    ("patience.estimate_retract_s", 0.0, 10.0),
    ("patience.base_retract_s", 0.0, 10.0),
];

impl ControllerConfig {
    /// Every number in its range.
    ///
    /// # Errors
    /// [`ControlError::Range`] with the key, its value and what is allowed.
    pub fn check(&self) -> Result<(), ControlError> {
        let table = Table::try_from(self).map_err(|e| ControlError::Syntax(e.to_string()))?;
        for (key, lower, upper) in RANGES {
            // A parameter that is no number is refused as one out of range.
            let value = number(&table, key).unwrap_or(f64::NAN);
            check_range(key, value, *lower, *upper)?;
        }
        let (force, contact) = (&self.force, &self.contact);
        if let Some(tank) = &force.tank {
            tank.check("force.tank")?;
        }
        check_range(
            "force.damping_max_n_s_per_m",
            force.damping_max_n_s_per_m,
            force.damping_n_s_per_m,
            1e5,
        )?;
        check_range(
            "contact.lost_share",
            contact.lost_share,
            0.0,
            contact.touch_share,
        )
    }
}

/// By its section and name.
fn number(table: &Table, key: &str) -> Option<f64> {
    let (section, name) = key.split_once('.')?;
    match table.get(section)?.get(name)? {
        Value::Float(x) => Some(*x),
        Value::Integer(n) => Some(*n as f64),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_number_has_a_range_and_every_range_a_number() {
        let table = Table::try_from(ControllerConfig::default()).unwrap();
        let mut numbers = Vec::new();
        for (section, keys) in &table {
            for (name, value) in keys.as_table().unwrap() {
                if !value.is_bool() {
                    numbers.push(format!("{section}.{name}"));
                }
            }
        }
        let mut ranges: Vec<&str> = RANGES.iter().map(|(key, _, _)| *key).collect();
        numbers.sort_unstable();
        ranges.sort_unstable();
        assert_eq!(ranges, numbers);
    }

    #[test]
    fn out_of_range_names_the_key() {
        for (key, lower, upper) in RANGES {
            let (section, name) = key.split_once('.').unwrap();
            for bad in [lower - 1.0, upper + 1.0] {
                let mut table = Table::try_from(ControllerConfig::default()).unwrap();
                let slot = table[section].get_mut(name).unwrap();
                *slot = match slot {
                    Value::Integer(_) => Value::Integer(bad as i64),
                    _ => Value::Float(bad),
                };
                // A count below zero is refused before.
                if let Ok(config) = table.try_into::<ControllerConfig>() {
                    let error = config.check().unwrap_err().to_string();
                    assert!(error.contains(key), "{error}");
                }
            }
        }
        let mut config = ControllerConfig::default();
        config.force.damping_n_s_per_m = f64::NAN;
        let error = config.check().unwrap_err().to_string();
        assert!(error.contains("force.damping_n_s_per_m"), "{error}");
    }

    #[test]
    fn what_depends_on_another_parameter_is_held_against_it() {
        let mut config = ControllerConfig::default();
        config.force.damping_max_n_s_per_m = config.force.damping_n_s_per_m - 1.0;
        assert!(config.check().is_err());
        let mut config = ControllerConfig::default();
        config.contact.lost_share = config.contact.touch_share + 0.01;
        assert!(config.check().is_err());
    }
}
