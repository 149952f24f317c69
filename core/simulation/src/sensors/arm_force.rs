//! Force on the flange as a velocity-controlled arm's own controller states it: from the currents
//! of its motors on a UR of the CB series, far less accurate than a force/torque sensor.

use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};

use crate::plant_error::PlantError;

/// The `[plant.arm_force]` table. The defaults are of a CB3 arm: UR states a precision of 10 N, and
/// an owner measured a standard deviation of 3.6 N at rest (UR forum, "Internal Force Sensor
/// properties"). The share of friction in the 10 N is assumed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ArmForceConfig {
    /// Whether the arm states a force.
    pub stated: bool,
    /// Largest constant error per axis, N, drawn from the seed.
    pub offset_n: f64,
    /// Error along the direction of motion, N: friction in the joints that the arm's model does not
    /// contain.
    pub friction_n: f64,
    /// White noise per period, standard deviation, N.
    pub noise_n: f64,
}

impl Default for ArmForceConfig {
    fn default() -> Self {
        Self {
            stated: true,
            offset_n: 10.0,
            friction_n: 5.0,
            noise_n: 3.6,
        }
    }
}

impl ArmForceConfig {
    /// Checks that every number is in its range.
    pub(crate) fn check(&self) -> Result<(), PlantError> {
        for (key, x) in [
            ("arm_force.offset_n", self.offset_n),
            ("arm_force.friction_n", self.friction_n),
            ("arm_force.noise_n", self.noise_n),
        ] {
            PlantError::unless(key, x, "0 to 100 N", (0.0..=100.0).contains(&x))?;
        }
        Ok(())
    }
}

/// Speed of the flange below which friction is not fully developed, m/s.
const MOVES_M_PER_S: f64 = 1e-4;

/// The arm's estimate and its errors.
#[derive(Clone, Debug)]
pub(crate) struct ArmForce {
    config: ArmForceConfig,
    offset: Vector3<f64>,
    rng: Pcg64Mcg,
    now: Option<Vector3<f64>>,
}

impl ArmForce {
    pub fn new(config: &ArmForceConfig, seed: u64) -> Self {
        let mut rng = Pcg64Mcg::seed_from_u64(seed ^ 0x3c61_9d0f_58b2_e7a4);
        let offset = Vector3::from_fn(|_, _| config.offset_n * rng.random_range(-1.0..=1.0));
        Self {
            config: *config,
            offset,
            rng,
            now: None,
        }
    }

    /// One period that ended with the true force `load` (N) on a flange that moves by `velocity`
    /// (m/s), both flange axes.
    pub fn measure(&mut self, load: &Vector3<f64>, velocity: &Vector3<f64>) {
        if !self.config.stated {
            return;
        }
        let noise = Vector3::from_fn(|_, _| StandardNormal.sample(&mut self.rng));
        let moved = velocity / (velocity.norm() + MOVES_M_PER_S);
        let friction = moved * -self.config.friction_n;
        self.now = Some(load + self.offset + friction + noise * self.config.noise_n);
    }

    /// Force of the last period, flange axes, N; `None` if the arm states none.
    pub fn now(&self) -> Option<Vector3<f64>> {
        self.now
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_errors_are_as_stated() {
        let config = ArmForceConfig::default();
        let mut force = ArmForce::new(&config, 1);
        let load = Vector3::new(0.0, 0.0, -20.0);
        let read = |force: &mut ArmForce, velocity: Vector3<f64>| {
            let n = 4000;
            let read: Vec<Vector3<f64>> = (0..n)
                .map(|_| {
                    force.measure(&load, &velocity);
                    force.now().unwrap()
                })
                .collect();
            let mean = read.iter().sum::<Vector3<f64>>() / f64::from(n);
            let variance = read.iter().map(|x| (x.z - mean.z).powi(2)).sum::<f64>() / f64::from(n);
            (mean, variance.sqrt())
        };
        let (rest, noise_n) = read(&mut force, Vector3::zeros());
        assert!((noise_n / config.noise_n - 1.0).abs() < 0.05, "{noise_n}");
        assert!((rest - load).amax() < config.offset_n + 0.3, "{rest}");
        let (down, _) = read(&mut force, Vector3::new(0.0, 0.0, 0.01));
        assert!((down.z - rest.z + config.friction_n).abs() < 0.4, "{down}");
    }
}
