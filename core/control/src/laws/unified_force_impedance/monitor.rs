//! Contact-alignment monitor, and the two shaping functions that follow from it: eqs. (17)-(21) and
//! (30).

use nalgebra::Vector6;

use super::config::{MonitorConfig, ShapingConfig};
use super::fused_normal::SurfaceVariation;

/// State of the monitor.
#[derive(Clone, Copy, Debug)]
pub(super) struct Monitor {
    /// C of the last period.
    pub value: f64,
    /// ρ_align.
    pub rho: f64,
    mean: f64,
    variance: f64,
    gathered_s: f64,
}

impl Monitor {
    /// ρ_align(0) = 0: the arm is compliant until the monitor has seen correct alignment.
    pub fn new() -> Self {
        Self {
            value: 0.0,
            rho: 0.0,
            mean: 0.0,
            variance: 0.0,
            gathered_s: 0.0,
        }
    }

    /// C_m in use.
    pub fn margin(&self, config: &MonitorConfig) -> f64 {
        if config.margin_sd <= 0.0 || self.gathered_s <= 0.0 {
            return config.margin;
        }
        let [least, most] = config.margin_range;
        let found = (self.mean + config.margin_sd * self.variance.sqrt())
            .max(least)
            .min(most);
        // Blends in over the averaging time.
        let share = (self.gathered_s / config.margin_time_s).min(1.0);
        config.margin + (found - config.margin) * share
    }

    /// Eqs. (17)-(21). `wrench` and `error` are f_ext and x̃ in tool axes (N, Nm; m, rad),
    /// `theta_deg` the angle to the normal, `variation` l_s. If l_s is unknown although a camera is
    /// used, C is too small by an unknown amount: ρ_align may fall but not rise, and C_m is not
    /// updated. `well` means that the force is held and the path followed: C_m is learnt only from
    /// such periods.
    #[allow(clippy::too_many_arguments)]
    pub fn step(
        &mut self,
        config: &MonitorConfig,
        wrench: &Vector6<f64>,
        error: &Vector6<f64>,
        theta_deg: f64,
        variation: SurfaceVariation,
        well: bool,
        dt_s: f64,
    ) {
        let (bend, known) = match variation {
            SurfaceVariation::Known(variation) => (variation, true),
            SurfaceVariation::NotSeen => (0.0, true),
            SurfaceVariation::Unknown => (0.0, false),
        };
        self.value = (config.alpha_per_j * wrench.dot(error).abs()
            + config.xi_per_deg * theta_deg
            + config.gamma * bend)
            .abs();
        if well && known {
            let share = dt_s / (config.margin_time_s.min(self.gathered_s) + dt_s);
            let away = self.value - self.mean;
            self.mean += away * share;
            self.variance = (1.0 - share) * (self.variance + share * away * away);
            self.gathered_s += dt_s;
        }
        let h = 1.0 - self.value / self.margin(config);
        let rate = (h * self.rho + config.rho_min_per_s) * config.rate_per_s;
        let rate = if known { rate } else { rate.min(0.0) };
        // Eq. (20): held at both ends.
        self.rho = (self.rho + rate * dt_s).clamp(0.0, 1.0);
    }
}

/// ρ_frc of eq. (30). `depth_m` is x̃_z in tool axes: how far the tool is beyond its reference,
/// towards the surface. f_d points the same way, so the sign of f_dᵀ x̃ is that of the depth.
pub(super) fn rho_force(config: &ShapingConfig, depth_m: f64) -> f64 {
    if depth_m <= 0.0 {
        1.0
    } else if depth_m <= config.margin_m {
        0.5 * (1.0 + (std::f64::consts::PI * depth_m / config.margin_m).cos())
    } else {
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::super::config::UnifiedForceImpedanceConfig;
    use super::*;
    use crate::parameters::presets::Presets;

    fn paper() -> MonitorConfig {
        UnifiedForceImpedanceConfig::preset("paper")
            .unwrap()
            .monitor
    }

    #[test]
    fn c_is_equation_17() {
        let mut monitor = Monitor::new();
        let wrench = Vector6::new(3.0, 0.0, -15.0, 0.0, 0.5, 0.0);
        let error = Vector6::new(-0.01, 0.0, 0.02, 0.0, 0.1, 0.0);
        monitor.step(
            &paper(),
            &wrench,
            &error,
            5.0,
            SurfaceVariation::Known(0.01),
            false,
            1e-3,
        );
        let by_hand = (3.0 * -0.01 - 15.0 * 0.02 + 0.5 * 0.1_f64).abs() + 0.08 * 5.0 + 10.0 * 0.01;
        assert!((monitor.value - by_hand).abs() < 1e-12);
    }

    #[test]
    fn rho_rises_from_nothing_in_seven_seconds_and_falls_when_c_exceeds_its_margin() {
        let (config, zero) = (paper(), Vector6::zeros());
        let mut monitor = Monitor::new();
        let mut time = 0.0;
        while monitor.rho < 1.0 {
            monitor.step(
                &config,
                &zero,
                &zero,
                0.0,
                SurfaceVariation::Known(0.0),
                false,
                1e-3,
            );
            time += 1e-3;
        }
        // rho' = rho + 0.001: ln(1001) s.
        assert!((time - 1001f64.ln()).abs() < 0.02, "{time}");
        // C = 1.6 gives h = -7/9: ρ falls to a thousandth in a few seconds, and never below zero.
        for _ in 0..20_000 {
            monitor.step(
                &config,
                &zero,
                &zero,
                20.0,
                SurfaceVariation::Known(0.0),
                false,
                1e-3,
            );
            assert!(monitor.rho >= 0.0);
        }
        assert!(monitor.rho < 0.002);
    }

    #[test]
    fn without_the_surface_variation_rho_may_fall_and_does_not_rise() {
        let (config, zero) = (paper(), Vector6::zeros());
        let mut monitor = Monitor::new();
        let mut step = |theta, variation, cycles| {
            for _ in 0..cycles {
                monitor.step(&config, &zero, &zero, theta, variation, true, 1e-3);
            }
            (monitor.rho, monitor.gathered_s)
        };
        let (rho, gathered) = step(0.0, SurfaceVariation::Known(0.0), 6500);
        assert!(rho > 0.3 && rho < 1.0, "{rho}");
        // The segments are missing: nothing shows that the surface is flat.
        assert_eq!(step(0.0, SurfaceVariation::Unknown, 2000), (rho, gathered));
        assert!(step(20.0, SurfaceVariation::Unknown, 2000).0 < 0.5 * rho);
        assert!(step(0.0, SurfaceVariation::NotSeen, 3000).0 > 0.5 * rho);
    }

    #[test]
    fn the_margin_found_lies_above_what_is_usual_and_below_a_fault() {
        let config = MonitorConfig {
            margin_sd: 4.0,
            ..MonitorConfig::default()
        };
        for usual in [0.2, 0.8] {
            let mut monitor = Monitor::new();
            for i in 0..20_000 {
                let theta = usual / 0.08 * (1.0 + 0.2 * (f64::from(i) * 0.01).sin());
                let zero = Vector6::zeros();
                monitor.step(
                    &config,
                    &zero,
                    &zero,
                    theta,
                    SurfaceVariation::NotSeen,
                    true,
                    1e-3,
                );
            }
            let margin = monitor.margin(&config);
            assert!(
                margin > 1.2 * usual && margin < 2.0 * usual,
                "{margin} of {usual}"
            );
            assert_eq!(monitor.rho, 1.0);
        }
    }

    #[test]
    fn rho_force_is_one_where_the_tool_is_and_none_past_the_margin() {
        let config = ShapingConfig::default();
        assert_eq!(rho_force(&config, -0.01), 1.0);
        assert!((rho_force(&config, 0.02) - 0.5).abs() < 1e-12);
        assert!(rho_force(&config, 0.04) < 1e-12);
        assert_eq!(rho_force(&config, 0.05), 0.0);
        for i in 0..600 {
            let x = -0.01 + f64::from(i) * 1e-4;
            let step = rho_force(&config, x) - rho_force(&config, x + 1e-4);
            assert!((0.0..0.005).contains(&step), "{step}");
        }
    }
}
