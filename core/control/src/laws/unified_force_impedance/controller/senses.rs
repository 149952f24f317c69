//! Measured wrench, state of contact and alignment, and the conditions that end or stop a task.

use nalgebra::Vector6;
use tangent_sensing::{Validity, wrench_of_torques};

use super::super::fused_normal::NormalInUse;
use super::super::interface::UnifiedInput;
use super::super::law::ArmNow;
use super::super::monitor::rho_force;
use super::{Felt, UnifiedForceImpedance, Wanted};
use crate::laws::torque_task::TorqueLaw;
use crate::limits::arm_force::{Moving, TwoForces};
use crate::limits::faults::Fault;
use crate::limits::plausibility::is_wrench;
use crate::limits::touch::{Doing, Touch};
use crate::limits::wrench_guard::WrenchVerdict;
use crate::phase_machine::Phase;

/// Opening below which a valve counts as shut: the policy hardly moves.
const SHUT: f64 = 0.25;
/// Maximum time for which the policy waits for energy, s.
const EMPTY_S: f64 = 5.0;

impl<const N: usize> UnifiedForceImpedance<N> {
    /// The wrench in use: the robot's estimate without its zero and without the joints' friction,
    /// which appears in it as a force.
    pub(super) fn feel(&mut self, input: &UnifiedInput<N>, now: &ArmNow<N>) -> Felt {
        let dt = input.dt_s;
        let validity = self.answering(input, now);
        let verdict = self.run.guard.step(
            &self.task.program.config.patience,
            validity,
            is_wrench(&input.wrench),
            input.wrench_age_s,
            dt,
        );
        let rubbing = wrench_of_torques(&now.jacobian, &self.friction.torque(&now.qd));
        let share = dt / (self.task.program.config.touch.wrench_lag_s + dt);
        self.run.rubbing += (rubbing - self.run.rubbing) * share;
        // Before the law's own zero and the bridge's are subtracted: neither may hide a load.
        let good = verdict == WrenchVerdict::Good;
        let beyond = |load| self.limits.is_untared_beyond(load);
        let hidden = good
            && (input.wrench.force.norm() > self.limits.untared_max_n()
                || input.untared.as_ref().is_some_and(beyond));
        if !good {
            // During an invalid sample the last valid one is used.
            let doubtful = verdict == WrenchVerdict::Doubtful;
            let last = self.run.felt.filter(|_| doubtful);
            return Felt {
                verdict,
                wrench: last.and_then(|f| f.wrench),
                pressing_n: last.and_then(|f| f.pressing_n),
                hidden,
            };
        }
        let raw = input.wrench.vector() + now.in_tool(&self.run.rubbing);
        if self.task.phase == Phase::Tare {
            self.run.zero.0 += raw;
            self.run.zero.1 += 1.0;
        }
        let zero = self.run.zero.0 / self.run.zero.1.max(1.0);
        let wrench = if self.task.program.task.tare {
            raw - zero
        } else {
            raw
        };
        let force = wrench.fixed_rows::<3>(0).into_owned();
        let felt = Felt {
            verdict,
            wrench: Some(wrench),
            pressing_n: Some(-self.push_direction(now).dot(&now.tool.rotate(&force))),
            hidden,
        };
        self.run.felt = Some(felt);
        felt
    }

    /// Validity of the wrench: as the input states it, or by how the wrench responds to the tool's
    /// motion.
    fn answering(&mut self, input: &UnifiedInput<N>, now: &ArmNow<N>) -> Validity {
        if !input.wrench_validity.is_valid() {
            return input.wrench_validity;
        }
        let normal = self.smooth_normal(now);
        let zero = if self.task.program.task.tare {
            self.run.zero.0 / self.run.zero.1.max(1.0)
        } else {
            Vector6::zeros()
        };
        let wrench = input.wrench.vector() - zero;
        // The pressing wrench as the law sees it: the joints' friction appears and disappears with
        // the tool's motion like a load.
        let pressing = wrench + now.in_tool(&self.run.rubbing);
        let force = pressing.fixed_rows::<3>(0).into_owned();
        self.run.response.step(&Touch {
            doing: Doing::of(self.task.phase),
            position: now.tool.translation(),
            normal,
            wrench,
            force_n: now.tool.rotate(&force).dot(&normal),
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

    /// Whether the motors show a force that the robot's estimate does not.
    fn is_unread(&mut self, felt: &Felt, now: &ArmNow<N>, dt_s: f64) -> bool {
        let dynamics = self.model.mass_matrix_and_bias(&now.q, &now.qd);
        let (friction, jacobian) = (&self.friction, &now.jacobian);
        let shown = (self.run.motor_force).step(dynamics, friction, &now.qd, jacobian, dt_s);
        let read = |wrench: Vector6<f64>| now.tool.rotate(&wrench.fixed_rows::<3>(0).into_owned());
        let forces = TwoForces::of(shown, felt.wrench.map(read));
        let moving = Moving::of(self.task.phase, None);
        let most_n = self.limits.unread_force_max_n;
        self.run.arm_force.step(moving, forces, most_n, dt_s)
    }

    /// Updates monitor and shaping. Returns ρ_frc.
    pub(super) fn watch(
        &mut self,
        wanted: &Wanted,
        now: &ArmNow<N>,
        normal: &NormalInUse,
        felt: &Felt,
        error: &Vector6<f64>,
        dt: f64,
    ) -> f64 {
        let theta = normal.normal.angle(&-now.tool.z_axis()).to_degrees();
        let theta = if normal.validity.is_valid() {
            theta
        } else {
            0.0
        };
        let reference_n = self.run.reference_n;
        let short = felt.pressing_n.map(|n| (reference_n - n).abs());
        let well = self.task.phase == Phase::Slide
            && short.is_some_and(|short| short < 0.2 * self.task.program.task.force.reference_n)
            && error.fixed_rows::<2>(0).norm() < 0.01;
        let config = &self.task.program.config.monitor;
        // Without a wrench nothing is known about the contact: the monitor keeps its state.
        if let Some(wrench) = &felt.wrench {
            self.run
                .monitor
                .step(config, wrench, error, theta, normal.variation, well, dt);
        }
        let depth = if !wanted.pressing
            || (self.task.program.config.shaping.from_last_contact && self.touches())
        {
            0.0
        } else if self.task.program.config.shaping.from_last_contact {
            now.tool
                .z_axis()
                .dot(&(now.tool.translation() - self.run.last_contact))
        } else {
            error.z
        };
        rho_force(&self.task.program.config.shaping, depth)
    }

    /// Checks all conditions that end or stop a task.
    pub(super) fn judge(
        &mut self,
        input: &UnifiedInput<N>,
        felt: &Felt,
        now: &ArmNow<N>,
        normal: &NormalInUse,
    ) {
        if !self.task.phase.is_active() || self.task.phase == Phase::Retract {
            return;
        }
        let touching = self.task.phase.is_pressing() || self.task.phase == Phase::Seek;
        // Before contact a tool may descend in its present orientation; while it slides, a valid
        // normal is required.
        let blind = self.task.phase == Phase::Slide && !normal.validity.is_valid();
        let on_hold = self.task.phase == Phase::Hold && self.run.blind_s > 0.0;
        self.run.blind_s = match (blind || on_hold, normal.validity.is_valid()) {
            (true, false) => self.run.blind_s + input.dt_s,
            _ => 0.0,
        };
        let shut = self.task.phase == Phase::Slide
            && self.run.tanks.motion_valve(&self.task.program.config.tanks) < SHUT;
        self.run.empty_s = if shut {
            self.run.empty_s + input.dt_s
        } else {
            0.0
        };
        let overload = felt.wrench.and_then(|wrench| {
            let [force_n, torque_nm] = [0, 3].map(|row| wrench.fixed_rows::<3>(row).norm());
            self.limits.overload(force_n, torque_nm)
        });
        let unread = self.is_unread(felt, now, input.dt_s);
        let sliding = matches!(self.task.phase, Phase::Slide | Phase::Hold);
        let bound_n = self.zero_bound_n();
        let is_old = |most_n| bound_n.is_none_or(|bound_n| bound_n > most_n);
        let at = now.tool.translation();
        let (low, high) = (&self.limits.workspace_min_m, &self.limits.workspace_max_m);
        let outside = (0..3).any(|i| at[i] < low[i] || at[i] > high[i]);
        let begun = !matches!(self.task.phase, Phase::Tare | Phase::Clear);
        let task_s = self.task.program.task.timeouts.task_s;
        let fault = match felt.verdict {
            WrenchVerdict::Retract(validity) if begun => Some(Fault::Wrench(validity)),
            _ if begun && overload.is_some() => overload,
            _ if begun && felt.hidden => Some(Fault::UntaredLimit),
            _ if begun && unread => Some(Fault::ForceUnread),
            _ if sliding && self.task.program.task.zero.error_max_n.is_some_and(is_old) => {
                Some(Fault::ZeroOld)
            }
            _ if outside && begun => Some(Fault::Workspace),
            _ if !input.arm_ready && self.task.phase != Phase::Tare => Some(Fault::ArmNotReady),
            _ if task_s > 0.0 && self.task.elapsed_s > task_s => Some(Fault::TaskTimeout),
            _ if self.run.blind_s > self.task.program.config.patience.estimate_retract_s => {
                Some(Fault::Estimate(normal.validity))
            }
            _ if self.run.empty_s > EMPTY_S => Some(Fault::TankEmpty),
            _ if touching
                && self.run.lost_count > self.task.program.config.touch.lost_count_max =>
            {
                Some(Fault::ContactUnstable)
            }
            _ => None,
        };
        if let Some(fault) = fault {
            self.fail(fault);
        }
    }
}
