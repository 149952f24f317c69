//! Valid range of each parameter of the law.

use super::HybridDynamicsConfig;
use crate::error::{ControlError, check_range};
use crate::laws::torque_task::{SharedParameters, TorqueConfig};
use crate::parameters::law_config::LawConfig;
use crate::parameters::ranges::{FRICTION, LEAVE, PATH_PROFILE, PATIENCE, Ranges, check_all};

const RANGES: Ranges = &[
    (
        "motion",
        &[
            ("position_per_s2", 1.0, 40_000.0),
            ("position_damping_per_s", 1.0, 500.0),
            ("orientation_per_s2", 1.0, 40_000.0),
            ("orientation_damping_per_s", 1.0, 500.0),
            ("integral_per_s3", 0.0, 1e6),
        ],
    ),
    (
        "force",
        &[
            ("integral_per_s", 0.0, 100.0),
            ("error_per_kg", 0.0, 10.0),
            ("damping_per_s", 0.0, 500.0),
            ("integral_max_n", 0.0, 1000.0),
            ("reference_rate_n_per_s", 0.1, 1e6),
        ],
    ),
    ("friction", FRICTION),
    (
        "friction_doubt",
        &[("share", 0.0, 2.0), ("observer_per_s", 1.0, 500.0)],
    ),
    (
        "estimate",
        &[
            ("follow_s", 0.0, 10.0),
            ("speed_max_m_per_s", 1e-4, 1.0),
            ("turn_rate_max_rad_per_s", 1e-4, 10.0),
            ("slow_within_sd", 0.0, 100.0),
        ],
    ),
    (
        "touch",
        &[
            ("on_n", 0.01, 100.0),
            ("off_n", 0.001, 100.0),
            ("lost_s", 0.001, 1.0),
            ("lost_count_max", 0.0, 1e6),
            ("seek_speed_m_per_s", 1e-4, 0.25),
            ("seek_distance_max_m", 0.0, 1.0),
            ("settle_s", 0.0, 60.0),
            ("explore_radius_m", 0.0, 0.1),
            ("explore_above_rad", 0.0, 1.0),
        ],
    ),
    ("path", PATH_PROFILE),
    ("patience", PATIENCE),
    ("leave", LEAVE),
];

impl LawConfig for HybridDynamicsConfig {
    fn check(&self) -> Result<(), ControlError> {
        check_all(self, RANGES)?;
        check_range("touch.off_n", self.touch.off_n, 0.001, self.touch.on_n)
    }

    fn path_bounds(&self) -> (f64, f64) {
        (self.path.acceleration_m_per_s2, self.path.jerk_m_per_s3)
    }
}

impl TorqueConfig for HybridDynamicsConfig {
    const FELT_BY_SLIDING: bool = false;

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
        let config = HybridDynamicsConfig::default();
        every_number_has_a_range_that_holds(&config, RANGES, HybridDynamicsConfig::check);
    }

    #[test]
    fn what_depends_on_another_parameter_is_held_against_it() {
        let mut config = HybridDynamicsConfig::default();
        config.touch.off_n = config.touch.on_n + 0.1;
        assert!(config.check().is_err());
    }

    #[test]
    fn a_wrench_is_not_waited_for_for_ever() {
        patience_ends(&HybridDynamicsConfig::default(), |config| {
            &mut config.patience
        });
    }
}
