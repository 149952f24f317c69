//! How the tool leaves what it touches: off before the zero is taken where it may touch, and the
//! retraction at the end.
//!
//! Called by `advance`; the motion itself is that of `departure`.

use nalgebra::Vector3;

use super::super::law::ArmNow;
use super::{Felt, UnifiedForceImpedance, Wanted};
use crate::departure::{Clearing, Load, LoadFelt, Retracting, Rules, Step, Way};
use crate::wrench_guard::WrenchVerdict;
use crate::{Fault, Phase};

impl UnifiedForceImpedance {
    /// Age of the zero that this run has taken, s.
    pub(super) fn zero_age_s(&self) -> Option<f64> {
        self.run.zeroed_s.map(|at_s| self.run.since_s - at_s)
    }

    /// Error of the zero that its age implies, N.
    pub(super) fn zero_bound_n(&self) -> Option<f64> {
        self.zero_age_s()
            .map(|age_s| self.config.touch.zero_drift_n_per_min * age_s / 60.0)
    }

    /// Phase `clear`: [`crate::departure::Departure::clear`] from where the tool stood.
    pub(super) fn clear(&mut self, now: &ArmNow, felt: &Felt, dt: f64) -> Wanted {
        let way = Way {
            from: *self.run.held.get_or_insert(now.tool.translation()),
            at: now.tool.translation(),
            velocity: Vector3::zeros(),
        };
        let rules = self.rules();
        let felt = (felt.verdict, self.load(now, felt));
        let departure = &mut self.run.departure;
        match departure.clear(&rules, &way, felt, self.run.paused, dt) {
            Clearing::Going(step) => moved(self.hold(now), &step),
            Clearing::Free => {
                self.run.held = None;
                self.enter(self.task.phase_at_rest());
                self.hold(now)
            }
            Clearing::Failed(fault) => {
                self.fail(fault);
                self.hold(now)
            }
        }
    }

    /// The retraction: [`crate::departure::Departure::retract`] from where the tool stood.
    pub(super) fn retract(&mut self, now: &ArmNow, felt: &Felt, dt: f64) -> Wanted {
        let start = self.hold(now);
        let away = self.smooth_normal(now);
        let way = Way {
            from: start.reference.position,
            at: now.tool.translation(),
            velocity: Vector3::zeros(),
        };
        let rules = self.rules();
        let load = self.load(now, felt);
        match self.run.departure.retract(&rules, away, &way, load, dt) {
            Retracting::Going(step) => moved(start, &step),
            Retracting::Ended(step, then) => {
                let wanted = moved(start, &step);
                self.run.held = Some(wanted.reference.position);
                self.enter(then);
                wanted
            }
            Retracting::Opposed => {
                self.run.fault = self.run.fault.or(Some(Fault::RetractOpposed));
                self.run.held = None;
                self.run.push_n = 0.0;
                self.enter(Phase::Fault);
                self.hold(now)
            }
        }
    }

    fn rules(&self) -> Rules {
        Rules::new(
            self.config.leave,
            self.config.path,
            &self.task,
            &self.limits,
        )
    }

    /// What a good wrench says; a bad sample is not waited out here.
    fn load(&self, now: &ArmNow, felt: &Felt) -> Load {
        let good = felt.verdict == WrenchVerdict::Good;
        let wrench = felt.wrench.filter(|_| good)?;
        Some(LoadFelt {
            force: now.tool.rotate(&wrench.fixed_rows::<3>(0).into_owned()),
            torque_nm: wrench.fixed_rows::<3>(3).norm(),
            hidden: felt.hidden,
            zeroed: self.run.fault != Some(Fault::ZeroInContact),
        })
    }
}

/// The reference, moved by this step.
fn moved(mut wanted: Wanted, step: &Step) -> Wanted {
    wanted.reference.position += step.offset;
    wanted.reference.velocity = step.velocity;
    wanted.policy = wanted.reference.position;
    wanted
}
