//! How the tool leaves contact: moving off before the zero is taken if contact is possible, and the
//! retraction at the end.
//!
//! Called by `advance`; the motion itself is that of `departure`.

use nalgebra::Vector3;

use super::super::law::ArmNow;
use super::{Felt, UnifiedForceImpedance, Wanted};
use crate::laws::torque_task::TorqueLaw;
use crate::leaving::departure::{Clearing, Load, LoadFelt, Retracting, Step, Way};
use crate::limits::faults::Fault;
use crate::limits::wrench_guard::WrenchVerdict;
use crate::phase_machine::Phase;

impl<const N: usize> UnifiedForceImpedance<N> {
    /// Age of the zero taken in this run, s.
    pub(super) fn zero_age_s(&self) -> Option<f64> {
        self.run.zeroed_s.map(|at_s| self.task.elapsed_s - at_s)
    }

    /// Error of the zero that its age implies, N.
    pub(super) fn zero_bound_n(&self) -> Option<f64> {
        self.zero_age_s()
            .map(|age_s| self.task.program.config.touch.zero_drift_n_per_min * age_s / 60.0)
    }

    /// Phase `clear`: [`crate::leaving::departure::Departure::clear`] from where the tool stood.
    pub(super) fn clear(&mut self, now: &ArmNow<N>, felt: &Felt, dt: f64) -> Wanted {
        let way = Way {
            from: *self.run.held.get_or_insert(now.tool.translation()),
            at: now.tool.translation(),
            velocity: Vector3::zeros(),
            free_at: None,
        };
        let rules = self.task.rules(&self.limits);
        let felt = (felt.verdict, self.load(now, felt));
        let departure = &mut self.task.departure;
        match departure.clear(&rules, &way, felt, self.task.paused, dt) {
            Clearing::Going(step) => moved(self.hold(now), &step),
            Clearing::Free => {
                self.run.held = None;
                self.task.enter(self.task.program.task.phase_at_rest());
                self.hold(now)
            }
            Clearing::Failed(fault) => {
                self.fail(fault);
                self.hold(now)
            }
        }
    }

    /// The retraction: [`crate::leaving::departure::Departure::retract`] from where the tool stood.
    pub(super) fn retract(&mut self, now: &ArmNow<N>, felt: &Felt, dt: f64) -> Wanted {
        let start = self.hold(now);
        let away = self.smooth_normal(now);
        let way = Way {
            from: start.reference.position,
            at: now.tool.translation(),
            velocity: Vector3::zeros(),
            free_at: self.run.tared_at,
        };
        let rules = self.task.rules(&self.limits);
        let load = self.load(now, felt);
        match self.task.departure.retract(&rules, away, &way, load, dt) {
            Retracting::Going(step) => moved(start, &step),
            Retracting::Ended(step, then) => {
                let wanted = moved(start, &step);
                self.run.held = Some(wanted.reference.position);
                self.task.enter(then);
                wanted
            }
            Retracting::Opposed => {
                self.task.fault = self.task.fault.or(Some(Fault::RetractOpposed));
                self.run.held = None;
                self.run.push_n = 0.0;
                self.task.enter(Phase::Fault);
                self.hold(now)
            }
        }
    }

    /// Load from a valid wrench. Here no earlier wrench replaces an invalid sample.
    fn load(&self, now: &ArmNow<N>, felt: &Felt) -> Load {
        let good = felt.verdict == WrenchVerdict::Good;
        let wrench = felt.wrench.filter(|_| good)?;
        Some(LoadFelt {
            force: now.tool.rotate(&wrench.fixed_rows::<3>(0).into_owned()),
            torque_nm: wrench.fixed_rows::<3>(3).norm(),
            hidden: felt.hidden,
            zeroed: self.task.fault != Some(Fault::ZeroInContact),
        })
    }
}

/// The reference, displaced by this step.
fn moved(mut wanted: Wanted, step: &Step) -> Wanted {
    wanted.reference.position += step.offset;
    wanted.reference.velocity = step.velocity;
    wanted.policy = wanted.reference.position;
    wanted
}
