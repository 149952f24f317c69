//! A way in joint space: what is left of it, and whether the arm touches something on it or is
//! blocked.
//!
//! Its caller is phase `travel`.

use nalgebra::Vector3;
use tangent_mechanics::{Arm, Joints};

use crate::joint_move::{JointMoveLimits, left_rad};
use crate::limits::Limits;
use crate::task::StartSpec;

/// Joint acceleration on the way, rad/s².
const ACCELERATION_RAD_PER_S2: f64 = 0.5;
/// Highest speed of the tool on the way, m/s.
const TOOL_SPEED_M_PER_S: f64 = 0.1;
/// Time for which the force must have changed, s: one wrong sample does not count.
const TOUCHED_S: f64 = 0.012;
/// Progress that counts, rad, and the longest time without any, s.
const PROGRESS: (f64, f64) = (2e-3, 3.0);

/// State of a way in joint space. A new one is the reset.
#[derive(Clone, Copy, Debug)]
pub(crate) struct JointWay {
    pub homewards: bool,
    /// Distance of the joint that is furthest from its target, rad.
    pub left_rad: f64,
    /// Smallest distance so far, rad, and the time since it was reached, s.
    nearest_rad: f64,
    stalled_s: f64,
    /// Force when the way began, tool axes, N.
    force_before: Option<Vector3<f64>>,
    touched_s: f64,
    pub begun: bool,
}

impl Default for JointWay {
    fn default() -> Self {
        Self {
            homewards: false,
            left_rad: f64::INFINITY,
            nearest_rad: f64::INFINITY,
            stalled_s: 0.0,
            force_before: None,
            touched_s: 0.0,
            begun: false,
        }
    }
}

impl JointWay {
    /// The way home after a task.
    pub fn home() -> Self {
        Self {
            homewards: true,
            ..Self::default()
        }
    }

    /// Takes the arm's joint positions of this cycle.
    pub fn look<const N: usize>(&mut self, q: &Joints<N>, target: &Joints<N>) {
        self.left_rad = left_rad(q, target);
    }

    /// Limits of the way of `spec`.
    pub fn limits<const N: usize>(
        spec: &StartSpec,
        arm: &Arm<N>,
        limits: &Limits,
    ) -> JointMoveLimits<N> {
        let fastest = arm.limits().velocity * limits.joint_speed_share;
        JointMoveLimits {
            speed_rad_per_s: fastest.map(|v| v.min(spec.speed_rad_per_s)),
            acceleration_rad_per_s2: ACCELERATION_RAD_PER_S2
                .min(limits.joint_acceleration_max_rad_per_s2),
            tool_speed_m_per_s: TOOL_SPEED_M_PER_S.min(limits.speed_max_m_per_s),
            tool_turn_rate_rad_per_s: limits.turn_rate_max_rad_per_s,
        }
    }

    /// Force when the way began, tool axes, N.
    pub fn force_before(&self) -> Vector3<f64> {
        self.force_before.unwrap_or_default()
    }

    /// Whether the force has changed by more than `force_max_n` since the way began.
    pub fn has_touched(&mut self, force: &Vector3<f64>, force_max_n: f64, dt_s: f64) -> bool {
        let before = *self.force_before.get_or_insert(*force);
        self.touched_s = if (force - before).norm() > force_max_n {
            self.touched_s + dt_s
        } else {
            0.0
        };
        self.touched_s > TOUCHED_S
    }

    /// Whether the arm has made no progress for too long; `moves`: it is meant to move.
    pub fn is_blocked(&mut self, moves: bool, dt_s: f64) -> bool {
        let (step_rad, patience_s) = PROGRESS;
        if self.left_rad < self.nearest_rad - step_rad {
            self.nearest_rad = self.left_rad;
            self.stalled_s = 0.0;
        } else if moves {
            self.stalled_s += dt_s;
        }
        self.stalled_s > patience_s
    }
}
