//! Conditions under which an average is accepted as the sensor's zero, and the judgement of a new
//! zero by them.

use nalgebra::Vector6;
use serde::{Deserialize, Serialize};
use tangent_mechanics::{Sensor, Wrench};

use super::refusal::TareRefusal;
use super::zero::{Tare, TareGround};
use crate::SensingError;

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
pub(super) fn worst(v: &Vector6<f64>) -> (f64, f64) {
    (v.fixed_rows::<3>(0).amax(), v.fixed_rows::<3>(3).amax())
}
