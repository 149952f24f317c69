//! The sensor's zero: averaged on request while nothing touches and nothing moves, and refused otherwise.

use nalgebra::Vector6;
use serde::{Deserialize, Serialize};
use tangent_mechanics::{Base, Pose, Sensor, Tool, Wrench};

use crate::{SensingError, Validity};

/// When an average may be taken for the sensor's zero.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TareConfig {
    /// Time averaged, s.
    pub duration_s: f64,
    /// Standard deviation of any force within that time, N: above, something shakes.
    pub force_std_max_n: f64,
    /// The same of any torque, Nm.
    pub torque_std_max_nm: f64,
    /// Change of any mean force from the first half to the second, N: above, something pulls or the arm still settles.
    pub force_change_max_n: f64,
    /// The same of any torque, Nm.
    pub torque_change_max_nm: f64,
    /// Motion of the tool's origin within that time, m.
    pub travel_max_m: f64,
    /// Turn of the tool within that time, rad.
    pub turn_max_rad: f64,
}

impl Default for TareConfig {
    fn default() -> Self {
        Self {
            duration_s: 0.5,
            force_std_max_n: 0.5,
            torque_std_max_nm: 0.05,
            force_change_max_n: 0.15,
            torque_change_max_nm: 0.015,
            travel_max_m: 0.0005,
            turn_max_rad: 0.002,
        }
    }
}

impl TareConfig {
    /// # Errors
    /// A number that is not positive and finite.
    pub fn check(&self) -> Result<(), SensingError> {
        for (key, value) in [
            ("tare.duration_s", self.duration_s),
            ("tare.force_std_max_n", self.force_std_max_n),
            ("tare.torque_std_max_nm", self.torque_std_max_nm),
            ("tare.force_change_max_n", self.force_change_max_n),
            ("tare.torque_change_max_nm", self.torque_change_max_nm),
            ("tare.travel_max_m", self.travel_max_m),
            ("tare.turn_max_rad", self.turn_max_rad),
        ] {
            SensingError::unless(value.is_finite() && value > 0.0, key, value, "positive")?;
        }
        Ok(())
    }
}

/// The sensor's zero as measured once: everything it reads beyond payload and contact.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tare {
    /// To be subtracted from every reading, besides the payload's wrench.
    pub bias: Wrench<Sensor>,
    /// Standard deviation of the readings it is the mean of.
    pub std: Wrench<Sensor>,
    /// How many readings.
    pub samples: u32,
    /// When it was finished, on the clock of [`crate::Reading::time_s`].
    pub time_s: f64,
}

/// Why no tare was made. The tare before it stays in force.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum TareRefusal {
    /// A reading could not be used.
    #[error("a reading was unusable ({}): clear that first", .0.reason())]
    BadReading(Validity),
    /// There is a payload and nobody says how it hangs.
    #[error(
        "the arm's orientation is {}: without it the payload's weight cannot be told from the zero; is the robot's bridge running?",
        .0.reason()
    )]
    NoOrientation(Validity),
    /// The arm moved.
    #[error(
        "the tool moved by {travel_m:.4} m and {turn_rad:.4} rad while averaging: hold it still"
    )]
    Moving {
        /// m
        travel_m: f64,
        /// rad
        turn_rad: f64,
    },
    /// The readings scatter.
    #[error(
        "the readings scatter by {force_n:.3} N and {torque_nm:.4} Nm (standard deviation, worst axis): something shakes or touches the tool"
    )]
    Scattered {
        /// Worst axis, N.
        force_n: f64,
        /// Worst axis, Nm.
        torque_nm: f64,
    },
    /// The readings wander.
    #[error(
        "the readings moved by {force_n:.3} N and {torque_nm:.4} Nm while averaging: something pulls at the tool, or it has not settled"
    )]
    Wandering {
        /// Worst axis, N.
        force_n: f64,
        /// Worst axis, Nm.
        torque_nm: f64,
    },
}

/// An average being taken.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Averaging {
    wanted: u32,
    taken: u32,
    /// First reading; sums are relative to it, so that squares of large zeros do not swallow the scatter.
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

    /// Takes one good reading less the payload; `Some` when the average is complete or refused.
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
            // Written so that a NaN refuses.
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
        let worst = |v: &Vector6<f64>| (v.fixed_rows::<3>(0).amax(), v.fixed_rows::<3>(3).amax());
        let (force_n, torque_nm) = worst(&std);
        if !(force_n <= config.force_std_max_n && torque_nm <= config.torque_std_max_nm) {
            return Err(TareRefusal::Scattered { force_n, torque_nm });
        }
        let change = (self.sum - self.first_half) / (n - half) - self.first_half / half;
        let (force_n, torque_nm) = worst(&change);
        if !(force_n <= config.force_change_max_n && torque_nm <= config.torque_change_max_nm) {
            return Err(TareRefusal::Wandering { force_n, torque_nm });
        }
        Ok(Tare {
            bias: Wrench::from_vector(&(self.origin + mean)),
            std: Wrench::from_vector(&std),
            samples: self.taken,
            time_s,
        })
    }
}
