//! How the tool leaves contact: moving off before the tare if contact is possible, and the
//! retraction at the end.
//!
//! Called by `advance`; the motion itself is that of `departure`.

use tangent_mechanics::{Base, Pose, Tool};

use super::super::HybridInput;
use super::super::law::{ArmNow, MotionReference};
use super::{Felt, HybridDynamics, Wanted};
use crate::laws::torque_task::TorqueLaw;
use crate::leaving::departure::{Clearing, Load, LoadFelt, Retracting, Step, Way};
use crate::limits::faults::Fault;
use crate::limits::wrench_guard::WrenchVerdict;
use crate::phase_machine::Phase;

impl<const N: usize> HybridDynamics<N> {
    /// Phase `clear`: [`crate::leaving::departure::Departure::clear`] from where the tool stood.
    pub(super) fn clear(
        &mut self,
        input: &HybridInput<N>,
        now: &ArmNow<N>,
        felt: Option<&Felt>,
        verdict: WrenchVerdict,
    ) -> Wanted {
        let dt = input.dt_s;
        let (pose, way) = self.way(now);
        let rules = self.task.rules(&self.limits);
        let load = self.load(input, felt);
        let departure = &mut self.task.departure;
        match departure.clear(&rules, &way, (verdict, load), self.task.paused, dt) {
            Clearing::Going(step) => moved(MotionReference::at_rest(&pose), &step),
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
    pub(super) fn retract(
        &mut self,
        input: &HybridInput<N>,
        now: &ArmNow<N>,
        felt: Option<&Felt>,
    ) -> Wanted {
        let dt = input.dt_s;
        let away = self.constraint(now).normal;
        let (pose, way) = self.way(now);
        let rules = self.task.rules(&self.limits);
        let load = self.load(input, felt);
        let departure = &mut self.task.departure;
        let step = match departure.retract(&rules, away, &way, load, dt) {
            Retracting::Going(step) => step,
            Retracting::Ended(step, then) => {
                self.run.held = None;
                self.task.enter(then);
                step
            }
            Retracting::Opposed => {
                self.task.fault = self.task.fault.or(Some(Fault::RetractOpposed));
                self.run.held = None;
                self.task.enter(Phase::Fault);
                return self.hold(now);
            }
        };
        moved(MotionReference::at_rest(&pose), &step)
    }

    /// Pose in which the departure began, and the tool's way from there.
    fn way(&mut self, now: &ArmNow<N>) -> (Pose<Base, Tool>, Way) {
        let pose = *self.run.held.get_or_insert(now.tool);
        let way = Way {
            from: pose.translation(),
            at: now.tool.translation(),
            velocity: now.linear,
            free_at: self.run.tared_at,
        };
        (pose, way)
    }

    fn load(&self, input: &HybridInput<N>, felt: Option<&Felt>) -> Load {
        let hidden = |load| self.limits.is_untared_beyond(load);
        felt.map(|felt| LoadFelt {
            force: felt.force,
            torque_nm: felt.moment.norm(),
            hidden: input.untared.as_ref().is_some_and(hidden),
            zeroed: !self.run.zero_withdrawn
                && (input.bias_age_s.is_some() || !self.task.program.task.tare),
        })
    }
}

/// The reference, displaced by this step.
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
