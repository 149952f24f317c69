//! Where the force acts on the tool, from force and torque: the tool turns about that point.
//!
//! Called by the motion of the pressing phases. A tool that turns about its origin lifts a contact
//! beside it, or presses it in: 5 mm aside, 0.05 rad/s make 0.25 mm/s, which a force law damped for
//! a stiff contact cannot follow. The arm's delay acts on the turn and on the motion that makes up
//! for it alike.

use nalgebra::Vector3;
use tangent_mechanics::{Aligned, Base, Pose, Tool, Wrench};

use crate::limits::clamp_norm;

/// Time constant of the mean, s: noise of the torque is averaged.
const MEAN_S: f64 = 0.1;
/// Force at which the point is taken half as far out as measured, N: the torque's error stays while
/// the force gets weaker.
const HALF_N: f64 = 2.5;
/// Largest distance from the tool's origin, m.
const FAR_M: f64 = 0.015;
/// Largest speed along the normal that makes up for a turn, m/s.
const LIFT_MAX_M_PER_S: f64 = 0.002;

/// State for one contact. A new one is the reset.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct ActingPoint {
    /// Relative to the tool's origin, tool axes, m.
    in_tool_m: Vector3<f64>,
}

impl ActingPoint {
    /// Adds one cycle's wrench at the tool's origin, base axes.
    pub fn add(
        &mut self,
        wrench: &Wrench<Aligned<Tool, Base>>,
        base_from_tool: &Pose<Base, Tool>,
        dt_s: f64,
    ) {
        let (force, torque) = (wrench.force, wrench.torque);
        let out = force.cross(&torque) / (force.norm_squared() + HALF_N * HALF_N);
        let out = base_from_tool.unrotate(&clamp_norm(out, FAR_M));
        self.in_tool_m += (out - self.in_tool_m) * (dt_s / (dt_s + MEAN_S));
    }

    /// Relative to the tool's origin, tool axes, m.
    pub fn in_tool_m(&self) -> Vector3<f64> {
        self.in_tool_m
    }

    /// Speed along the `normal` (unit) that keeps the point where it is while the tool turns with
    /// `turn` (rad/s), out of the material, m/s; base axes.
    pub fn make_up_m_per_s(
        &self,
        turn: &Vector3<f64>,
        base_from_tool: &Pose<Base, Tool>,
        normal: &Vector3<f64>,
    ) -> f64 {
        let out = base_from_tool.rotate(&self.in_tool_m);
        let lift = turn.cross(&out).dot(normal);
        -lift.clamp(-LIFT_MAX_M_PER_S, LIFT_MAX_M_PER_S)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::UnitQuaternion;

    #[test]
    fn the_point_stands_still_while_the_tool_turns() {
        let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
        let pose = Pose::new(Vector3::new(0.4, 0.1, 0.2), down);
        let (at, normal) = (Vector3::new(0.004, -0.003, 0.0), Vector3::z());
        let force = normal * 20.0;
        let wrench = Wrench::new(force, at.cross(&force));
        let mut point = ActingPoint::default();
        for _ in 0..500 {
            point.add(&wrench, &pose, 0.008);
        }
        let turn = Vector3::new(0.1, 0.05, 0.0);
        let lift = turn.cross(&at).dot(&normal);
        let left = lift + point.make_up_m_per_s(&turn, &pose, &normal);
        assert!(left.abs() < 0.05 * lift.abs(), "{left} of {lift}");
    }

    #[test]
    fn a_weak_force_and_any_torque_ask_for_little() {
        let pose = Pose::identity();
        let mut point = ActingPoint::default();
        let wrench = Wrench::new(Vector3::z() * 0.3, Vector3::new(0.01, 0.01, 0.0));
        for _ in 0..500 {
            point.add(&wrench, &pose, 0.008);
        }
        let turn = Vector3::new(0.05, 0.0, 0.0);
        assert!(point.make_up_m_per_s(&turn, &pose, &Vector3::z()).abs() < 5e-5);
        let wrench = Wrench::new(Vector3::z() * 0.3, Vector3::repeat(1e3));
        point.add(&wrench, &pose, 0.008);
        let turn = Vector3::repeat(1e3);
        let most = point.make_up_m_per_s(&turn, &pose, &Vector3::z()).abs();
        assert!(most <= LIFT_MAX_M_PER_S);
    }
}
