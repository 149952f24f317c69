//! Valid range of each parameter of the law.

use super::ControllerConfig;
use crate::error::{ControlError, check_range};
use crate::parameters::law_config::LawConfig;
use crate::parameters::ranges::{LEAVE, PATIENCE, Ranges, TANK, check_all};

const RANGES: Ranges = &[
    (
        "force",
        &[
            ("mass_kg", 0.0, 100.0),
            ("damping_n_s_per_m", 10.0, 1e5),
            ("damping_max_n_s_per_m", 10.0, 1e5),
            ("loop_delay_s", 0.001, 0.5),
            ("loop_delay_sd_s", 0.0, 0.5),
            ("delay_margin_rad", 0.01, 1.0),
            ("stiffness_expected_n_per_m", 100.0, 2e5),
            ("overshoot_accepted", 0.0, 5.0),
            ("integral_ratio", 0.0, 100.0),
            ("integral_speed_max_m_per_s", 0.0, 0.1),
            ("speed_max_m_per_s", 0.001, 0.1),
            ("reference_rate_n_per_s", 0.1, 100.0),
            ("probe_share", 0.0, 0.9),
        ],
    ),
    ("force.tank", TANK),
    (
        "torque",
        &[
            ("inertia_kg_m2", 0.0, 10.0),
            ("damping_n_m_s_per_rad", 0.01, 1e4),
            ("turn_rate_max_rad_per_s", 0.0, 3.0),
        ],
    ),
    (
        "alignment",
        &[
            ("gain_per_s", 0.0, 10.0),
            ("turn_rate_max_rad_per_s", 0.0, 3.0),
        ],
    ),
    (
        "normal",
        &[
            ("filter_s", 0.0, 2.0),
            ("sure_rad", 0.0, 1.0),
            ("turn_rate_max_rad_per_s", 0.01, 6.0),
            ("turn_max_rad", 0.1, 3.2),
            ("gate_rad", 0.05, 3.0),
            ("switch_gate_rad", 0.01, 3.0),
            ("blind_distance_m", 0.001, 1.0),
            ("curvature_distance_m", 0.001, 1.0),
            ("curvature_max_per_m", 0.0, 500.0),
            ("prediction_max_rad", 0.0, 1.0),
        ],
    ),
    (
        "path",
        &[
            ("gain_per_s", 0.0, 10.0),
            ("feedback_speed_max_m_per_s", 0.0, 0.2),
            ("wait_error_m", 0.0005, 0.1),
            ("acceleration_m_per_s2", 0.005, 5.0),
            ("jerk_m_per_s3", 0.01, 100.0),
            ("clock_ramp_s", 0.01, 5.0),
        ],
    ),
    (
        "pace",
        &[
            ("slope_share", 0.0, 2.0),
            ("hit_share", 0.0, 10.0),
            ("force_share", 0.0, 5.0),
            ("excess_share", 0.0, 5.0),
            ("side_least_n", 0.0, 100.0),
            ("over_m", 0.0, 0.2),
            ("speed_min_m_per_s", 0.0005, 0.1),
            ("explore_radius_m", 0.0, 0.02),
            ("explore_above_rad", 0.001, 1.0),
            ("explore_again_rad", 0.0, 1.0),
            ("hop_m", 0.0, 0.01),
        ],
    ),
    (
        "contact",
        &[
            ("touch_share", 0.01, 0.9),
            ("lost_share", 0.0, 0.9),
            ("noise_n", 0.0, 10.0),
            ("lost_s", 0.001, 1.0),
            ("lost_count_max", 1.0, 1e6),
            ("lost_here_max", 0.0, 1e6),
            ("seek_distance_max_m", 0.001, 0.5),
            ("settled_share", 0.01, 0.9),
            ("settled_s", 0.0, 10.0),
            ("seek_speed_m_per_s", 0.0005, 0.05),
        ],
    ),
    ("patience", PATIENCE),
    ("leave", LEAVE),
];

impl LawConfig for ControllerConfig {
    const LEARNS: bool = true;
    const TRAVELS: bool = true;
    const LIFTS: bool = true;

    fn check(&self) -> Result<(), ControlError> {
        check_all(self, RANGES)?;
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

    fn force_rate_max_n_per_s(&self) -> f64 {
        self.force.reference_rate_n_per_s
    }

    fn path_bounds(&self) -> (f64, f64) {
        (self.path.acceleration_m_per_s2, self.path.jerk_m_per_s3)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::contact::energy_tank::EnergyTank;
    use crate::parameters::ranges::tests::every_number_has_a_range_that_holds;

    #[test]
    fn every_number_has_a_range_and_every_range_a_number() {
        let mut config = ControllerConfig::default();
        config.force.tank = Some(EnergyTank {
            initial_j: 2.0,
            lower_j: 1.0,
            upper_j: 2.0,
            band_j: 0.2,
            reserve_j: 0.1,
        });
        every_number_has_a_range_that_holds(&config, RANGES, ControllerConfig::check);
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
