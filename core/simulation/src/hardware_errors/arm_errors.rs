//! Errors of the arm: servos that differ between joints, and measured positions and velocities that
//! are not the true ones.

use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};
use tangent_mechanics::Joints;

use crate::plant_error::PlantError;

/// True servo and encoders against stated ones.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ArmErrors {
    /// Bandwidth of each joint's servo relative to `arm.lag`, ratio.
    pub bandwidth_ratio: [f64; 6],
    /// White noise of the measured joint velocities, rad/s, one standard deviation per sample.
    pub velocity_noise_rad_per_s: f64,
    /// Amplitude of the measured position's error that repeats with the joint's angle (gear and
    /// encoder), rad. The measured velocity has its derivative.
    pub ripple_rad: f64,
    /// Periods of that error per turn of the joint.
    pub ripple_per_turn: f64,
    /// Measured joint position minus the true one, constant, rad.
    pub offset_rad: [f64; 6],
}

impl Default for ArmErrors {
    fn default() -> Self {
        Self {
            bandwidth_ratio: [1.0; 6],
            velocity_noise_rad_per_s: 0.0,
            ripple_rad: 0.0,
            // Two errors per turn of a strain-wave gear's input at a ratio of 101.
            ripple_per_turn: 202.0,
            offset_rad: [0.0; 6],
        }
    }
}

impl ArmErrors {
    pub(crate) fn check(&self) -> Result<(), PlantError> {
        for ratio in self.bandwidth_ratio {
            PlantError::unless(
                "errors.arm.bandwidth_ratio",
                ratio,
                "0.1 to 10",
                (0.1..=10.0).contains(&ratio),
            )?;
        }
        for (key, value, most, allowed) in [
            (
                "errors.arm.velocity_noise_rad_per_s",
                self.velocity_noise_rad_per_s,
                0.1,
                "0 to 0.1 rad/s",
            ),
            (
                "errors.arm.ripple_rad",
                self.ripple_rad,
                0.01,
                "0 to 0.01 rad",
            ),
            (
                "errors.arm.ripple_per_turn",
                self.ripple_per_turn,
                10_000.0,
                "0 to 10000",
            ),
        ] {
            PlantError::unless(key, value, allowed, (0.0..=most).contains(&value))?;
        }
        for offset in self.offset_rad {
            PlantError::unless(
                "errors.arm.offset_rad",
                offset,
                "-0.1 to 0.1 rad",
                offset.abs() <= 0.1,
            )?;
        }
        Ok(())
    }
}

/// Encoders and velocity measurement of the arm, with their errors. One
/// [`measure`](ArmSenses::measure) per arm period.
#[derive(Clone, Debug)]
pub struct ArmSenses {
    errors: ArmErrors,
    rng: Pcg64Mcg,
    /// Phase of each joint's ripple, rad.
    phase: Joints<6>,
}

impl ArmSenses {
    /// Senses whose noise and phases follow from `seed`; `None` if they have no error.
    pub fn new(errors: &ArmErrors, seed: u64) -> Option<Self> {
        let exact = errors.velocity_noise_rad_per_s == 0.0
            && errors.ripple_rad == 0.0
            && errors.offset_rad == [0.0; 6];
        if exact {
            return None;
        }
        let mut rng = Pcg64Mcg::seed_from_u64(seed ^ 0x3a91_66f0_8e2d_417b);
        let mut phase = Joints::<6>::zeros();
        for angle in phase.iter_mut() {
            let draw: f64 = StandardNormal.sample(&mut rng);
            // Far wider than a turn, so that the phase is uniform over it.
            *angle = 20.0 * draw;
        }
        Some(Self {
            errors: *errors,
            rng,
            phase,
        })
    }

    /// Error of the measured position of joint `i` at `q` (rad), and its derivative.
    fn error(&self, i: usize, q: f64) -> (f64, f64) {
        let per_turn = self.errors.ripple_per_turn;
        let (sin, cos) = (per_turn * q + self.phase[i]).sin_cos();
        let ripple = self.errors.ripple_rad;
        (
            ripple * sin + self.errors.offset_rad[i],
            ripple * per_turn * cos,
        )
    }

    /// Measured positions (rad) and velocities (rad/s) of joints at `q` with `qd`.
    pub fn measure(&mut self, q: &Joints<6>, qd: &Joints<6>) -> (Joints<6>, Joints<6>) {
        let (mut position, mut velocity) = (*q, *qd);
        for i in 0..6 {
            let (error, slope) = self.error(i, q[i]);
            position[i] += error;
            velocity[i] += slope * qd[i];
            if self.errors.velocity_noise_rad_per_s > 0.0 {
                let draw: f64 = StandardNormal.sample(&mut self.rng);
                velocity[i] += self.errors.velocity_noise_rad_per_s * draw;
            }
        }
        (position, velocity)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exact_senses_are_none() {
        assert!(ArmSenses::new(&ArmErrors::default(), 1).is_none());
    }

    #[test]
    fn noise_is_as_wide_as_stated_and_offsets_are_constant() {
        let errors = ArmErrors {
            velocity_noise_rad_per_s: 5e-4,
            offset_rad: [3e-4, 0.0, 0.0, 0.0, 0.0, -2e-4],
            ..ArmErrors::default()
        };
        let mut senses = ArmSenses::new(&errors, 3).unwrap();
        let (q, qd) = (Joints::<6>::repeat(0.4), Joints::<6>::zeros());
        let mut squares = 0.0;
        for _ in 0..2000 {
            let (position, velocity) = senses.measure(&q, &qd);
            let off = position - q - Joints::<6>::from(errors.offset_rad);
            assert!(off.amax() < 1e-15);
            squares += velocity.norm_squared();
        }
        let sd = (squares / 12_000.0).sqrt();
        assert!((sd / 5e-4 - 1.0).abs() < 0.03, "{sd}");
    }

    #[test]
    fn the_ripple_of_velocity_is_the_derivative_of_that_of_position() {
        let errors = ArmErrors {
            ripple_rad: 5e-5,
            ..ArmErrors::default()
        };
        let mut senses = ArmSenses::new(&errors, 3).unwrap();
        let (q, qd, h) = (Joints::<6>::repeat(0.4), Joints::<6>::repeat(0.1), 1e-7);
        let after = senses.measure(&(q + qd * h), &qd).0;
        let (before, velocity) = senses.measure(&q, &qd);
        let difference = ((after - before) / h - velocity).amax();
        assert!(difference < 1e-7, "{difference}");
        assert!((velocity - qd).amax() > 1e-5);
    }
}
