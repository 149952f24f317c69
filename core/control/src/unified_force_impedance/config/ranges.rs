//! What each parameter of the law may be.

use toml::{Table, Value};

use super::UnifiedForceImpedanceConfig;
use crate::ControlError;
use crate::error::check_range;

/// Key, least and greatest value; of lists, each entry's.
const RANGES: &[(&str, f64, f64)] = &[
    ("impedance.stiffness_n_per_m", 0.0, 20_000.0),
    ("impedance.stiffness_nm_per_rad", 1.0, 2000.0),
    ("impedance.damping_ratio", 0.05, 5.0),
    ("impedance.normal_damping_n_s_per_m", 0.0, 5000.0),
    ("impedance.free_stiffness_n_per_m", 10.0, 20_000.0),
    ("impedance.integral_per_s", 0.0, 50.0),
    ("impedance.integral_max_n", 0.0, 100.0),
    ("force.proportional", 0.0, 10.0),
    ("force.integral_per_s", 0.0, 100.0),
    ("force.integral_max_n", 0.0, 200.0),
    ("force.filter_s", 0.0, 1.0),
    ("force.reference_rate_n_per_s", 0.1, 1e5),
    ("monitor.alpha_per_j", 0.0, 1e3),
    ("monitor.xi_per_deg", 0.0, 10.0),
    ("monitor.gamma", 0.0, 1e4),
    ("monitor.margin", 1e-3, 1e3),
    ("monitor.margin_sd", 0.0, 20.0),
    ("monitor.margin_time_s", 0.05, 100.0),
    ("monitor.margin_range", 1e-3, 1e3),
    ("monitor.rho_min_per_s", 1e-6, 1.0),
    ("monitor.rate_per_s", 0.01, 100.0),
    ("orientation.follow_s", 0.005, 5.0),
    ("orientation.turn_rate_max_rad_per_s", 0.01, 6.0),
    ("orientation.turn_acceleration_max_rad_per_s2", 0.1, 200.0),
    ("shaping.margin_m", 1e-3, 0.5),
    ("tanks.damping_share_to_force", 0.0, 1.0),
    ("tanks.switch_n_s_per_m", 1.0, 1e4),
    ("tanks.power_max_w", 0.1, 1000.0),
    ("fusion.vision_floor_rad", 0.0, 1.0),
    ("fusion.touch_floor_rad", 1e-4, 1.0),
    ("fusion.curvature_sd_per_m", 0.0, 100.0),
    ("fusion.gate_sd", 1.0, 100.0),
    ("fusion.gate_frames", 1.0, 1000.0),
    ("fusion.vision_patience_s", 0.01, 10.0),
    ("friction.coulomb_speed_rad_per_s", 1e-6, 10.0),
    ("posture.stiffness_nm_per_rad", 0.0, 500.0),
    ("posture.damping_nm_s_per_rad", 0.0, 100.0),
    ("touch.on_n", 0.01, 100.0),
    ("touch.off_n", 0.0, 100.0),
    ("touch.lost_cycles", 1.0, 1000.0),
    ("touch.pause_cycles", 1.0, 1000.0),
    ("touch.lost_count_max", 0.0, 1e6),
    ("touch.seek_speed_m_per_s", 1e-4, 0.25),
    ("touch.aligned_rad", 1e-3, 3.0),
    ("touch.align_s", 0.0, 60.0),
    ("touch.tare_s", 0.0, 10.0),
    ("touch.settle_s", 0.0, 60.0),
    ("touch.wrench_lag_s", 0.0, 1.0),
    ("path.acceleration_m_per_s2", 0.005, 5.0),
    ("path.jerk_m_per_s3", 0.01, 100.0),
    ("path.clock_ramp_s", 0.01, 5.0),
];

fn numbers(value: &Value) -> Vec<f64> {
    match value {
        Value::Float(x) => vec![*x],
        Value::Integer(n) => vec![*n as f64],
        Value::Array(list) => list.iter().flat_map(numbers).collect(),
        _ => vec![f64::NAN],
    }
}

impl UnifiedForceImpedanceConfig {
    /// Every number in its range.
    ///
    /// # Errors
    /// Names the key, the value and what is allowed.
    pub fn check(&self) -> Result<(), ControlError> {
        let table = Table::try_from(self).map_err(|e| ControlError::Syntax(e.to_string()))?;
        for (key, lower, upper) in RANGES {
            let (section, name) = key.split_once('.').unwrap_or((key, ""));
            let value = table.get(section).and_then(|t| t.get(name));
            // A parameter that is no number is refused as one out of range.
            for x in value.map_or(vec![f64::NAN], numbers) {
                check_range(key, x, *lower, *upper)?;
            }
        }
        self.tanks.motion.check("tanks.motion")?;
        self.tanks.force.check("tanks.force")?;
        check_range("touch.off_n", self.touch.off_n, 0.0, self.touch.on_n)?;
        let [least, most] = self.monitor.margin_range;
        check_range("monitor.margin_range", most, least, 1e3)?;
        for &x in self
            .friction
            .viscous_nm_s_per_rad
            .iter()
            .chain(&self.friction.coulomb_nm)
        {
            check_range("friction", x, 0.0, 1e4)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn out_of_range_names_the_key() {
        for (key, _, upper) in RANGES {
            let (section, name) = key.split_once('.').unwrap();
            let mut table = Table::try_from(UnifiedForceImpedanceConfig::default()).unwrap();
            let slot = table[section].get_mut(name).unwrap();
            *slot = match slot {
                Value::Integer(_) => Value::Integer((upper + 1.0) as i64),
                Value::Array(list) => {
                    let mut list = list.clone();
                    list[0] = Value::Float(upper + 1.0);
                    Value::Array(list)
                }
                _ => Value::Float(upper + 1.0),
            };
            let config: UnifiedForceImpedanceConfig = table.try_into().unwrap();
            let error = config.check().unwrap_err().to_string();
            assert!(error.contains(key), "{key}: {error}");
        }
        let mut config = UnifiedForceImpedanceConfig::default();
        config.tanks.force.initial_j = f64::NAN;
        assert!(config.check().is_err());
    }
}
