//! The sensor's zero: averaged on request while the tool is at rest and without contact, and
//! refused otherwise.

use nalgebra::Vector6;
use serde::{Deserialize, Serialize};
use tangent_mechanics::{Base, Pose, Sensor, Tool, Wrench};

use crate::{SensingError, Validity};

/// Conditions under which an average is accepted as the sensor's zero.
///
/// ```
/// use tangent_sensing::TareConfig;
/// let config = TareConfig { drift_n_per_min: 0.06, ..TareConfig::default() };
/// config.check()?;
/// assert!((config.drift_bound_n(600.0) - 0.6).abs() < 1e-12);
/// # Ok::<(), tangent_sensing::SensingError>(())
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TareConfig {
    /// Averaging time, s.
    pub duration_s: f64,
    /// Largest standard deviation of any force during the averaging, N; above it, something shakes
    /// the tool.
    pub force_std_max_n: f64,
    /// Largest standard deviation of any torque during the averaging, Nm; above it, something
    /// shakes the tool.
    pub torque_std_max_nm: f64,
    /// Largest change of any mean force from the first half of the averaging to the second, N;
    /// above it, something pulls at the tool, or the arm has not settled.
    pub force_change_max_n: f64,
    /// Largest change of any mean torque from the first half of the averaging to the second, Nm;
    /// above it, something pulls at the tool, or the arm has not settled.
    pub torque_change_max_nm: f64,
    /// Largest motion of the tool's origin during the averaging, m.
    pub travel_max_m: f64,
    /// Largest rotation of the tool during the averaging, rad.
    pub turn_max_rad: f64,
    /// Largest difference between a new zero and the last good one, besides the drift in between, N
    /// in any axis. It refuses a zero that was taken under a load.
    pub jump_max_n: f64,
    /// Largest difference between a new zero and the last good one, besides the drift in between,
    /// Nm in any axis.
    pub jump_max_nm: f64,
    /// Stated drift of the sensor's zero, N per minute. It bounds the error of a zero by its age.
    pub drift_n_per_min: f64,
    /// Stated drift of the sensor's zero, Nm per minute.
    pub drift_nm_per_min: f64,
    /// Largest part of a jump that the force's drift may explain while nothing has shown that the
    /// tool is free of contact, N.
    pub drift_max_n: f64,
    /// Largest part of a jump that the torque's drift may explain while nothing has shown that the
    /// tool is free of contact, Nm.
    pub drift_max_nm: f64,
    /// Age beyond which the last good zero is not compared with a new one, s.
    pub reference_age_max_s: f64,
    /// Rated loads of the sensor: N, then Nm; x, y, z. `None`: not known.
    pub rated: Option<[f64; 6]>,
    /// Largest share of the rated load that a zero may take in any axis.
    pub rated_share_max: f64,
    /// Largest force of a zero, N, even if a person confirms that the tool is free. For a reading
    /// that is known to be near zero without a load. `None` for strain gauges, whose zero is
    /// arbitrary.
    pub zero_max_n: Option<f64>,
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
            jump_max_n: 0.3,
            jump_max_nm: 0.05,
            drift_n_per_min: 0.05,
            drift_nm_per_min: 0.005,
            drift_max_n: 1.0,
            drift_max_nm: 0.1,
            reference_age_max_s: 12.0 * 3600.0,
            rated: None,
            rated_share_max: 0.5,
            zero_max_n: None,
        }
    }
}

impl TareConfig {
    /// Checks every number.
    ///
    /// # Errors
    /// The first number that is not positive and finite.
    pub fn check(&self) -> Result<(), SensingError> {
        for (key, value) in [
            ("tare.duration_s", self.duration_s),
            ("tare.force_std_max_n", self.force_std_max_n),
            ("tare.torque_std_max_nm", self.torque_std_max_nm),
            ("tare.force_change_max_n", self.force_change_max_n),
            ("tare.torque_change_max_nm", self.torque_change_max_nm),
            ("tare.travel_max_m", self.travel_max_m),
            ("tare.turn_max_rad", self.turn_max_rad),
            ("tare.jump_max_n", self.jump_max_n),
            ("tare.jump_max_nm", self.jump_max_nm),
            ("tare.drift_n_per_min", self.drift_n_per_min),
            ("tare.drift_nm_per_min", self.drift_nm_per_min),
            ("tare.drift_max_n", self.drift_max_n),
            ("tare.drift_max_nm", self.drift_max_nm),
            ("tare.reference_age_max_s", self.reference_age_max_s),
            ("tare.rated_share_max", self.rated_share_max),
        ] {
            SensingError::unless(value.is_finite() && value > 0.0, key, value, "positive")?;
        }
        if let Some(value) = self.zero_max_n {
            let good = value.is_finite() && value > 0.0;
            SensingError::unless(good, "tare.zero_max_n", value, "positive")?;
        }
        for value in self.rated.into_iter().flatten() {
            let good = value.is_finite() && value > 0.0;
            SensingError::unless(good, "tare.rated", value, "positive")?;
        }
        Ok(())
    }

    /// Bound on the error of a zero of this age, by the sensor's stated drift, N.
    pub fn drift_bound_n(&self, age_s: f64) -> f64 {
        self.drift_n_per_min * age_s.max(0.0) / 60.0
    }

    /// Largest share of the rated load that a wrench takes in any axis; `None` if the rating is not
    /// known.
    pub fn rated_share(&self, wrench: &Wrench<Sensor>) -> Option<f64> {
        let rated = Vector6::from(self.rated?);
        Some(wrench.vector().component_div(&rated).amax())
    }

    /// Judges a new zero, measured on this ground, against the zero before it and the sensor's
    /// rating. A zero that a person has confirmed is not judged.
    ///
    /// # Errors
    /// [`TareRefusal::Jump`] or [`TareRefusal::Loaded`].
    pub fn judge(
        &self,
        tare: &Tare,
        ground: TareGround,
        before: Option<&Tare>,
    ) -> Result<(), TareRefusal> {
        let (last, drift_max_n, drift_max_nm) = match (ground, before) {
            (TareGround::SaidClear, _) => return Ok(()),
            // A drift over hours cannot be distinguished from a load, so a person has to check.
            (TareGround::Assumed, Some(before)) => {
                (Some(before.vouched), self.drift_max_n, self.drift_max_nm)
            }
            (TareGround::Shown, Some(before)) => {
                (Some(before.zero()), f64::INFINITY, f64::INFINITY)
            }
            (_, None) => (None, 0.0, 0.0),
        };
        if let Some(last) = last {
            let age_s = (tare.time_s - last.time_s).max(0.0);
            let jump = (tare.bias - last.bias).vector();
            let (force_n, torque_nm) = worst(&jump);
            let minutes = age_s / 60.0;
            let force_max_n = self.jump_max_n + (self.drift_n_per_min * minutes).min(drift_max_n);
            let torque_max_nm =
                self.jump_max_nm + (self.drift_nm_per_min * minutes).min(drift_max_nm);
            // Written so that a NaN is refused.
            let near = force_n <= force_max_n && torque_nm <= torque_max_nm;
            if age_s <= self.reference_age_max_s && !near {
                return Err(TareRefusal::Jump {
                    force_n,
                    force_max_n,
                    torque_nm,
                    torque_max_nm,
                    age_s,
                });
            }
        }
        match self.rated_share(&tare.bias) {
            Some(share) if share.is_nan() || share > self.rated_share_max => {
                Err(TareRefusal::Loaded {
                    share,
                    share_max: self.rated_share_max,
                })
            }
            _ => Ok(()),
        }
    }
}

/// Largest force (N) and torque (Nm) in any axis.
fn worst(v: &Vector6<f64>) -> (f64, f64) {
    (v.fixed_rows::<3>(0).amax(), v.fixed_rows::<3>(3).amax())
}

/// A measured zero of the sensor: its reading without payload and contact.
///
/// ```
/// use nalgebra::Vector3;
/// use tangent_mechanics::{Sensor, Wrench};
/// use tangent_sensing::{Tare, TareConfig, TareGround, TareRefusal};
///
/// let zero = |force_n: f64, time_s: f64| {
///     let bias = Wrench::<Sensor>::new(Vector3::new(0.0, 0.0, force_n), Vector3::zeros());
///     Tare::first(bias, Wrench::zero(), 500, time_s)
/// };
/// let (before, now) = (zero(12.0, 0.0), zero(15.0, 60.0));
/// // A jump of 3 N within a minute may be a load, unless a person confirms that the tool is free.
/// let config = TareConfig::default();
/// let refusal = config.judge(&now, TareGround::Assumed, Some(&before)).unwrap_err();
/// assert!(matches!(refusal, TareRefusal::Jump { .. }));
/// assert!(config.judge(&now, TareGround::SaidClear, Some(&before)).is_ok());
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tare {
    /// Wrench to subtract from every reading, besides that of the payload, N and Nm.
    pub bias: Wrench<Sensor>,
    /// Standard deviation of the averaged readings, N and Nm.
    pub std: Wrench<Sensor>,
    /// Number of readings averaged.
    pub samples: u32,
    /// Time at which the average was complete, on the clock of [`crate::Reading::time_s`], s.
    pub time_s: f64,
    /// Evidence that the tool was free of contact meanwhile.
    pub ground: TareGround,
    /// The zero that later ones are judged against: the last one that a person or a motion has
    /// confirmed. Small jumps therefore do not add up.
    pub vouched: ZeroPoint,
    /// The last zero after a motion had shown that the tool was free of contact, or the first zero
    /// of all. The limit on the untared reading is relative to it, so that no later zero can hide a
    /// load.
    pub shown: ZeroPoint,
}

impl Tare {
    /// First zero of a sensor, without another to judge it by.
    pub fn first(bias: Wrench<Sensor>, std: Wrench<Sensor>, samples: u32, time_s: f64) -> Self {
        let zero = ZeroPoint { bias, time_s };
        Self {
            bias,
            std,
            samples,
            time_s,
            ground: TareGround::Assumed,
            vouched: zero,
            shown: zero,
        }
    }

    /// This zero as the successor of the one before it.
    pub fn following(self, ground: TareGround, before: Option<&Self>) -> Self {
        let (vouched, shown) = match (ground, before) {
            (TareGround::Shown, _) | (_, None) => (self.zero(), self.zero()),
            (TareGround::SaidClear, Some(before)) => (self.zero(), before.shown),
            (TareGround::Assumed, Some(before)) => (before.vouched, before.shown),
        };
        Self {
            ground,
            vouched,
            shown,
            ..self
        }
    }

    /// Bias and time of this zero.
    pub fn zero(&self) -> ZeroPoint {
        ZeroPoint {
            bias: self.bias,
            time_s: self.time_s,
        }
    }
}

/// Evidence that the tool is free of contact while a zero is taken.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TareGround {
    /// None, except that the zero is near the one before.
    #[default]
    Assumed,
    /// A person has confirmed that the tool is free.
    SaidClear,
    /// A motion away from the surface has shown it.
    Shown,
}

/// A zero and its time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ZeroPoint {
    /// Reading of the sensor without the payload, N and Nm.
    pub bias: Wrench<Sensor>,
    /// Time on the clock of [`crate::Reading::time_s`], s.
    pub time_s: f64,
}

/// Why a tare was refused. The zero before it stays in force.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum TareRefusal {
    /// A reading was not usable.
    #[error("a reading was unusable ({}): correct that first", .0.reason())]
    BadReading(Validity),
    /// There is a payload, and the orientation of the arm is not known.
    #[error(
        "the arm's orientation is {}: without it the payload's weight cannot be separated from the zero; is the robot's \
         bridge running?",
        .0.reason()
    )]
    NoOrientation(Validity),
    /// The tool moved.
    #[error(
        "the tool moved by {travel_m:.4} m and {turn_rad:.4} rad during the average: hold it still"
    )]
    Moving {
        /// Distance moved, m.
        travel_m: f64,
        /// Rotation, rad.
        turn_rad: f64,
    },
    /// The standard deviation of the readings is too large.
    #[error(
        "the readings scatter by {force_n:.3} N and {torque_nm:.4} Nm (standard deviation, worst axis): the tool vibrates \
         or touches something"
    )]
    Scattered {
        /// Standard deviation in the worst axis, N.
        force_n: f64,
        /// Standard deviation in the worst axis, Nm.
        torque_nm: f64,
    },
    /// The mean changed from the first half to the second.
    #[error(
        "the readings drifted by {force_n:.3} N and {torque_nm:.4} Nm during the average: something pulls at the tool, or \
         it has not settled"
    )]
    Wandering {
        /// Change of the mean in the worst axis, N.
        force_n: f64,
        /// Change of the mean in the worst axis, Nm.
        torque_nm: f64,
    },
    /// The new zero differs too much from the last good one.
    #[error(
        "the zero would differ by {force_n:.2} N and {torque_nm:.3} Nm: if the tool hangs free, run `tangent tare --clear`; \
         else it touches something, or was changed. The last good zero is {age_s:.0} s old; drift explains {force_max_n:.2} \
         N and {torque_max_nm:.3} Nm"
    )]
    Jump {
        /// Difference in the worst axis, N.
        force_n: f64,
        /// Largest difference allowed at that age, N.
        force_max_n: f64,
        /// Difference in the worst axis, Nm.
        torque_nm: f64,
        /// Largest difference allowed at that age, Nm.
        torque_max_nm: f64,
        /// Age of the last good zero, s.
        age_s: f64,
    },
    /// The mean force is too large for a zero.
    #[error(
        "the mean force at rest is {force_n:.1} N, and a zero is at most {force_max_n} N: the tool touches something, or \
         its mass is set wrong"
    )]
    TooLarge {
        /// Mean force, N.
        force_n: f64,
        /// Largest mean force allowed, N.
        force_max_n: f64,
    },
    /// The zero would take too large a share of the sensor's rating.
    #[error(
        "the sensor reads {:.0} % of its rating beyond the payload, and a zero is at most {:.0} %: the tool touches \
         something, or the payload is wrong. If you see that it hangs free, run `tangent tare --clear`",
        100.0 * .share, 100.0 * .share_max
    )]
    Loaded {
        /// Share of the rating in the worst axis, from 0; above 1 beyond the rating.
        share: f64,
        /// Largest share allowed.
        share_max: f64,
    },
}

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
