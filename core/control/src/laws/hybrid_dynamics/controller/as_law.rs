//! Implements [`crate::law::Law`] for `hybrid_dynamics`, for arms that take joint torques.

use super::super::config::HybridDynamicsConfig;
use super::super::interface::{HybridInput, HybridOutput};
use super::super::law::{ForceIntegral, MotionIntegral};
use super::{HybridDynamics, Run};
use crate::law::{LawInput, LawOutput};
use crate::laws::torque_task::{TorqueLaw, TorqueTask};

impl<const N: usize> HybridDynamics<N> {
    /// Chooses among the estimates of `input`, and converts it to the law's own input.
    pub fn choose(&mut self, input: &LawInput<N>) -> HybridInput<N> {
        let used = self.task.estimators.step_objects(
            &input.objects,
            &*self.surface,
            &input.base_from_tool.translation(),
            self.task.normal_in_use,
            input.slid_m(self.task.phase),
            input.dt_s,
        );
        HybridInput {
            time_s: input.time_s,
            dt_s: input.dt_s,
            q: input.q,
            qd: input.qd,
            arm_ready: input.arm_ready,
            wrench: input.wrench,
            wrench_validity: input.wrench_validity,
            wrench_age_s: input.wrench_age_s,
            bias_age_s: input.bias_age_s,
            zero_bound_n: input.zero_bound_n,
            untared: input.untared,
            estimate: used.map(|used| used.estimate),
            estimate_age_s: used.map_or(f64::INFINITY, |used| used.age_s),
        }
    }

    fn told(
        &self,
        input: &LawInput<N>,
        own: &HybridInput<N>,
        output: &HybridOutput<N>,
    ) -> LawOutput<N> {
        let usable = own.wrench_validity.is_valid() && own.wrench.is_finite();
        LawOutput {
            tare_requested: output.tare_requested,
            zero_withdrawn: output.zero_withdrawn,
            estimate_age_s: own.estimate.map(|_| own.estimate_age_s),
            normal: output.normal,
            force_reference_n: output.force_reference_n,
            force_n: output.force_n,
            wrench: usable.then_some(own.wrench),
            zero_age_s: own.bias_age_s,
            zero_bound_n: own.bias_age_s.and(own.zero_bound_n),
            path_reference: output.path_reference,
            path_error_m: output.path_error_m,
            path_progress: output.path_progress,
            alignment_error_rad: output.alignment_error_rad,
            manipulability: output.manipulability,
            contact_lost_count: output.contact_lost_count,
            ..self.task.output(input, output.torque)
        }
    }
}

impl<const N: usize> TorqueLaw<N> for HybridDynamics<N> {
    type Config = HybridDynamicsConfig;

    const SHAPES: bool = false;

    fn torque_task(&self) -> &TorqueTask<Self::Config> {
        &self.task
    }

    fn torque_task_mut(&mut self) -> &mut TorqueTask<Self::Config> {
        &mut self.task
    }

    fn reset(&mut self) {
        self.friction = self.task.program.config.friction.model();
        self.run = Run::new();
    }

    fn release(&mut self) {
        self.run.held = None;
    }

    fn has_touched(&self) -> bool {
        self.run.lay.is_some()
    }

    fn forget_motion(&mut self) {
        self.run.motion = MotionIntegral::default();
        self.run.force = ForceIntegral::default();
    }

    fn cycle(&mut self, input: &LawInput<N>) -> LawOutput<N> {
        let own = self.choose(input);
        let output = HybridDynamics::step(self, &own);
        self.told(input, &own, &output)
    }
}
