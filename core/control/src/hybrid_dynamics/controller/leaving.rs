//! How the tool leaves what it touches: off before the tare where it may touch, and the retraction
//! at the end.
//!
//! Called by `advance`; the motion itself is that of `departure`.

use super::super::HybridInput;
use super::super::law::{ArmNow, MotionReference};
use super::{Felt, HybridDynamics, Wanted};
use crate::departure::{Clearing, Load, LoadFelt, Retracting, Rules, Step, Way};
use crate::wrench_guard::WrenchVerdict;
use crate::{Fault, Phase};

impl HybridDynamics {
    /// Phase `clear`: [`crate::departure::Departure::clear`] from where the tool stood.
    pub(super) fn clear(
        &mut self,
        input: &HybridInput,
        now: &ArmNow,
        felt: Option<&Felt>,
        verdict: WrenchVerdict,
    ) -> Wanted {
        let dt = input.dt_s;
        let pose = *self.run.held.get_or_insert(now.tool);
        let way = Way {
            from: pose.translation(),
            at: now.tool.translation(),
            velocity: now.linear,
        };
        let rules = self.rules();
        let load = self.load(input, felt);
        let departure = &mut self.run.departure;
        match departure.clear(&rules, &way, (verdict, load), self.paused, dt) {
            Clearing::Going(step) => moved(MotionReference::at_rest(&pose), &step),
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
    pub(super) fn retract(
        &mut self,
        input: &HybridInput,
        now: &ArmNow,
        felt: Option<&Felt>,
    ) -> Wanted {
        let dt = input.dt_s;
        let away = self.constraint(now).normal;
        let pose = *self.run.held.get_or_insert(now.tool);
        let way = Way {
            from: pose.translation(),
            at: now.tool.translation(),
            velocity: now.linear,
        };
        let rules = self.rules();
        let load = self.load(input, felt);
        let departure = &mut self.run.departure;
        let step = match departure.retract(&rules, away, &way, load, dt) {
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

    fn rules(&self) -> Rules {
        Rules::new(
            self.config.leave,
            self.config.path,
            &self.task,
            &self.limits,
        )
    }

    fn load(&self, input: &HybridInput, felt: Option<&Felt>) -> Load {
        let hidden = |load| self.limits.is_untared_beyond(load);
        felt.map(|felt| LoadFelt {
            force: felt.force,
            torque_nm: felt.moment.norm(),
            hidden: input.untared.as_ref().is_some_and(hidden),
            zeroed: !self.run.zero_withdrawn && (input.bias_age_s.is_some() || !self.task.tare),
        })
    }
}

/// The reference, moved by this step.
fn moved(mut reference: MotionReference, step: &Step) -> Wanted {
    reference.position += step.offset;
    reference.velocity = step.velocity;
    Wanted {
        reference,
        in_object: None,
        pressing: false,
        seek_m_per_s: None,
    }
}
