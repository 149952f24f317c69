//! Refuses samples that cannot be used and puts the wrench filter's lag on the motion.
//!
//! First thing that every estimator does with a sample.

use nalgebra::{Matrix3, Vector3};
use tangent_sensing::Validity;

use crate::{ContactSample, NormalEstimate};

/// Longest time between samples that still counts as continuous motion, s.
const GAP_MAX_S: f64 = 0.25;

/// Motion of the tool as the delayed wrench saw it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Motion {
    /// s since the previous sample.
    pub dt_s: f64,
    /// The sensor was tared since the previous sample.
    pub tared: bool,
    /// Age of that tare, s.
    pub bias_age_s: f64,
    /// Tool origin now, base axes, m.
    pub point: Vector3<f64>,
    /// Tool origin at the wrench's time, m.
    pub point_lagged: Vector3<f64>,
    /// Its step since the previous sample, m.
    pub step: Vector3<f64>,
    /// Its measured velocity, m/s.
    pub velocity: Vector3<f64>,
    /// Angular velocity of the tool at the wrench's time, rad/s.
    pub angular: Vector3<f64>,
    /// Turns tool axes to base axes at the wrench's time.
    pub rotation: Matrix3<f64>,
    /// Force and torque on the tool, tool axes, N and Nm.
    pub force_in_tool: Vector3<f64>,
    pub torque_in_tool: Vector3<f64>,
}

#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct MotionTracker {
    last: Option<Last>,
    bias_age_s: Option<f64>,
}

#[derive(Clone, Copy, Debug)]
struct Last {
    time_s: f64,
    point: Vector3<f64>,
    velocity: Vector3<f64>,
    angular: Vector3<f64>,
}

impl MotionTracker {
    /// Takes a sample, or says why it is refused; a refused sample leaves no trace.
    pub fn take(&mut self, sample: &ContactSample) -> Result<Motion, Validity> {
        if !sample.wrench_validity.is_valid() {
            return Err(sample.wrench_validity);
        }
        let isometry = sample.base_from_tool.isometry();
        let finite = sample.time_s.is_finite()
            && sample.dt_s.is_finite()
            && sample.wrench_delay_s.is_finite()
            && sample.twist.is_finite()
            && sample.wrench.is_finite()
            && isometry.translation.vector.iter().all(|x| x.is_finite())
            && isometry.rotation.coords.iter().all(|x| x.is_finite());
        // A quaternion that is not unit is as useless as NaN: it scales what it turns.
        if !finite || (isometry.rotation.norm() - 1.0).abs() > 1e-6 {
            return Err(Validity::NotFinite);
        }
        let point = sample.base_from_tool.translation();
        let twist = &sample.twist;
        // Numbers that no arm and no sensor produces: finite, but their squares are not.
        let magnitude = point
            .amax()
            .max(twist.vector().amax())
            .max(sample.wrench.vector().amax());
        if magnitude > 1e6 {
            return Err(Validity::NotFinite);
        }
        if self.last.is_some_and(|l| sample.time_s <= l.time_s) || sample.dt_s <= 0.0 {
            return Err(Validity::Stale);
        }
        let delay_s = sample.wrench_delay_s.clamp(0.0, 1.0);
        // The samples' own times rule: a reader that skipped some still gets the true step.
        let dt_s = self.last.map_or(sample.dt_s, |l| sample.time_s - l.time_s);
        let continuous = self.last.filter(|_| dt_s <= GAP_MAX_S);
        let (lagged, velocity, angular) = match continuous {
            Some(l) => {
                // One pole with the wrench filter's delay.
                let gain = dt_s / (delay_s + dt_s);
                (
                    l.point + (point - l.point) * gain,
                    l.velocity + (twist.linear - l.velocity) * gain,
                    l.angular + (twist.angular - l.angular) * gain,
                )
            }
            None => (point, twist.linear, twist.angular),
        };
        let step = continuous.map_or_else(Vector3::zeros, |l| lagged - l.point);
        self.last = Some(Last {
            time_s: sample.time_s,
            point: lagged,
            velocity,
            angular,
        });
        let age = sample.wrench_bias_age_s.filter(|age| *age >= 0.0);
        let tared = match (self.bias_age_s, age) {
            (None, Some(_)) => true,
            (Some(before), Some(now)) => now < before,
            _ => false,
        };
        // A cycle without a wrench says nothing of the tare.
        self.bias_age_s = age.or(self.bias_age_s);
        let unturn = nalgebra::UnitQuaternion::from_scaled_axis(-angular * delay_s);
        Ok(Motion {
            dt_s: dt_s.min(GAP_MAX_S),
            tared,
            bias_age_s: age.unwrap_or(0.0).min(1e6),
            point,
            point_lagged: lagged,
            step,
            velocity,
            angular,
            rotation: (unturn * isometry.rotation)
                .to_rotation_matrix()
                .into_inner(),
            force_in_tool: sample.wrench.force,
            torque_in_tool: sample.wrench.torque,
        })
    }
}

/// No surface to speak of: the tool's axis (IV.B.d).
pub(crate) fn free_space(motion: &Motion) -> NormalEstimate {
    NormalEstimate {
        point: motion.point,
        normal: -motion.rotation.column(2).normalize(),
        covariance: Matrix3::identity(),
        validity: Validity::NoContact,
        friction: None,
        curvature: None,
    }
}
