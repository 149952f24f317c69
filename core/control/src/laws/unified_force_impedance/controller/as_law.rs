//! Implements [`crate::law::Law`] for `unified_force_impedance`, for arms that take joint torques.

use nalgebra::{Vector3, Vector6};

use super::super::config::UnifiedForceImpedanceConfig;
use super::super::interface::{UnifiedInput, UnifiedOutput};
use super::run::Run;
use super::{UnifiedForceImpedance, friction};
use crate::law::{LawInput, LawOutput, Shaping};
use crate::laws::torque_task::{TorqueLaw, TorqueTask};

impl<const N: usize> UnifiedForceImpedance<N> {
    /// Chooses among the normals of `input`, and converts it to the law's own input.
    pub fn choose(&mut self, input: &LawInput<N>) -> UnifiedInput<N> {
        let patience_s = self.task.program.config.patience.estimate_s;
        let touch = self
            .task
            .estimators
            .step(
                input.estimates,
                self.task.normal_in_use,
                input.slid_m(self.task.phase),
                input.dt_s,
            )
            .filter(|touch| touch.age_s <= patience_s);
        UnifiedInput {
            time_s: input.time_s,
            dt_s: input.dt_s,
            q: input.q,
            qd: input.qd,
            arm_ready: input.arm_ready,
            wrench: input.wrench,
            wrench_validity: input.wrench_validity,
            wrench_age_s: input.wrench_age_s,
            untared: input.untared,
            vision: input.vision,
            touch: touch.map(|touch| touch.estimate),
            touch_age_s: touch.map_or(f64::INFINITY, |touch| touch.age_s),
        }
    }

    fn told(
        &self,
        input: &LawInput<N>,
        own: &UnifiedInput<N>,
        output: &UnifiedOutput<N>,
    ) -> LawOutput<N> {
        LawOutput {
            estimate_age_s: own.touch.map(|_| own.touch_age_s),
            normal: output.normal,
            force_reference_n: output.force_reference_n,
            force_n: output.force_n,
            wrench: output.wrench,
            zero_age_s: output.zero_age_s,
            zero_bound_n: output.zero_age_s.and(output.zero_bound_n),
            path_reference: output.path_reference,
            path_error_m: output.path_error_m,
            path_progress: output.path_progress,
            alignment_error_rad: output.alignment_error_rad,
            manipulability: output.manipulability,
            contact_lost_count: output.contact_lost_count,
            motion_tank_j: output.tanks.motion_j,
            force_tank_j: output.tanks.force_j,
            shaping: Some(Shaping {
                monitor: output.monitor,
                monitor_margin: output.monitor_margin,
                rho_align: output.rho_align,
                rho_force: output.rho_force,
            }),
            // No tare is requested: the law takes its own zero, at rest before it moves.
            ..self.task.output(input, output.torque)
        }
    }
}

impl<const N: usize> TorqueLaw<N> for UnifiedForceImpedance<N> {
    type Config = UnifiedForceImpedanceConfig;

    const SHAPES: bool = true;

    fn torque_task(&self) -> &TorqueTask<Self::Config> {
        &self.task
    }

    fn torque_task_mut(&mut self) -> &mut TorqueTask<Self::Config> {
        &mut self.task
    }

    fn reset(&mut self) {
        self.friction = friction(&self.task.program.config);
        self.run = Run::new(&self.task.program.config);
    }

    fn release(&mut self) {
        self.run.held = None;
    }

    fn has_touched(&self) -> bool {
        self.run.lay.is_some()
    }

    fn forget_motion(&mut self) {
        self.run.torque = None;
        self.run.push_n = 0.0;
        self.run.last_wrench = Vector6::zeros();
        self.run.bridge = Vector6::zeros();
        self.run.was_pressing = false;
        self.run.drawn = Vector3::zeros();
    }

    fn cycle(&mut self, input: &LawInput<N>) -> LawOutput<N> {
        let own = self.choose(input);
        let output = UnifiedForceImpedance::step(self, &own);
        self.told(input, &own, &output)
    }
}
