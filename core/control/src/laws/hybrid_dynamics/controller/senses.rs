//! Evaluation of the wrench and the estimate, and the conditions that end a task.

use nalgebra::Vector3;
use tangent_estimation::ObjectEstimate;
use tangent_mechanics::{Object, Pose, Tool};
use tangent_sensing::Validity;

use super::super::HybridInput;
use super::super::estimate_follower::EstimateFollower;
use super::super::law::{ArmNow, Constraint};
use super::{Felt, HybridDynamics};
use crate::laws::torque_task::TorqueLaw;
use crate::limits::arm_force::{Moving, TwoForces};
use crate::limits::faults::Fault;
use crate::limits::plausibility::is_place;
use crate::limits::touch::{Doing, Touch};
use crate::limits::wrench_guard::WrenchVerdict;
use crate::phase_machine::Phase;

impl<const N: usize> HybridDynamics<N> {
    /// Validity of the wrench: as the input states it, or by how the wrench responds to the tool's
    /// motion.
    pub(super) fn answering(
        &mut self,
        input: &HybridInput<N>,
        now: &ArmNow<N>,
        normal: &Vector3<f64>,
    ) -> Validity {
        if !input.wrench_validity.is_valid() {
            return input.wrench_validity;
        }
        self.run.response.step(&Touch {
            doing: Doing::of(self.task.phase),
            position: now.tool.translation(),
            normal: *normal,
            wrench: input.wrench.vector(),
            force_n: now.tool.rotate(&input.wrench.force).dot(normal),
            reference_n: self.task.program.task.force.reference_n,
            stiffness_n_per_m: None,
            gives_way: false,
            rests: true,
            fresh: input.wrench_age_s <= input.dt_s,
            depth: None,
            probe: None,
            dt_s: input.dt_s,
        })
    }

    /// Whether the motors show a force that the sensor does not.
    fn is_unread(&mut self, now: &ArmNow<N>, felt: Option<&Felt>, dt_s: f64) -> bool {
        let (friction, jacobian) = (&self.friction, &now.jacobian);
        let shown = (self.run.motor_force).step(now.dynamics, friction, &now.qd, jacobian, dt_s);
        let forces = TwoForces::of(shown, felt.map(|felt| felt.force));
        let moving = Moving::of(self.task.phase, None);
        let most_n = self.limits.unread_force_max_n;
        self.run.arm_force.step(moving, forces, most_n, dt_s)
    }

    /// The estimate, if it can be used in this period.
    pub(super) fn usable(&self, input: &HybridInput<N>) -> Option<ObjectEstimate> {
        let patience = self.task.program.config.patience.estimate_s;
        input.estimate.filter(|e| {
            e.validity.is_valid()
                && input.estimate_age_s <= patience
                && is_place(&e.base_from_object)
                && e.covariance.iter().all(|x| x.is_finite())
        })
    }

    /// Moves the pose in use towards the estimate, with the tool's origin as the pivot.
    pub(super) fn follow(&mut self, estimate: Option<&ObjectEstimate>, now: &ArmNow<N>, dt: f64) {
        match (&mut self.run.object, estimate) {
            (None, Some(e)) => {
                self.run.object = Some(EstimateFollower::new(e.base_from_object));
            }
            (Some(object), Some(e)) => {
                let pivot = object
                    .pose()
                    .inverse()
                    .transform_point(&now.tool.translation());
                object.step(
                    &self.task.program.config.estimate,
                    &e.base_from_object,
                    &pivot,
                    dt,
                );
            }
            (Some(object), None) => object.hold(&self.task.program.config.estimate, dt),
            (None, None) => {}
        }
    }

    pub(super) fn object_from_tool(&self, now: &ArmNow<N>) -> Option<Pose<Object, Tool>> {
        let object = self.run.object.as_ref()?;
        Some(object.pose().inverse() * now.tool)
    }

    pub(super) fn constraint(&self, now: &ArmNow<N>) -> Constraint {
        let Some(object) = &self.run.object else {
            return Constraint {
                normal: -now.tool.z_axis(),
                hessian: nalgebra::Matrix3::zeros(),
                velocity: Vector3::zeros(),
            };
        };
        let pose = object.pose();
        let tip = pose.inverse().transform_point(&now.tool.translation());
        let rotation = pose.rotation().to_rotation_matrix();
        let size = self.surface.gradient(&tip).norm();
        Constraint {
            normal: rotation * self.surface.normal(&tip),
            hessian: rotation * (self.surface.hessian(&tip) / size) * rotation.transpose(),
            // The pose in use moves because the estimate changes. The object itself is at rest, or
            // nearly.
            velocity: Vector3::zeros(),
        }
    }

    /// Checks all conditions under which a task ends with a fault.
    pub(super) fn judge(
        &mut self,
        input: &HybridInput<N>,
        verdict: WrenchVerdict,
        now: &ArmNow<N>,
        estimate: Option<&ObjectEstimate>,
        felt: Option<&Felt>,
    ) {
        if !self.task.phase.is_active() || self.task.phase == Phase::Retract {
            return;
        }
        let touching = self.task.phase.is_pressing() || self.task.phase == Phase::Seek;
        self.run.blind_s = if estimate.is_some() {
            0.0
        } else {
            self.run.blind_s + input.dt_s
        };
        let unread = self.is_unread(now, felt, input.dt_s);
        let reason = match input.estimate {
            None => Validity::Missing,
            Some(e) if e.validity.is_valid() => Validity::Stale,
            Some(e) => e.validity,
        };
        let at = now.tool.translation();
        let (low, high) = (&self.limits.workspace_min_m, &self.limits.workspace_max_m);
        let outside = (0..3).any(|i| at[i] < low[i] || at[i] > high[i]);
        let begun = !matches!(self.task.phase, Phase::Tare | Phase::Clear);
        let overload = felt.and_then(|f| self.limits.overload(f.force.norm(), f.moment.norm()));
        let hidden = |load| self.limits.is_untared_beyond(load);
        let untared = felt.and(input.untared.as_ref());
        let zero_lost = self.task.program.task.tare && felt.is_some() && input.bias_age_s.is_none();
        let is_old = |most_n| input.zero_bound_n.is_none_or(|bound_n| bound_n > most_n);
        let sliding = matches!(self.task.phase, Phase::Slide | Phase::Hold);
        let task_s = self.task.program.task.timeouts.task_s;
        let fault = match verdict {
            WrenchVerdict::Retract(validity) if begun => Some(Fault::Wrench(validity)),
            _ if begun && overload.is_some() => overload,
            _ if begun && untared.is_some_and(hidden) => Some(Fault::UntaredLimit),
            _ if begun && unread => Some(Fault::ForceUnread),
            _ if begun && zero_lost => Some(Fault::ZeroLost),
            _ if sliding && self.task.program.task.zero.error_max_n.is_some_and(is_old) => {
                Some(Fault::ZeroOld)
            }
            _ if outside && begun => Some(Fault::Workspace),
            _ if !input.arm_ready && self.task.phase != Phase::Tare => Some(Fault::ArmNotReady),
            _ if task_s > 0.0 && self.task.elapsed_s > task_s => Some(Fault::TaskTimeout),
            _ if begun
                && self.run.blind_s > self.task.program.config.patience.estimate_retract_s =>
            {
                Some(Fault::Estimate(reason))
            }
            _ if touching
                && self.run.lost_count > self.task.program.config.touch.lost_count_max =>
            {
                Some(Fault::ContactUnstable)
            }
            _ => None,
        };
        if let Some(fault) = fault {
            self.task.fault = Some(fault);
            self.leave(Phase::Fault);
        }
    }
}
