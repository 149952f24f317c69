//! Compensation of a moving base: transforms all inputs of the law to the base's pose at the start
//! of the task.
//!
//! Called by the controller each cycle, first and last. The surface stands on the floor, so path,
//! normal and force are constant there: the law works in the base's axes of the task's first cycle,
//! as if the base had not moved. The law commands an absolute motion of the tool; the part that the
//! base already makes is subtracted (`against_base`), which is the feed-forward of the base's
//! velocity. On a base that stands, inputs and outputs are unchanged, bit for bit.

use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use tangent_mechanics::{Aligned, Base, Pose, Tool, Twist, World};
use tangent_sensing::BaseMotion;

use super::interface::ControlInput;
use crate::inputs::EstimateInput;

/// Shortfall of the arm against the commanded motion, m/s, at which the base counts as too fast.
const SHORTFALL_M_PER_S: f64 = 0.002;
/// Minimum duration of the shortfall, s: a mere acceleration limit does not last as long.
const SHORTFALL_S: f64 = 0.1;
/// Maximum age at which an estimate is transformed to the base pose of its time, s.
const ESTIMATE_AGE_MAX_S: f64 = 0.5;

/// Base pose at the start of the task. Reset at every start.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct MovingBase {
    origin: Option<Pose<World, World>>,
    /// Base pose of this cycle relative to it; `None` if the base never moves.
    now: Option<BaseMotion>,
    short_s: f64,
}

impl MovingBase {
    /// Transforms the cycle's inputs to the base pose at the start of the task.
    pub fn place<const N: usize>(&mut self, input: &ControlInput<N>) -> ControlInput<N> {
        self.now = input.base.map(|base| {
            let origin = self.origin.get_or_insert(base.world_here());
            base.seen_from(origin)
        });
        let Some(base) = &self.now else {
            return *input;
        };
        let twist = base.over_ground(&input.base_from_tool, &input.twist);
        ControlInput {
            base_from_tool: Pose::from_isometry(
                *(base.world_from_base * input.base_from_tool).isometry(),
            ),
            twist: Twist::new(twist.linear, twist.angular),
            estimates: input.estimates.map(|e| e.map(|e| place_estimate(&e, base))),
            ..*input
        }
    }

    /// Twist that the arm must make for a tool at `base_from_tool` (relative to the present base)
    /// to move as commanded relative to the floor.
    pub fn against_base(
        &self,
        base_from_tool: &Pose<Base, Tool>,
        twist: Twist<Aligned<Tool, Base>>,
    ) -> Twist<Aligned<Tool, Base>> {
        self.now.map_or(twist, |base| {
            base.against_base(base_from_tool, &Twist::new(twist.linear, twist.angular))
        })
    }

    /// Compares the joints' motion with the commanded one. On a standing base the arm has any time
    /// it needs; a moving base takes the surface away, or drives it into the tool.
    pub fn follow(
        &mut self,
        asked: &Twist<Aligned<Tool, Base>>,
        made: &Twist<Aligned<Tool, Base>>,
        dt_s: f64,
    ) {
        let short = (asked.linear - made.linear).norm() > SHORTFALL_M_PER_S;
        self.short_s = if short { self.short_s + dt_s } else { 0.0 };
    }

    /// Whether the base moves and the arm cannot compensate it: end of its reach, a singularity, or
    /// a joint limit.
    pub fn out_of_reach(&self) -> bool {
        self.short_s > SHORTFALL_S
    }

    /// Whether the base moves, as far as known.
    pub fn moves(&self) -> bool {
        self.now.is_some()
    }

    /// A direction, transformed to the present base axes.
    pub fn direction(&self, direction: &Vector3<f64>) -> Vector3<f64> {
        self.now
            .map_or(*direction, |base| base.world_from_base.unrotate(direction))
    }

    /// A point, transformed to the present base axes, m.
    pub fn point(&self, point: &Vector3<f64>) -> Vector3<f64> {
        self.now.map_or(*point, |base| {
            base.world_from_base.inverse().transform_point(point)
        })
    }
}

/// Transforms an estimate, which refers to the base axes at its time.
fn place_estimate(input: &EstimateInput, base: &BaseMotion) -> EstimateInput {
    let age_s = if input.age_s.is_finite() {
        input.age_s.clamp(0.0, ESTIMATE_AGE_MAX_S)
    } else {
        0.0
    };
    let back = Pose::<Base, Base>::new(
        base.twist.linear * -age_s,
        UnitQuaternion::new(base.twist.angular * -age_s),
    );
    let pose = base.world_from_base * back;
    let rotation = pose.rotation().to_rotation_matrix().into_inner();
    let turned = |m: &Matrix3<f64>| rotation * m * rotation.transpose();
    let mut placed = *input;
    let estimate = &mut placed.estimate;
    estimate.point = pose.transform_point(&estimate.point);
    estimate.normal = pose.rotate(&estimate.normal);
    estimate.covariance = turned(&estimate.covariance);
    estimate.curvature = estimate.curvature.as_ref().map(turned);
    placed
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn pose(t: [f64; 3], r: [f64; 3]) -> tangent_mechanics::Pose<World, Base> {
        Pose::new(Vector3::from(t), UnitQuaternion::new(Vector3::from(r)))
    }

    proptest! {
        /// A point fixed to the floor is constant in the law's axes, however the base moves; and a
        /// tool that is to stand there is moved against the base.
        #[test]
        fn the_floor_stands(t in prop::array::uniform3(-5.0f64..5.0), r in prop::array::uniform3(-1.0f64..1.0),
                            v in prop::array::uniform3(-0.05f64..0.05), w in prop::array::uniform3(-0.1f64..0.1),
                            p in prop::array::uniform3(-1.0f64..1.0)) {
            let start = pose(t, r);
            let twist = Twist::<Base>::new(Vector3::from(v), Vector3::from(w));
            let mut base = MovingBase::default();
            let at = |dt: f64| BaseMotion {
                // One short step of the twist.
                world_from_base: start * Pose::<Base, Base>::new(twist.linear * dt, UnitQuaternion::new(twist.angular * dt)),
                twist,
                age_s: 0.0,
                trouble: None,
            };
            let floor_point = start.transform_point(&Vector3::from(p));
            let seen = |base: &mut MovingBase, dt: f64| {
                let motion = at(dt);
                let origin = *base.origin.get_or_insert(motion.world_here());
                base.now = Some(motion.seen_from(&origin));
                motion.world_from_base.inverse().transform_point(&floor_point)
            };
            let before = seen(&mut base, 0.0);
            prop_assert!((before - Vector3::from(p)).norm() < 1e-9);
            let tool = Pose::<Base, Tool>::new(before, UnitQuaternion::identity());
            let arm = base.against_base(&tool, Twist::zero());
            let h = 1e-6;
            let after = seen(&mut base, h);
            prop_assert!((base.point(&before) - after).norm() < 1e-9);
            prop_assert!(((after - before) / h - arm.linear).norm() < 1e-5);
        }
    }
}
