//! How fast the curvature of the surface changes, learnt from the corrections of the filter.
//!
//! If the process noise of the curvature fits the surface, the corrections of the curvature are
//! white: their sum over a distance has the variance that the filter expects (R. K. Mehra, "On the
//! identification of variances and adaptive Kalman filtering", IEEE TAC 15(2), 1970). On a surface
//! that is more uneven, the corrections of a stretch have the same sign.

use nalgebra::{Vector2, Vector3};

/// Distance over which the corrections are summed, m.
const SUM_LENGTH_M: f64 = 0.005;
/// Distance over which the unrest is learnt, m.
const LEARNING_LENGTH_M: f64 = 0.02;
/// Bounds of the unrest.
const BOUNDS: (f64, f64) = (1.0, 150.0);
/// Largest excess of the squared sum over its expected value that counts.
const EXCESS_MAX: f64 = 4.0;
/// Largest share of a memory that one sample replaces.
const SHARE_MAX: f64 = 0.2;

/// Corrections of the curvature along the motion by the measurements of one sample.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct CurvatureNews {
    /// Weights of the shape operator's components in that curvature.
    weights: Vector3<f64>,
    /// Sum of the corrections, 1/m.
    change_per_m: f64,
    /// Their expected variance, 1/m².
    expected_per_m2: f64,
}

impl CurvatureNews {
    /// Begins a sample with the motion `d` over the surface, tangent axes.
    pub fn along(d: &Vector2<f64>) -> Self {
        let d = d.try_normalize(0.0).unwrap_or_default();
        Self {
            weights: Vector3::new(d.x * d.x, d.y * d.y, 2.0 * d.x * d.y),
            ..Self::default()
        }
    }

    /// Adds one correction of the shape operator's components: `gain` times `innovation`, whose
    /// expected variance is `variance`.
    pub fn add(&mut self, gain: &Vector3<f64>, innovation: f64, variance: f64) {
        let gain = self.weights.dot(gain);
        self.change_per_m += gain * innovation;
        self.expected_per_m2 += gain * gain * variance;
    }
}

/// Variance with which the curvature changes, relative to the configured one.
#[derive(Clone, Copy, Debug)]
pub(super) struct Unrest {
    value: f64,
    /// Sum of the corrections, fading with the distance, 1/m.
    sum_per_m: f64,
    /// Its expected variance, 1/m².
    expected_per_m2: f64,
}

impl Default for Unrest {
    fn default() -> Self {
        Self {
            value: BOUNDS.0,
            sum_per_m: 0.0,
            expected_per_m2: 0.0,
        }
    }
}

impl Unrest {
    pub fn value(&self) -> f64 {
        self.value
    }

    /// Adds the corrections of a sample, over which the tool moved by `distance_m`.
    pub fn learn(&mut self, news: &CurvatureNews, distance_m: f64) {
        let keep = 1.0 - (distance_m / SUM_LENGTH_M).min(SHARE_MAX);
        self.sum_per_m = keep * self.sum_per_m + news.change_per_m;
        self.expected_per_m2 = keep * keep * self.expected_per_m2 + news.expected_per_m2;
        if self.expected_per_m2 <= 0.0 {
            return;
        }
        let excess = self.sum_per_m * self.sum_per_m / self.expected_per_m2 - 1.0;
        let share = (distance_m / LEARNING_LENGTH_M).min(SHARE_MAX);
        let grown = self.value * (share * excess.min(EXCESS_MAX)).exp();
        self.value = grown.clamp(BOUNDS.0, BOUNDS.1);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Unrest after 0.2 m of corrections with an expected variance of 1.
    fn learnt(mut correction: impl FnMut(usize) -> f64) -> f64 {
        let mut unrest = Unrest::default();
        for i in 0..2000 {
            let news = CurvatureNews {
                change_per_m: correction(i),
                expected_per_m2: 1.0,
                ..CurvatureNews::default()
            };
            unrest.learn(&news, 1e-4);
        }
        unrest.value()
    }

    #[test]
    fn corrections_that_alternate_or_are_as_expected_leave_the_surface_quiet() {
        assert_eq!(
            learnt(|i| if i.is_multiple_of(2) { 1.0 } else { -1.0 }),
            BOUNDS.0
        );
        // A sequence of ±1 without pattern: the parity of the bits of a hash.
        let white = |i: usize| {
            let hash = (i as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 29;
            if hash.count_ones().is_multiple_of(2) {
                1.0
            } else {
                -1.0
            }
        };
        assert!(learnt(white) < 10.0, "{}", learnt(white));
    }

    #[test]
    fn corrections_of_one_sign_over_a_stretch_raise_it() {
        let waves = |i: usize| (i as f64 * 0.01).sin();
        assert_eq!(learnt(waves), BOUNDS.1);
    }

    #[test]
    fn it_falls_again_on_a_quiet_surface() {
        let first_uneven = |i: usize| match i {
            0..500 => 1.0,
            _ => 0.0,
        };
        assert_eq!(learnt(first_uneven), BOUNDS.0);
    }
}
