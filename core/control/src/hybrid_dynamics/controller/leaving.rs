//! How the tool leaves what it touches: off before the tare where it may touch, and the retraction at the end.
//!
//! Called by `advance`; the motion itself is that of `departure`.

use super::super::law::{ArmNow, MotionReference};
use super::{Felt, HybridDynamics, Wanted};
use crate::departure::{Clearing, Load, Retracting, Rules, Step, Way};
use crate::wrench_guard::WrenchVerdict;
use crate::{Fault, Phase};

impl HybridDynamics {
    /// Phase `clear`: [`crate::departure::Departure::clear`] from where the tool stood.
    pub(super) fn clear(
        &mut self,
        now: &ArmNow,
        felt: Option<&Felt>,
        verdict: WrenchVerdict,
        dt: f64,
    ) -> Wanted {
        let pose = *self.run.held.get_or_insert(now.tool);
        let way = Way {
            from: pose.translation(),
            at: now.tool.translation(),
        };
        let rules = self.leave_rules();
        let departure = &mut self.run.departure;
        match departure.clear(&rules, &way, (verdict, load(felt)), self.paused, dt) {
            Clearing::Going(step) => moved(MotionReference::at_rest(&pose), &step),
            Clearing::Free => {
                self.run.held = None;
                self.enter(Phase::Tare);
                self.hold(now)
            }
            Clearing::Failed(fault) => {
                self.fail(fault);
                self.hold(now)
            }
        }
    }

    /// The retraction: [`crate::departure::Departure::retract`] from where the tool stood.
    pub(super) fn retract(&mut self, now: &ArmNow, felt: Option<&Felt>, dt: f64) -> Wanted {
        let away = self.constraint(now).normal;
        let pose = *self.run.held.get_or_insert(now.tool);
        let way = Way {
            from: pose.translation(),
            at: now.tool.translation(),
        };
        let rules = self.leave_rules();
        let departure = &mut self.run.departure;
        let step = match departure.retract(&rules, away, &way, load(felt), dt) {
            Retracting::Going(step) => step,
            Retracting::Ended(step, then) => {
                self.run.held = None;
                self.enter(then);
                step
            }
            Retracting::Opposed => {
                self.run.fault = self.run.fault.or(Some(Fault::RetractOpposed));
                self.run.held = None;
                self.enter(Phase::Fault);
                return self.hold(now);
            }
        };
        moved(MotionReference::at_rest(&pose), &step)
    }

    fn leave_rules(&self) -> Rules {
        Rules {
            leave: self.config.leave,
            path: self.config.path,
            end: self.task.end,
            reference_n: self.task.force.reference_n,
        }
    }
}

fn load(felt: Option<&Felt>) -> Load {
    felt.map(|felt| (felt.force, felt.moment.norm()))
}

/// The reference, moved by this step.
fn moved(mut reference: MotionReference, step: &Step) -> Wanted {
    reference.position += step.along * step.way_m;
    reference.velocity = step.along * step.speed_m_per_s;
    Wanted {
        reference,
        in_object: None,
        pressing: false,
        seek_m_per_s: None,
    }
}
