//! Valid range of each parameter of the law.

use super::UnifiedForceImpedanceConfig;
use crate::error::{ControlError, check_range};
use crate::laws::torque_task::{SharedParameters, TorqueConfig};
use crate::parameters::law_config::LawConfig;
use crate::parameters::ranges::{FRICTION, LEAVE, PATH_PROFILE, PATIENCE, Ranges, TANK, check_all};

const RANGES: Ranges = &[
    (
        "impedance",
        &[
            ("stiffness_n_per_m", 0.0, 20_000.0),
            ("stiffness_nm_per_rad", 1.0, 2000.0),
            ("damping_ratio", 0.05, 5.0),
            ("normal_damping_n_s_per_m", 0.0, 5000.0),
            ("free_stiffness_n_per_m", 10.0, 20_000.0),
            ("integral_per_s", 0.0, 50.0),
            ("integral_max_n", 0.0, 100.0),
        ],
    ),
    (
        "force",
        &[
            ("proportional", 0.0, 10.0),
            ("integral_per_s", 0.0, 100.0),
            ("integral_max_n", 0.0, 200.0),
            ("filter_s", 0.0, 1.0),
            ("reference_rate_n_per_s", 0.1, 1e5),
        ],
    ),
    (
        "monitor",
        &[
            ("alpha_per_j", 0.0, 1e3),
            ("xi_per_deg", 0.0, 10.0),
            ("gamma", 0.0, 1e4),
            ("margin", 1e-3, 1e3),
            ("margin_sd", 0.0, 20.0),
            ("margin_time_s", 0.05, 100.0),
            ("margin_range", 1e-3, 1e3),
            ("rho_min_per_s", 1e-6, 1.0),
            ("rate_per_s", 0.01, 100.0),
        ],
    ),
    (
        "orientation",
        &[
            ("follow_s", 0.005, 5.0),
            ("turn_rate_max_rad_per_s", 0.01, 6.0),
            ("turn_acceleration_max_rad_per_s2", 0.1, 200.0),
        ],
    ),
    ("shaping", &[("margin_m", 1e-3, 0.5)]),
    (
        "tanks",
        &[
            ("damping_share_to_force", 0.0, 1.0),
            ("switch_n_s_per_m", 1.0, 1e4),
            ("power_max_w", 0.1, 1000.0),
        ],
    ),
    ("tanks.motion", TANK),
    ("tanks.force", TANK),
    (
        "fusion",
        &[
            ("vision_floor_rad", 0.0, 1.0),
            ("mounting_sd_rad", 0.0, 0.3),
            ("touch_floor_rad", 1e-4, 1.0),
            ("curvature_sd_per_m", 0.0, 100.0),
            ("gate_sd", 1.0, 100.0),
            ("gate_frames", 1.0, 1000.0),
            ("vision_patience_s", 0.01, 10.0),
        ],
    ),
    ("friction", FRICTION),
    (
        "posture",
        &[
            ("stiffness_nm_per_rad", 0.0, 500.0),
            ("damping_nm_s_per_rad", 0.0, 100.0),
        ],
    ),
    (
        "touch",
        &[
            ("on_n", 0.01, 100.0),
            ("off_n", 0.0, 100.0),
            ("lost_s", 0.001, 1.0),
            ("pause_s", 0.001, 1.0),
            ("lost_count_max", 0.0, 1e6),
            ("seek_speed_m_per_s", 1e-4, 0.25),
            ("aligned_rad", 1e-3, 3.0),
            ("align_s", 0.0, 60.0),
            ("tare_s", 0.0, 10.0),
            ("zero_max_n", 0.1, 100.0),
            ("zero_drift_n_per_min", 0.0, 100.0),
            ("settle_s", 0.0, 60.0),
            ("wrench_lag_s", 0.0, 1.0),
        ],
    ),
    ("path", PATH_PROFILE),
    ("patience", PATIENCE),
    ("leave", LEAVE),
];

impl LawConfig for UnifiedForceImpedanceConfig {
    fn check(&self) -> Result<(), ControlError> {
        check_all(self, RANGES)?;
        self.tanks.motion.check("tanks.motion")?;
        self.tanks.force.check("tanks.force")?;
        check_range("touch.off_n", self.touch.off_n, 0.0, self.touch.on_n)?;
        let [least, most] = self.monitor.margin_range;
        check_range("monitor.margin_range", most, least, 1e3)
    }

    fn path_bounds(&self) -> (f64, f64) {
        (self.path.acceleration_m_per_s2, self.path.jerk_m_per_s3)
    }
}

impl TorqueConfig for UnifiedForceImpedanceConfig {
    const FELT_BY_SLIDING: bool = true;

    fn shared(&self) -> SharedParameters<'_> {
        SharedParameters {
            path: &self.path,
            patience: &self.patience,
            leave: &self.leave,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::parameters::ranges::tests::{every_number_has_a_range_that_holds, patience_ends};

    #[test]
    fn every_number_has_a_range_and_every_range_a_number() {
        let config = UnifiedForceImpedanceConfig::default();
        every_number_has_a_range_that_holds(&config, RANGES, UnifiedForceImpedanceConfig::check);
    }

    #[test]
    fn what_depends_on_another_parameter_is_held_against_it() {
        let mut config = UnifiedForceImpedanceConfig::default();
        config.touch.off_n = config.touch.on_n + 0.1;
        assert!(config.check().is_err());
        let mut config = UnifiedForceImpedanceConfig::default();
        config.monitor.margin_range = [2.0, 1.0];
        assert!(config.check().is_err());
    }

    #[test]
    fn a_wrench_is_not_waited_for_for_ever() {
        patience_ends(&UnifiedForceImpedanceConfig::default(), |config| {
            &mut config.patience
        });
    }
}
