//! Noise that the filter learns from its own innovations: of the velocity across the surface and
//! of the force across the direction of sliding.
//!
//! Called by the measurements.

use super::residual::Residual;
use crate::EstimatorConfig;

/// Correlation length of velocity errors that belong to a place, m: roughness, ripple of gears.
pub(super) const FLUCTUATION_LENGTH_M: f64 = 0.002;
/// Correlation time of velocity errors that belong to a sample, s.
const JITTER_CORRELATION_S: f64 = 0.01;
/// Time over which that variance is learnt, s.
const JITTER_MEMORY_S: f64 = 1.0;
/// Correlation time of the force's noise, s: vibration and slow noise of hardware, beyond that of
/// the wrench filter.
const FORCE_CORRELATION_S: f64 = 0.08;
/// Distance over which the surface's unrest is learnt, m.
const UNREST_LENGTH_M: f64 = 0.01;
/// Bounds of the unrest: the variance with which curvature changes, relative to the configured one.
const UNREST: (f64, f64) = (1.0, 40.0);
/// Lower bounds of what is learnt, as shares of the standard deviations stated.
const VELOCITY_FLOOR: f64 = 0.1;
const FORCE_FLOOR: f64 = 0.7;

/// Noise that is estimated from the innovations.
#[derive(Clone, Copy, Debug)]
pub(super) struct LearntNoise {
    /// Velocity across the surface: all of it.
    velocity: Residual,
    /// Part of that variance that is new in every sample, m²/s².
    jitter_m2_per_s2: f64,
    last_m_per_s: Option<f64>,
    /// Force across the direction of sliding.
    force: Residual,
    /// Variance of the force along the direction of sliding, N².
    pub friction_n2: f64,
    /// Variance of the change of curvature, relative to the configured one.
    pub unrest: f64,
    /// Mean square innovation of the velocity.
    innovation_m2_per_s2: f64,
    /// Mean square that was expected of it.
    expected_m2_per_s2: f64,
}

impl LearntNoise {
    pub fn new(config: &EstimatorConfig) -> Self {
        let sensing = &config.sensing;
        Self {
            velocity: Residual::new(sensing.velocity_sd_m_per_s, VELOCITY_FLOOR),
            jitter_m2_per_s2: sensing.velocity_sd_m_per_s.powi(2),
            last_m_per_s: None,
            force: Residual::new(sensing.force_noise_n, FORCE_FLOOR),
            friction_n2: 0.0,
            unrest: 1.0,
            innovation_m2_per_s2: 0.0,
            expected_m2_per_s2: 0.0,
        }
    }

    /// Adds an innovation of the velocity across the surface, m/s, after `distance_m` and `dt_s`.
    pub fn learn_velocity(&mut self, innovation: f64, distance_m: f64, dt_s: f64) {
        self.velocity
            .learn(innovation, distance_m / FLUCTUATION_LENGTH_M);
        if let Some(last) = self.last_m_per_s.replace(innovation) {
            // The wrench filter's lag, which the velocity shares, correlates neighbouring samples:
            // their difference shows about half of the variance.
            let step = innovation - last;
            let share = dt_s / (JITTER_MEMORY_S + dt_s);
            self.jitter_m2_per_s2 += share * (step * step - self.jitter_m2_per_s2);
        }
    }

    /// Variance of one innovation of the velocity, m²/s².
    pub fn velocity_variance(&self) -> f64 {
        self.velocity.variance()
    }

    /// Variance to use in the filter, which takes samples for independent, m²/s²; `extra` is the
    /// variance of other errors that belong to the place.
    pub fn velocity_variance_of_sample(&self, extra: f64, distance_m: f64, dt_s: f64) -> f64 {
        let alike = (FLUCTUATION_LENGTH_M / distance_m).max(1.0);
        let floor = self.velocity.floor();
        let placed = (self.velocity.variance() - self.jitter_m2_per_s2).max(floor);
        (placed + extra) * alike
            + self.jitter_m2_per_s2 * (2.0 * JITTER_CORRELATION_S / dt_s).max(1.0)
    }

    /// Adds an innovation of the force across the direction of sliding, N.
    pub fn learn_force(&mut self, innovation_n: f64, dt_s: f64) {
        self.force.learn(innovation_n, dt_s / FORCE_CORRELATION_S);
    }

    /// Variance of the force to use in the filter, which takes samples for independent, N².
    pub fn force_variance_of_sample(&self, dt_s: f64) -> f64 {
        self.force.variance() * (2.0 * FORCE_CORRELATION_S / dt_s).max(1.0)
    }

    /// Estimates how fast the curvature changes, from the ratio of the measured to the expected
    /// velocity across the surface. Only velocity is used, because no force bias disturbs it.
    pub fn learn_unrest(&mut self, innovation: f64, expected: f64, distance: f64) {
        let share = (distance / UNREST_LENGTH_M).min(0.2);
        self.innovation_m2_per_s2 += share * (innovation * innovation - self.innovation_m2_per_s2);
        self.expected_m2_per_s2 += share * (expected - self.expected_m2_per_s2);
        if self.expected_m2_per_s2 > 0.0 {
            let ratio = (self.innovation_m2_per_s2 / self.expected_m2_per_s2).clamp(0.02, 50.0);
            self.unrest = (self.unrest * ratio.powf(2.0 * share)).clamp(UNREST.0, UNREST.1);
        }
    }
}
