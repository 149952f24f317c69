//! Conditions that stop the robot: invalid commands, and external forces.

use nalgebra::{Matrix6, SMatrix, Vector6};
use tangent_franka::fci::{CollisionBehavior, ErrorFlags, PERIOD_S};
use tangent_mechanics::linear_solve::solve_positive_definite;
use tangent_mechanics::{Joints, Limits};

use crate::plant::ArmReading;

/// Rounding error allowed for a torque rate at its limit.
const RATE_TOLERANCE: f64 = 1e-6;
/// Distance from its stop at which a joint counts as beyond its limit, rad.
const STOP_MARGIN_RAD: f64 = 1e-6;

/// External force and moment from joint torques: of all solutions, the one that is least sensitive
/// to a singular pose. `jacobian`: of the point at which the wrench acts.
pub(crate) fn wrench_of(jacobian: &SMatrix<f64, 6, 7>, torque: &Joints<7>) -> Vector6<f64> {
    let damped: SMatrix<f64, 6, 6> = jacobian * jacobian.transpose() + Matrix6::identity() * 1e-6;
    solve_positive_definite(&damped, &(jacobian * torque)).unwrap_or_else(Vector6::zeros)
}

/// Finds an error in the torques of one answer; `last`: torques of the answer before.
pub(crate) fn commanded(
    torque: &Joints<7>,
    last: &Joints<7>,
    gravity: &Joints<7>,
    limits: &Limits<7>,
) -> Option<usize> {
    let (Some(effort), Some(rate)) = (limits.effort, limits.effort_rate) else {
        return None;
    };
    for i in 0..7 {
        let step = (torque[i] - last[i]).abs() / PERIOD_S;
        if step > rate[i] * (1.0 + RATE_TOLERANCE) {
            return Some(ErrorFlags::TORQUE_DISCONTINUITY);
        }
        if (torque[i] + gravity[i]).abs() > effort[i] {
            return Some(ErrorFlags::TORQUE_RANGE);
        }
    }
    None
}

/// Finds an error in the motion of the arm.
pub(crate) fn moving(reading: &ArmReading, limits: &Limits<7>) -> Option<usize> {
    for i in 0..7 {
        let (lower, upper) = (limits.position_lower[i], limits.position_upper[i]);
        let q = reading.q[i];
        if q <= lower + STOP_MARGIN_RAD || q >= upper - STOP_MARGIN_RAD {
            return Some(ErrorFlags::JOINT_POSITION_LIMITS);
        }
        if reading.qd[i].abs() > limits.velocity[i] {
            return Some(ErrorFlags::JOINT_VELOCITY);
        }
    }
    None
}

/// Thresholds that are exceeded: 1 where they are.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Felt {
    pub joint_contact: [f64; 7],
    pub cartesian_contact: [f64; 6],
    pub joint_collision: [f64; 7],
    pub cartesian_collision: [f64; 6],
}

impl Felt {
    /// Compares external torque (Nm) and wrench (N, Nm) with the thresholds.
    pub fn new(behavior: &CollisionBehavior, torque: &Joints<7>, wrench: &Vector6<f64>) -> Self {
        let beyond = |value: f64, threshold: f64| f64::from(u8::from(value.abs() > threshold));
        Self {
            joint_contact: std::array::from_fn(|i| {
                beyond(torque[i], behavior.lower_torque_nominal[i])
            }),
            cartesian_contact: std::array::from_fn(|i| {
                beyond(wrench[i], behavior.lower_force_nominal[i])
            }),
            joint_collision: std::array::from_fn(|i| {
                beyond(torque[i], behavior.upper_torque_nominal[i])
            }),
            cartesian_collision: std::array::from_fn(|i| {
                beyond(wrench[i], behavior.upper_force_nominal[i])
            }),
        }
    }

    /// Number of the error, if a threshold is exceeded.
    pub fn error(&self) -> Option<usize> {
        if self.joint_collision.contains(&1.0) {
            Some(ErrorFlags::JOINT_REFLEX)
        } else if self.cartesian_collision.contains(&1.0) {
            Some(ErrorFlags::CARTESIAN_REFLEX)
        } else {
            None
        }
    }
}
