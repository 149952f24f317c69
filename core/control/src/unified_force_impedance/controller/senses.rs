//! What is felt, how contact and alignment fare, and what ends or stops a task.

use nalgebra::Vector6;
use tangent_sensing::wrench_of_torques;

use super::super::fused_normal::NormalInUse;
use super::super::interface::UnifiedInput;
use super::super::law::ArmNow;
use super::super::monitor::rho_force;
use super::{Felt, UnifiedForceImpedance, Wanted};
use crate::wrench_guard::WrenchVerdict;
use crate::{Fault, Phase};

/// A valve that lets less through counts as shut: the policy hardly moves.
const SHUT: f64 = 0.25;
/// So long the policy waits for energy, s.
const EMPTY_S: f64 = 5.0;

impl UnifiedForceImpedance {
    /// The wrench in use: the robot's estimate without its zero, and without the joints' friction, which stands in it like a force.
    pub(super) fn feel(&mut self, input: &UnifiedInput, now: &ArmNow) -> Felt {
        let dt = input.dt_s;
        let verdict = self.run.guard.step(
            &self.config.patience,
            input.wrench_validity,
            input.wrench.is_finite(),
            input.wrench_age_s,
            dt,
        );
        let rubbing = wrench_of_torques(&now.jacobian, &self.friction.torque(&now.qd));
        let share = dt / (self.config.touch.wrench_lag_s + dt);
        self.run.rubbing += (rubbing - self.run.rubbing) * share;
        if verdict != WrenchVerdict::Good {
            // A bad sample is waited out with the last good one.
            let doubtful = verdict == WrenchVerdict::Doubtful;
            let last = self.run.felt.filter(|_| doubtful);
            return Felt {
                verdict,
                wrench: last.map_or_else(Vector6::zeros, |f| f.wrench),
                pressing_n: last.map_or(0.0, |f| f.pressing_n),
            };
        }
        let raw = input.wrench.vector() + now.in_tool(&self.run.rubbing);
        if self.run.phase == Phase::Tare {
            self.run.zero.0 += raw;
            self.run.zero.1 += 1.0;
        }
        let zero = self.run.zero.0 / self.run.zero.1.max(1.0);
        let wrench = if self.task.tare { raw - zero } else { raw };
        let force = wrench.fixed_rows::<3>(0).into_owned();
        let felt = Felt {
            verdict,
            wrench,
            pressing_n: -self.push_direction(now).dot(&now.tool.rotate(&force)),
        };
        self.run.felt = Some(felt);
        felt
    }

    /// Monitor and shaping. Returns ρ_frc.
    pub(super) fn watch(
        &mut self,
        wanted: &Wanted,
        now: &ArmNow,
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
        let short = (self.run.reference_n - felt.pressing_n).abs();
        let well = self.run.phase == Phase::Slide
            && short < 0.2 * self.task.force.reference_n
            && error.fixed_rows::<2>(0).norm() < 0.01;
        let config = &self.config.monitor;
        self.run.monitor.step(
            config,
            &felt.wrench,
            error,
            theta,
            normal.variation,
            well,
            dt,
        );
        let depth = if !wanted.pressing || (self.config.shaping.from_last_contact && self.touches())
        {
            0.0
        } else if self.config.shaping.from_last_contact {
            now.tool
                .z_axis()
                .dot(&(now.tool.translation() - self.run.last_contact))
        } else {
            error.z
        };
        rho_force(&self.config.shaping, depth)
    }

    /// Everything that ends or stops a task.
    pub(super) fn judge(
        &mut self,
        input: &UnifiedInput,
        felt: &Felt,
        now: &ArmNow,
        normal: &NormalInUse,
    ) {
        if !self.run.phase.is_active() || self.run.phase == Phase::Retract {
            return;
        }
        let touching = self.run.phase.is_pressing() || self.run.phase == Phase::Seek;
        // Before contact a tool may come down as it stands; while it slides, somebody must say where the surface faces.
        let blind = self.run.phase == Phase::Slide && !normal.validity.is_valid();
        let on_hold = self.run.phase == Phase::Hold && self.run.blind_s > 0.0;
        self.run.blind_s = match (blind || on_hold, normal.validity.is_valid()) {
            (true, false) => self.run.blind_s + input.dt_s,
            _ => 0.0,
        };
        let shut = self.run.phase == Phase::Slide
            && self.run.tanks.motion_valve(&self.config.tanks) < SHUT;
        self.run.empty_s = if shut {
            self.run.empty_s + input.dt_s
        } else {
            0.0
        };
        let force = felt.wrench.fixed_rows::<3>(0).norm();
        let moment = felt.wrench.fixed_rows::<3>(3).norm();
        let at = now.tool.translation();
        let (low, high) = (&self.limits.workspace_min_m, &self.limits.workspace_max_m);
        let outside = (0..3).any(|i| at[i] < low[i] || at[i] > high[i]);
        let begun = self.run.phase != Phase::Tare;
        let task_s = self.task.timeouts.task_s;
        let fault = match felt.verdict {
            WrenchVerdict::Retract(validity) if begun => Some(Fault::Wrench(validity)),
            _ if begun && force > self.limits.force_max_n => Some(Fault::ForceLimit),
            _ if begun && moment > self.limits.torque_max_nm => Some(Fault::TorqueLimit),
            _ if outside && begun => Some(Fault::Workspace),
            _ if !input.arm_ready && begun => Some(Fault::ArmNotReady),
            _ if task_s > 0.0 && self.run.since_s > task_s => Some(Fault::TaskTimeout),
            _ if self.run.blind_s > self.config.patience.estimate_retract_s => {
                Some(Fault::Estimate(normal.validity))
            }
            _ if self.run.empty_s > EMPTY_S => Some(Fault::TankEmpty),
            _ if touching && self.run.lost_count > self.config.touch.lost_count_max => {
                Some(Fault::ContactUnstable)
            }
            _ => None,
        };
        if let Some(fault) = fault {
            self.fail(fault);
        }
    }
}
