//! Implements [`crate::law::Law`] for `unified_force_impedance`, for arms that take joint torques.

use tangent_schemas::CommandKind;

use super::super::config::UnifiedForceImpedanceConfig;
use super::super::interface::{JOINTS, UnifiedInput, UnifiedOutput};
use super::UnifiedForceImpedance;
use crate::law::{JointCommand, LawInput, LawOutput, Shaping};
use crate::laws::torque_task::{TorqueLaw, TorqueTask};
use crate::leaving::clearance::Clearance;

impl UnifiedForceImpedance {
    /// Chooses among the normals of `input`, and converts it to the law's own input.
    pub fn choose(&mut self, input: &LawInput<JOINTS>) -> UnifiedInput {
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

    fn told(&self, own: &UnifiedInput, output: &UnifiedOutput) -> LawOutput<JOINTS> {
        LawOutput {
            command: JointCommand {
                kind: if output.phase.is_active() {
                    CommandKind::JointTorque
                } else {
                    CommandKind::Hold
                },
                values: output.torque,
                acceleration: 0.0,
            },
            phase: output.phase,
            fault: output.fault,
            // The law takes its own zero, at rest before it moves.
            tare_requested: false,
            clearance: output.clearance,
            zero_withdrawn: false,
            estimator: Some(self.task.estimators.in_use()),
            estimate_age_s: own.touch.map(|_| own.touch_age_s),
            normal: output.normal,
            force_reference_n: output.force_reference_n,
            force_n: output.force_n,
            wrench: output.wrench,
            wrench_age_s: own.wrench_age_s,
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
        }
    }
}

impl TorqueLaw<JOINTS> for UnifiedForceImpedance {
    type Config = UnifiedForceImpedanceConfig;

    const SHAPES: bool = true;

    fn task(&self) -> &TorqueTask<Self::Config> {
        &self.task
    }

    fn task_mut(&mut self) -> &mut TorqueTask<Self::Config> {
        &mut self.task
    }

    fn begin(&mut self, clearance: Clearance) {
        UnifiedForceImpedance::begin(self, clearance);
    }

    fn stop(&mut self) {
        UnifiedForceImpedance::stop(self);
    }

    fn is_left_on_surface(&self) -> bool {
        UnifiedForceImpedance::is_left_on_surface(self)
    }

    fn leave_surface(&mut self) {
        UnifiedForceImpedance::leave_surface(self);
    }

    fn cycle(&mut self, input: &LawInput<JOINTS>) -> LawOutput<JOINTS> {
        let own = self.choose(input);
        let output = UnifiedForceImpedance::step(self, &own);
        self.told(&own, &output)
    }
}
