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
    /// Farthest that a new zero may be from the last good one, N in any axis, besides what drifts in between: a zero taken
    /// under a load is refused.
    pub jump_max_n: f64,
    /// The same, Nm.
    pub jump_max_nm: f64,
    /// Stated drift of the sensor's zero, N per minute: bounds the error of a zero of some age.
    pub drift_n_per_min: f64,
    /// The same, Nm per minute.
    pub drift_nm_per_min: f64,
    /// A last good zero that is older says nothing about a new one, s.
    pub reference_age_max_s: f64,
    /// What the sensor is rated for: N, then Nm; x, y, z. None: not known.
    pub rated: Option<[f64; 6]>,
    /// Largest share of that which a zero may take in any axis.
    pub rated_share_max: f64,
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
            reference_age_max_s: 12.0 * 3600.0,
            rated: None,
            rated_share_max: 0.5,
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
            ("tare.jump_max_n", self.jump_max_n),
            ("tare.jump_max_nm", self.jump_max_nm),
            ("tare.drift_n_per_min", self.drift_n_per_min),
            ("tare.drift_nm_per_min", self.drift_nm_per_min),
            ("tare.reference_age_max_s", self.reference_age_max_s),
            ("tare.rated_share_max", self.rated_share_max),
        ] {
            SensingError::unless(value.is_finite() && value > 0.0, key, value, "positive")?;
        }
        for value in self.rated.into_iter().flatten() {
            let good = value.is_finite() && value > 0.0;
            SensingError::unless(good, "tare.rated", value, "positive")?;
        }
        Ok(())
    }

    /// Error of a zero of this age that the sensor's stated drift implies, N.
    pub fn drift_bound_n(&self, age_s: f64) -> f64 {
        self.drift_n_per_min * age_s.max(0.0) / 60.0
    }

    /// Largest share of the sensor's rating that a wrench takes in any axis; none where the rating is not known.
    pub fn rated_share(&self, wrench: &Wrench<Sensor>) -> Option<f64> {
        let rated = Vector6::from(self.rated?);
        Some(wrench.vector().component_div(&rated).amax())
    }

    /// Whether a new zero can be one: against the last good zero as far as that still says something, and against the rating.
    ///
    /// # Errors
    /// [`TareRefusal::Jump`] or [`TareRefusal::Loaded`].
    pub fn judge(&self, tare: &Tare, reference: Option<&Tare>) -> Result<(), TareRefusal> {
        if let Some(last) = reference {
            let age_s = (tare.time_s - last.time_s).max(0.0);
            let jump = (tare.bias - last.bias).vector();
            let (force_n, torque_nm) = worst(&jump);
            let minutes = age_s / 60.0;
            let force_max_n = self.jump_max_n + self.drift_n_per_min * minutes;
            let torque_max_nm = self.jump_max_nm + self.drift_nm_per_min * minutes;
            // Written so that a NaN refuses.
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

/// Largest force and torque in any axis.
fn worst(v: &Vector6<f64>) -> (f64, f64) {
    (v.fixed_rows::<3>(0).amax(), v.fixed_rows::<3>(3).amax())
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
    /// It was taken on a person's word that the tool hangs free, and not judged.
    pub said_clear: bool,
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
    /// The new zero is far from the last good one.
    #[error(
        "the zero would jump by {force_n:.2} N and {torque_nm:.3} Nm against the last good one, {age_s:.0} s ago; drift explains {force_max_n:.2} N and {torque_max_nm:.3} Nm: the tool touches something, or the tool was changed. Look: if it hangs free, `tangent tare --clear`"
    )]
    Jump {
        /// Worst axis, N.
        force_n: f64,
        /// Allowed at that age, N.
        force_max_n: f64,
        /// Worst axis, Nm.
        torque_nm: f64,
        /// Allowed at that age, Nm.
        torque_max_nm: f64,
        /// Of the last good zero, s.
        age_s: f64,
    },
    /// What the sensor reads takes too much of its rating for a zero.
    #[error(
        "the sensor reads {:.0} % of its rating beyond the payload, at most {:.0} % can be its zero: the tool touches something, or the payload is wrong. Look: if it hangs free, `tangent tare --clear`",
        100.0 * .share, 100.0 * .share_max
    )]
    Loaded {
        /// Worst axis, 0 to 1 and beyond.
        share: f64,
        /// Allowed.
        share_max: f64,
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
            said_clear: false,
        })
    }
}
