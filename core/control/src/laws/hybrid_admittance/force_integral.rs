//! Integral of the force error that remains after eq. (1): the velocity along the normal that the
//! moving surface requires.
//!
//! A proportional admittance has a steady error while the surface moves under the tool (2.947 of 3
//! N on a slope). At rest, eq. (1) against a spring has no steady error and needs no integral,
//! which would only overshoot at touchdown. While sliding, the integral is stored as a *slope*,
//! metres along the normal per metre along the surface: its effect starts, stops and turns with the
//! path. Called by the controller each cycle in contact.

use nalgebra::Vector3;

use crate::contact::alignment::tangential;
use crate::limits::clamp_norm;

/// Minimum speed at which the slope is observable, m/s.
const SPEED_MIN: f64 = 0.004;
/// Speed below which the slope is learnt more slowly, m/s: a force error divided by a small speed
/// gives a large slope.
const SPEED_SURE: f64 = 0.01;
/// Time constant with which the slope decays at rest, s: the path may continue in another
/// direction.
const FADE_S: f64 = 0.5;
/// Upper bound of the slope.
const SLOPE_MAX: f64 = 0.5;

/// Integral over the force error, as a slope along the surface.
#[derive(Clone, Copy, Debug, Default)]
pub struct ForceIntegral {
    /// Slope in the tangent plane, base axes: its product with the sliding velocity is a velocity
    /// along the normal.
    slope: Vector3<f64>,
}

impl ForceIntegral {
    /// Velocity along the normal, out of the material, m/s, for the sliding velocity `along`.
    pub fn velocity(&self, along: &Vector3<f64>) -> f64 {
        self.slope.dot(along)
    }

    /// Processes one cycle: `rate` is the integral's growth, m/s² (force error over damping and
    /// integral time), `along` the commanded sliding velocity in the tangent plane of `normal`.
    pub fn step(
        &mut self,
        rate_m_per_s2: f64,
        along: &Vector3<f64>,
        normal: &Vector3<f64>,
        speed_max_m_per_s: f64,
        dt_s: f64,
    ) {
        self.slope = tangential(&self.slope, normal);
        let speed = along.norm();
        if speed < SPEED_MIN {
            self.slope *= 1.0 - (dt_s / FADE_S).min(1.0);
            return;
        }
        let sure = speed * speed + SPEED_SURE * SPEED_SURE;
        self.slope += along * (rate_m_per_s2 * dt_s / sure);
        self.slope = clamp_norm(self.slope, SLOPE_MAX.min(speed_max_m_per_s / speed));
    }

    /// Resets the integral to zero.
    pub fn reset(&mut self) {
        *self = Self::default();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A surface that rises with slope 0.1 under a force loop k/(d s): the error vanishes.
    #[test]
    fn no_force_error_remains_on_a_slope() {
        let (k, d, ti, dt) = (10_000.0, 1000.0, 0.4, 0.008);
        let mut integral = ForceIntegral::default();
        let (mut tool, mut surface, mut worst_late) = (0.0, 3.0 / k, 0.0f64);
        for i in 0..2500 {
            let speed = if (1000..1200).contains(&i) { 0.0 } else { 0.02 };
            let along = Vector3::new(speed, 0.0, 0.0);
            let error: f64 = k * (surface - tool) - 3.0;
            integral.step(error / (d * ti), &along, &Vector3::z(), 0.02, dt);
            tool += (error / d + integral.velocity(&along)) * dt;
            surface += 0.1 * speed * dt;
            if (700..1000).contains(&i) || i > 1700 {
                worst_late = worst_late.max(error.abs());
            }
        }
        // Without the integral the error would be 1000 * 0.1 * 0.02 = 2 N.
        assert!(worst_late < 0.1, "{worst_late}");
    }

    #[test]
    fn never_asks_for_more_than_allowed() {
        let mut integral = ForceIntegral::default();
        for i in 0..2000 {
            let along = Vector3::new(f64::from(i % 3) * 0.05, 0.0, 0.0);
            integral.step(5.0, &along, &Vector3::z(), 0.02, 0.008);
            assert!(integral.velocity(&along) <= 0.02 + 1e-12);
        }
    }
}
