//! Noise that the filter learns from its own innovations: of the height over the surface and of
//! the force across the direction of sliding.
//!
//! Called by the measurements.

use super::residual::Residual;
use crate::EstimatorConfig;

/// Correlation length of errors that belong to a place, m: roughness, ripple of gears, friction.
pub(super) const FLUCTUATION_LENGTH_M: f64 = 0.002;
/// Correlation time of the force's noise, s: vibration and slow noise of hardware, beyond that of
/// the wrench filter.
const FORCE_CORRELATION_S: f64 = 0.08;
/// Lower bounds of what is learnt, as shares of the standard deviations stated.
const HEIGHT_FLOOR: f64 = 0.3;
const FORCE_FLOOR: f64 = 0.7;
/// Upper bound of the height's learnt standard deviation, as a share of that stated.
const HEIGHT_MOST: f64 = 2.0;

/// Noise that is estimated from the innovations.
#[derive(Clone, Copy, Debug)]
pub(super) struct LearntNoise {
    /// Height over the surface.
    height: Residual,
    /// Upper bound of its variance, m².
    height_most_m2: f64,
    /// Force across the direction of sliding.
    force: Residual,
    /// Variance of the force along the direction of sliding, N².
    pub friction_n2: f64,
}

impl LearntNoise {
    pub fn new(config: &EstimatorConfig) -> Self {
        let sensing = &config.sensing;
        Self {
            height: Residual::new(sensing.height_sd_m, HEIGHT_FLOOR),
            height_most_m2: (HEIGHT_MOST * sensing.height_sd_m).powi(2),
            force: Residual::new(sensing.force_noise_n, FORCE_FLOOR),
            friction_n2: 0.0,
        }
    }

    /// Adds an innovation of the height, m, after `distance_m`.
    pub fn learn_height(&mut self, innovation_m: f64, distance_m: f64) {
        self.height
            .learn(innovation_m, distance_m / FLUCTUATION_LENGTH_M);
    }

    /// Variance of one innovation of the height, m². Bounded: an error of the slope adds up in
    /// the height, and would pass for noise.
    pub fn height_variance(&self) -> f64 {
        self.height.variance().min(self.height_most_m2)
    }

    /// Variance to use in the filter, which takes samples for independent, m².
    pub fn height_variance_of_sample(&self, distance_m: f64) -> f64 {
        self.height_variance() * (FLUCTUATION_LENGTH_M / distance_m).max(1.0)
    }

    /// Adds an innovation of the force across the direction of sliding, N.
    pub fn learn_force(&mut self, innovation_n: f64, dt_s: f64) {
        self.force.learn(innovation_n, dt_s / FORCE_CORRELATION_S);
    }

    /// Variance of the force to use in the filter, which takes samples for independent, N².
    pub fn force_variance_of_sample(&self, dt_s: f64) -> f64 {
        self.force.variance() * (2.0 * FORCE_CORRELATION_S / dt_s).max(1.0)
    }
}
