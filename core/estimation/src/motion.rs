//! Check of the samples, and the motion with the lag of the wrench filter.
//!
//! Every estimator passes each sample through a [`MotionTracker`] first.

use nalgebra::{Matrix3, Vector3};
use tangent_mechanics::{Direction, Point};
use tangent_sensing::Validity;

use crate::world_estimator::{WorldEstimate, WorldSample};

/// Longest time between samples that still counts as continuous motion, s.
const GAP_MAX_S: f64 = 0.25;

/// Motion of the tool at the time of the delayed wrench, in world axes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Motion {
    /// Time since the previous sample, s.
    pub dt_s: f64,
    /// The sensor was tared since the previous sample.
    pub tared: bool,
    /// Age of that tare, s.
    pub bias_age_s: f64,
    /// Tool's origin now, m.
    pub point: Vector3<f64>,
    /// Tool's origin at the wrench's time, m.
    pub point_lagged: Vector3<f64>,
    /// Displacement of `point_lagged` since the previous sample, m.
    pub step: Vector3<f64>,
    /// Velocity of the tool's origin at the wrench's time, m/s.
    pub velocity: Vector3<f64>,
    /// Angular velocity of the tool at the wrench's time, rad/s.
    pub angular: Vector3<f64>,
    /// Rotation from tool axes to world axes at the wrench's time.
    pub rotation: Matrix3<f64>,
    /// Force on the tool, tool axes, N.
    pub force_in_tool: Vector3<f64>,
    /// Torque on the tool, tool axes, Nm.
    pub torque_in_tool: Vector3<f64>,
    /// Whether the motion of the base, and its error, is part of this motion.
    pub base_moves: bool,
}

#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct MotionTracker {
    last: Option<LastSample>,
    bias_age_s: Option<f64>,
}

#[derive(Clone, Copy, Debug)]
struct LastSample {
    time_s: f64,
    point: Vector3<f64>,
    velocity: Vector3<f64>,
    angular: Vector3<f64>,
}

impl MotionTracker {
    /// Takes a sample. A rejected sample does not change the state.
    ///
    /// # Errors
    /// The reason why the sample is rejected.
    pub fn take(&mut self, sample: &WorldSample) -> Result<Motion, Validity> {
        if !sample.wrench_validity.is_valid() {
            return Err(sample.wrench_validity);
        }
        let isometry = sample.world_from_tool.isometry();
        let finite = sample.time_s.is_finite()
            && sample.dt_s.is_finite()
            && sample.wrench_delay_s.is_finite()
            && sample.twist.is_finite()
            && sample.wrench.is_finite()
            && isometry.translation.vector.iter().all(|x| x.is_finite())
            && isometry.rotation.coords.iter().all(|x| x.is_finite());
        // A quaternion that is not of unit length scales what it rotates.
        if !finite || (isometry.rotation.norm() - 1.0).abs() > 1e-6 {
            return Err(Validity::NotFinite);
        }
        let point = sample.world_from_tool.translation();
        let twist = &sample.twist;
        // Implausible numbers: finite, but their squares may overflow.
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
        // From the samples' times, so that the step is right when samples were skipped.
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
        self.last = Some(LastSample {
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
        // A cycle without a wrench does not change the age of the tare.
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
            base_moves: sample.base_moves,
        })
    }
}

/// Estimate without contact: the tool's axis (Tugal et al., IV.B.d).
pub(crate) fn free_space(motion: &Motion) -> WorldEstimate {
    WorldEstimate {
        point: Point::new(motion.point),
        normal: Direction::new(-motion.rotation.column(2).normalize()),
        covariance: Matrix3::identity(),
        validity: Validity::NoContact,
        friction: None,
        curvature: None,
    }
}
