//! The force/torque sensor in the flange of an e-Series arm: offset, slow drift and noise on the
//! load of the plant.

use std::f64::consts::TAU;

use nalgebra::{UnitQuaternion, Vector6};
use serde::{Deserialize, Serialize};
use tangent_mechanics::{Flange, Wrench};
use tangent_simulation::FlangeLoad;

/// Errors of the sensor. The data sheet of a UR5e states 50 N and 10 Nm of range, 3.5 N and 0.2 Nm
/// of precision; the share of noise and drift in these is assumed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct OwnSensorConfig {
    /// Standard deviation of the noise of a force, N.
    pub force_noise_n: f64,
    /// Standard deviation of the noise of a torque, Nm.
    pub torque_noise_nm: f64,
    /// Amplitude of the drift of a force, N.
    pub force_drift_n: f64,
    /// Amplitude of the drift of a torque, Nm.
    pub torque_drift_nm: f64,
    /// Period of the drift, s.
    pub drift_period_s: f64,
    /// Offset of the raw forces without a load, N.
    pub force_offset_n: [f64; 3],
    /// Offset of the raw torques without a load, Nm.
    pub torque_offset_nm: [f64; 3],
    /// Seed of the noise.
    pub seed: u64,
}

impl Default for OwnSensorConfig {
    fn default() -> Self {
        Self {
            force_noise_n: 0.2,
            torque_noise_nm: 0.01,
            force_drift_n: 1.5,
            torque_drift_nm: 0.03,
            drift_period_s: 1200.0,
            force_offset_n: [1.5, -0.8, 2.0],
            torque_offset_nm: [0.05, -0.02, 0.03],
            seed: 1,
        }
    }
}

/// Reading of one cycle, in the form of the RTDE outputs: N, then Nm.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct OwnReading {
    /// `ft_raw_wrench`: at the flange, flange axes, with the weight of the payload.
    pub ft_raw_wrench: [f64; 6],
    /// `actual_TCP_force`: at the flange, base axes, without the weight of the payload. Zeroed when
    /// a program starts.
    pub tcp_force: [f64; 6],
}

/// The sensor with its state.
#[derive(Clone, Debug)]
pub struct OwnSensor {
    config: OwnSensorConfig,
    random: u64,
    /// Wrench that was subtracted when the last program started, flange axes.
    zero: Vector6<f64>,
    playing: bool,
}

impl OwnSensor {
    /// A sensor that has not been zeroed.
    pub fn new(config: &OwnSensorConfig) -> Self {
        Self {
            random: config.seed,
            config: config.clone(),
            zero: Vector6::zeros(),
            playing: false,
        }
    }

    /// Reading at `time_s` of the controller's clock, of a flange that is turned by
    /// `base_from_flange`. `playing`: whether a program runs.
    pub fn read(
        &mut self,
        load: &FlangeLoad,
        base_from_flange: &UnitQuaternion<f64>,
        time_s: f64,
        playing: bool,
    ) -> OwnReading {
        let error = self.drift(time_s) + self.noise();
        let contact = load.contact.vector() + error;
        if playing && !self.playing {
            self.zero = contact;
        }
        self.playing = playing;
        let raw = contact + load.weight.vector();
        let compensated = Wrench::<Flange>::from_vector(&(contact - self.zero));
        let (force, torque) = (
            base_from_flange * compensated.force,
            base_from_flange * compensated.torque,
        );
        OwnReading {
            ft_raw_wrench: raw.into(),
            tcp_force: [force.x, force.y, force.z, torque.x, torque.y, torque.z],
        }
    }

    /// Offset and drift at this time.
    fn drift(&self, time_s: f64) -> Vector6<f64> {
        let config = &self.config;
        let turn = TAU * time_s / config.drift_period_s;
        Vector6::from_fn(|i, _| {
            let (offset, amplitude) = if i < 3 {
                (config.force_offset_n[i], config.force_drift_n)
            } else {
                (config.torque_offset_nm[i - 3], config.torque_drift_nm)
            };
            offset + amplitude * (turn + i as f64).sin()
        })
    }

    fn noise(&mut self) -> Vector6<f64> {
        let (force, torque) = (self.config.force_noise_n, self.config.torque_noise_nm);
        Vector6::from_fn(|i, _| self.normal() * if i < 3 { force } else { torque })
    }

    /// Standard normal: the sum of twelve uniform numbers, minus six.
    fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
    }

    /// Uniform in 0 to 1: splitmix64.
    fn uniform(&mut self) -> f64 {
        self.random = self.random.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.random;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;

    fn load() -> FlangeLoad {
        FlangeLoad {
            contact: Wrench::new(Vector3::new(0.0, 0.0, -12.0), Vector3::zeros()),
            weight: Wrench::new(Vector3::new(0.0, 0.0, 3.0), Vector3::zeros()),
        }
    }

    #[test]
    fn the_readings_differ_by_weight_axes_and_zero() {
        let config = OwnSensorConfig {
            force_noise_n: 0.0,
            torque_noise_nm: 0.0,
            force_drift_n: 0.0,
            torque_drift_nm: 0.0,
            force_offset_n: [0.0, 0.0, 2.0],
            torque_offset_nm: [0.0; 3],
            ..OwnSensorConfig::default()
        };
        let mut sensor = OwnSensor::new(&config);
        // The flange points down.
        let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
        let reading = sensor.read(&load(), &down, 0.0, false);
        assert!((reading.ft_raw_wrench[2] - (-12.0 + 3.0 + 2.0)).abs() < 1e-12);
        assert!((reading.tcp_force[2] - 10.0).abs() < 1e-12);
        let free = sensor.read(&FlangeLoad::none(), &down, 0.0, true);
        assert!(
            free.tcp_force[2].abs() < 1e-12,
            "zeroed as the program starts"
        );
        let pressed = sensor.read(&load(), &down, 0.0, true);
        assert!((pressed.tcp_force[2] - 12.0).abs() < 1e-12);
        assert!((pressed.ft_raw_wrench[2] - reading.ft_raw_wrench[2]).abs() < 1e-12);
    }

    #[test]
    fn the_noise_is_as_stated() {
        let config = OwnSensorConfig {
            force_drift_n: 0.0,
            ..OwnSensorConfig::default()
        };
        let mut sensor = OwnSensor::new(&config);
        let none = FlangeLoad::none();
        let turn = UnitQuaternion::identity();
        let n = 5000;
        let square: f64 = (0..n)
            .map(|_| {
                let reading = sensor.read(&none, &turn, 0.0, false);
                (reading.ft_raw_wrench[0] - config.force_offset_n[0]).powi(2)
            })
            .sum();
        let std = (square / f64::from(n)).sqrt();
        assert!((std / config.force_noise_n - 1.0).abs() < 0.05, "{std}");
    }
}
