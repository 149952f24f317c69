//! Errors of the force/torque sensor's readings beyond white noise and drift: coloured noise,
//! structural vibration, cross-talk, latency, and the pull of a cable.

use nalgebra::{Matrix6, Vector3, Vector6};
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};

use crate::plant_error::PlantError;

/// True readings against those of the sensor that the cell file states.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct WrenchErrors {
    /// Coloured noise of the forces (first-order Markov process), N, one standard deviation.
    pub coloured_n: f64,
    /// Coloured noise of the torques, Nm, one standard deviation.
    pub coloured_nm: f64,
    /// Correlation time of the coloured noise, s.
    pub correlation_s: f64,
    /// Amplitude of the structure's vibration while the arm moves, N, in a direction drawn from
    /// the seed. It acts at the payload: its torque has the lever `VIBRATION_LEVER_M`.
    pub vibration_n: f64,
    /// Frequency of the vibration, Hz.
    pub vibration_hz: f64,
    /// Cross-talk: largest share of one axis, relative to its rating, that appears in another
    /// one. The matrix is drawn from the seed.
    pub cross_talk: f64,
    /// Time from the load to the record that shows it, s. The record does not tell.
    pub latency_s: f64,
    /// Pull of a cable on the tool's side of the sensor, N per rad of rotation of each of the last
    /// three joints since the start.
    pub cable_n_per_rad: f64,
}

impl Default for WrenchErrors {
    fn default() -> Self {
        Self {
            coloured_n: 0.0,
            coloured_nm: 0.0,
            correlation_s: 0.1,
            vibration_n: 0.0,
            vibration_hz: 12.0,
            cross_talk: 0.0,
            latency_s: 0.0,
            cable_n_per_rad: 0.0,
        }
    }
}

/// Lever of the vibration's force along the sensor's z axis, m.
const VIBRATION_LEVER_M: f64 = 0.05;
/// Lever of the cable's pull along the sensor's z axis, m.
const CABLE_LEVER_M: f64 = 0.03;
/// Speed of the flange at which the vibration has half its amplitude, m/s.
const VIBRATION_SPEED_M_PER_S: f64 = 0.005;
/// Torque of a rating that goes with a force of 1 N, Nm: 10 Nm to 130 N of an ATI Gamma.
const TORQUE_PER_FORCE_M: f64 = 10.0 / 130.0;

impl WrenchErrors {
    pub(crate) fn check(&self) -> Result<(), PlantError> {
        for (key, value, least, most, allowed) in [
            (
                "errors.wrench.coloured_n",
                self.coloured_n,
                0.0,
                10.0,
                "0 to 10 N",
            ),
            (
                "errors.wrench.coloured_nm",
                self.coloured_nm,
                0.0,
                1.0,
                "0 to 1 Nm",
            ),
            (
                "errors.wrench.correlation_s",
                self.correlation_s,
                0.001,
                1000.0,
                "0.001 to 1000 s",
            ),
            (
                "errors.wrench.vibration_n",
                self.vibration_n,
                0.0,
                10.0,
                "0 to 10 N",
            ),
            (
                "errors.wrench.vibration_hz",
                self.vibration_hz,
                0.1,
                500.0,
                "0.1 to 500 Hz",
            ),
            (
                "errors.wrench.cross_talk",
                self.cross_talk,
                0.0,
                0.2,
                "0 to 0.2",
            ),
            (
                "errors.wrench.latency_s",
                self.latency_s,
                0.0,
                0.1,
                "0 to 0.1 s",
            ),
            (
                "errors.wrench.cable_n_per_rad",
                self.cable_n_per_rad,
                0.0,
                10.0,
                "0 to 10 N/rad",
            ),
        ] {
            PlantError::unless(key, value, allowed, (least..=most).contains(&value))?;
        }
        Ok(())
    }
}

/// State of the errors: what happens to the true wrench between the load and the gauges.
#[derive(Clone, Debug)]
pub struct WrenchDistortion {
    errors: WrenchErrors,
    rng: Pcg64Mcg,
    /// Identity plus cross-talk.
    mixing: Option<Matrix6<f64>>,
    /// Direction and phase (rad) of the vibration.
    vibration: (Vector3<f64>, f64),
    coloured: Vector6<f64>,
    /// Readings in transit, a ring; empty without latency.
    line: Vec<Vector6<f64>>,
    next: usize,
    /// Share of the coloured noise that is left after one record.
    keep: f64,
    /// Speed of the flange, m/s.
    speed: f64,
}

impl WrenchDistortion {
    /// Distortion of a sensor of `rate_hz`, with `wrench` (N, Nm, sensor axes) on it before the
    /// first record; `None` if there is none.
    pub fn new(
        errors: &WrenchErrors,
        rate_hz: f64,
        seed: u64,
        wrench: &Vector6<f64>,
    ) -> Option<Self> {
        let exact = errors.coloured_n == 0.0
            && errors.coloured_nm == 0.0
            && errors.vibration_n == 0.0
            && errors.cross_talk == 0.0
            && errors.latency_s == 0.0;
        if exact {
            return None;
        }
        let mut rng = Pcg64Mcg::seed_from_u64(seed ^ 0x91d4_2b07_c5e8_3f6a);
        let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
        let direction = Vector3::new(normal(), normal(), normal());
        let phase = 20.0 * normal();
        // Axes are compared at their ratings.
        let unit = |i: usize| if i < 3 { 1.0 } else { TORQUE_PER_FORCE_M };
        let mut mixing = Matrix6::identity();
        for i in 0..6 {
            for j in 0..6 {
                let share = normal().clamp(-2.0, 2.0) / 2.0;
                if i != j {
                    mixing[(i, j)] = errors.cross_talk * share * unit(i) / unit(j);
                }
            }
        }
        let coloured = Vector6::from_fn(|i, _| {
            normal()
                * if i < 3 {
                    errors.coloured_n
                } else {
                    errors.coloured_nm
                }
        });
        let length = direction.norm().max(1e-9);
        let delay = (errors.latency_s * rate_hz).round() as usize;
        Some(Self {
            mixing: (errors.cross_talk > 0.0).then_some(mixing),
            vibration: (direction / length, phase),
            coloured,
            line: vec![*wrench; delay],
            next: 0,
            keep: (-1.0 / (rate_hz * errors.correlation_s)).exp(),
            speed: 0.0,
            errors: *errors,
            rng,
        })
    }

    /// Sets the speed of the flange, m/s.
    pub fn set_speed(&mut self, speed: f64) {
        self.speed = speed;
    }

    /// Load that the record at `time_s` shows, for the true wrench of that time; one call per
    /// record. N and Nm, sensor axes.
    pub fn distort(&mut self, time_s: f64, wrench: &Vector6<f64>) -> Vector6<f64> {
        let mut load = *wrench;
        if let Some(old) = self.line.get_mut(self.next) {
            std::mem::swap(old, &mut load);
            self.next = (self.next + 1) % self.line.len();
        }
        let e = &self.errors;
        if e.vibration_n > 0.0 {
            let (direction, phase) = self.vibration;
            let share = self.speed / (self.speed + VIBRATION_SPEED_M_PER_S);
            let swing = (std::f64::consts::TAU * e.vibration_hz * time_s + phase).sin();
            let force = direction * (e.vibration_n * share * swing);
            load += at_lever(&force, VIBRATION_LEVER_M);
        }
        if let Some(mixing) = &self.mixing {
            load = mixing * load;
        }
        if e.coloured_n > 0.0 || e.coloured_nm > 0.0 {
            let fresh = (1.0 - self.keep * self.keep).sqrt();
            for i in 0..6 {
                let draw: f64 = StandardNormal.sample(&mut self.rng);
                let sd = if i < 3 { e.coloured_n } else { e.coloured_nm };
                self.coloured[i] = self.keep * self.coloured[i] + fresh * sd * draw;
            }
            load += self.coloured;
        }
        load
    }
}

/// Pull of the cable for a rotation of the last three joints by `turned` (rad), N and Nm, sensor
/// axes.
pub(crate) fn cable_pull(errors: &WrenchErrors, turned: &Vector3<f64>) -> Vector6<f64> {
    at_lever(&(turned * errors.cable_n_per_rad), CABLE_LEVER_M)
}

/// Wrench at the origin of a force that acts at `lever` (m) along z.
fn at_lever(force: &Vector3<f64>, lever: f64) -> Vector6<f64> {
    let torque = Vector3::new(0.0, 0.0, lever).cross(force);
    Vector6::new(force.x, force.y, force.z, torque.x, torque.y, torque.z)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn distortion(errors: WrenchErrors) -> WrenchDistortion {
        WrenchDistortion::new(&errors, 1000.0, 5, &Vector6::zeros()).unwrap()
    }

    #[test]
    fn without_errors_there_is_none() {
        let none = WrenchErrors::default();
        assert!(WrenchDistortion::new(&none, 1000.0, 1, &Vector6::zeros()).is_none());
    }

    #[test]
    fn a_late_sensor_shows_a_step_after_its_latency() {
        let mut late = distortion(WrenchErrors {
            latency_s: 0.008,
            ..WrenchErrors::default()
        });
        let step = Vector6::repeat(1.0);
        for i in 0..20 {
            let shown = late.distort(f64::from(i) * 1e-3, &step);
            assert_eq!(shown, if i < 8 { Vector6::zeros() } else { step }, "{i}");
        }
    }

    #[test]
    fn coloured_noise_has_its_size_and_its_correlation_time() {
        let mut noisy = distortion(WrenchErrors {
            coloured_n: 0.1,
            coloured_nm: 0.002,
            correlation_s: 0.05,
            ..WrenchErrors::default()
        });
        let x: Vec<f64> = (0..200_000)
            .map(|i| noisy.distort(f64::from(i) * 1e-3, &Vector6::zeros())[0])
            .collect();
        let at_lag = |lag: usize| {
            let n = x.len() - lag;
            (0..n).map(|i| x[i] * x[i + lag]).sum::<f64>() / n as f64
        };
        let sd = at_lag(0).sqrt();
        assert!((sd / 0.1 - 1.0).abs() < 0.1, "{sd}");
        let correlation = at_lag(50) / at_lag(0);
        assert!(
            (correlation - (-1.0f64).exp()).abs() < 0.08,
            "{correlation}"
        );
    }

    #[test]
    fn vibration_needs_motion_and_cross_talk_keeps_the_axis_itself() {
        let mut shaking = distortion(WrenchErrors {
            vibration_n: 0.2,
            ..WrenchErrors::default()
        });
        assert_eq!(shaking.distort(0.01, &Vector6::zeros()), Vector6::zeros());
        shaking.set_speed(1.0);
        let force = |w: Vector6<f64>| w.fixed_rows::<3>(0).norm();
        let most = (0..1000)
            .map(|i| force(shaking.distort(f64::from(i) * 1e-3, &Vector6::zeros())))
            .fold(0.0, f64::max);
        assert!((most - 0.2).abs() < 0.005, "{most}");

        let mut mixed = distortion(WrenchErrors {
            cross_talk: 0.01,
            ..WrenchErrors::default()
        });
        let load = Vector6::new(0.0, 0.0, 10.0, 0.0, 0.0, 0.0);
        let shown = mixed.distort(0.0, &load);
        assert_eq!(shown[2], 10.0);
        assert!(shown[0] != 0.0 && shown[0].abs() <= 0.1 && shown[3].abs() <= 0.1);
    }

    #[test]
    fn a_cable_pulls_in_proportion_to_the_rotation() {
        let errors = WrenchErrors {
            cable_n_per_rad: 0.3,
            ..WrenchErrors::default()
        };
        let pull = cable_pull(&errors, &Vector3::new(0.0, 0.5, 0.0));
        assert!((pull[1] - 0.15).abs() < 1e-15 && (pull[3] + 0.0045).abs() < 1e-15);
    }
}
