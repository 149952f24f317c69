//! The average of a reading that becomes the zero, if the tool stood still meanwhile.

use nalgebra::Vector6;
use tangent_mechanics::{Base, Pose, Sensor, Tool, Wrench};

use super::config::{TareConfig, worst};
use super::refusal::TareRefusal;
use super::zero::Tare;

/// An average in progress.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Averaging {
    wanted: u32,
    taken: u32,
    /// First reading. Sums are relative to it, so that a large zero does not cancel the digits of
    /// the scatter.
    origin: Vector6<f64>,
    sum: Vector6<f64>,
    first_half: Vector6<f64>,
    squares: Vector6<f64>,
    pose: Option<Pose<Base, Tool>>,
}

impl Averaging {
    pub(crate) fn new(samples: u32) -> Self {
        Self {
            wanted: samples.max(2),
            taken: 0,
            origin: Vector6::zeros(),
            sum: Vector6::zeros(),
            first_half: Vector6::zeros(),
            squares: Vector6::zeros(),
            pose: None,
        }
    }

    /// Takes one good reading without the payload; `Some` when the average is complete or refused.
    pub(crate) fn take(
        &mut self,
        config: &TareConfig,
        reading: &Wrench<Sensor>,
        pose: Option<&Pose<Base, Tool>>,
        time_s: f64,
    ) -> Option<Result<Tare, TareRefusal>> {
        if self.taken == 0 {
            self.origin = reading.vector();
        }
        if let Some(now) = pose {
            let start = self.pose.get_or_insert(*now);
            let travel_m = (now.translation() - start.translation()).norm();
            let turn_rad = now.rotation().angle_to(&start.rotation());
            // Written so that a NaN is refused.
            if !(travel_m <= config.travel_max_m && turn_rad <= config.turn_max_rad) {
                return Some(Err(TareRefusal::Moving { travel_m, turn_rad }));
            }
        }
        let x = reading.vector() - self.origin;
        self.sum += x;
        self.squares += x.component_mul(&x);
        self.taken += 1;
        if self.taken == self.wanted / 2 {
            self.first_half = self.sum;
        }
        (self.taken == self.wanted).then(|| self.finish(config, time_s))
    }

    fn finish(&self, config: &TareConfig, time_s: f64) -> Result<Tare, TareRefusal> {
        let n = f64::from(self.taken);
        let half = f64::from(self.wanted / 2);
        let mean = self.sum / n;
        let variance = (self.squares - self.sum.component_mul(&mean)) / (n - 1.0);
        let std = variance.map(|v| v.max(0.0).sqrt());
        let (force_n, torque_nm) = worst(&std);
        if !(force_n <= config.force_std_max_n && torque_nm <= config.torque_std_max_nm) {
            return Err(TareRefusal::Scattered { force_n, torque_nm });
        }
        let change = (self.sum - self.first_half) / (n - half) - self.first_half / half;
        let (force_n, torque_nm) = worst(&change);
        if !(force_n <= config.force_change_max_n && torque_nm <= config.torque_change_max_nm) {
            return Err(TareRefusal::Wandering { force_n, torque_nm });
        }
        let bias = Wrench::from_vector(&(self.origin + mean));
        if let Some(force_max_n) = config.zero_max_n {
            let force_n = bias.force.norm();
            if force_n.is_nan() || force_n > force_max_n {
                return Err(TareRefusal::TooLarge {
                    force_n,
                    force_max_n,
                });
            }
        }
        Ok(Tare::first(
            bias,
            Wrench::from_vector(&std),
            self.taken,
            time_s,
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn averaged(config: &TareConfig, force_z: f64) -> Result<Tare, TareRefusal> {
        let reading = Wrench::from_vector(&Vector6::new(0.5, 0.0, force_z, 0.0, 0.0, 0.0));
        let mut averaging = Averaging::new(100);
        (0..100)
            .find_map(|i| averaging.take(config, &reading, None, f64::from(i) * 1e-3))
            .unwrap()
    }

    #[test]
    fn a_zero_beyond_the_largest_is_none() {
        let config = TareConfig {
            zero_max_n: Some(5.0),
            ..TareConfig::default()
        };
        assert!(averaged(&config, -1.5).is_ok());
        let refused = averaged(&config, -9.0);
        assert!(matches!(refused, Err(TareRefusal::TooLarge { force_n, .. }) if force_n > 9.0));
        // As strain gauges read.
        assert!(averaged(&TareConfig::default(), -90.0).is_ok());
        assert!(averaged(&config, f64::NAN).is_err());
    }
}
