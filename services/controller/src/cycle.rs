//! One cycle of the hard loop: called inside the bridge's `publish(arm/state)` when co-located, with `arm/command`
//! published before it returns. Takes no lock and no memory.

use std::sync::Arc;
use std::time::Instant;

use nalgebra::Vector3;
use tangent_control::{Clearance, ControlError, ControlOutput, Controller, Parameter, Program};
use tangent_runtime::clock::now_ns;
use tangent_runtime::{
    Age, Gauge, HealthReporter, Histogram, Parameter as LiveParameter, Publisher, Rate, Received,
};
use tangent_schemas::tangent::{ArmCommand, ArmState, ControlState};
use tangent_schemas::{Name, Text};

use crate::inputs::{Inputs, driven_by_another};
use crate::mailbox::{Ask, Letter, Mailbox, Outcome, cannot_leave};
use crate::messages;
use crate::pinned::PinnedArm;
use crate::watch::{Told, Watch};

/// Live parameters in the order of [`Parameter::ALL`], with the value last seen of each.
pub struct Live {
    parameters: [LiveParameter; 4],
    seen: [f64; 4],
}

impl Live {
    /// As they stand.
    pub fn new(parameters: [LiveParameter; 4]) -> Self {
        let seen = [0, 1, 2, 3].map(|i: usize| parameters[i].get());
        Self { parameters, seen }
    }
}

/// Meters of the cycle.
pub struct Meters {
    cycles: Rate,
    arm_age: Age,
    wrench_age: Gauge,
    estimate_age: Gauge,
    step: Histogram,
}

impl Meters {
    /// In the service's health.
    pub fn new(health: &HealthReporter) -> Self {
        Self {
            cycles: health.rate("arm_state"),
            arm_age: health.age("arm_state"),
            wrench_age: health.gauge("wrench_age_s"),
            estimate_age: health.gauge("estimate_age_s"),
            step: health.histogram("step"),
        }
    }
}

/// Everything the loop owns.
pub struct Cycle {
    pub controller: Controller,
    pub inputs: Inputs,
    pub command: Publisher<ArmCommand>,
    pub state: Publisher<ControlState>,
    pub source: Name,
    pub mailbox: Arc<Mailbox<Program>>,
    pub meters: Meters,
    pub live: Live,
    pub watch: Watch<Program>,
    /// Activation that the bridge has latched out.
    pub latched: u64,
    pub arm: PinnedArm,
    /// A command would move the arm now.
    pub ready: bool,
    /// Where the tool is, base axes, m.
    pub position: Vector3<f64>,
}

impl Cycle {
    /// Answers one packet of the robot.
    pub fn step(&mut self, arm: &Received<ArmState>) {
        let begin = Instant::now();
        let arm_age = begin.saturating_duration_since(arm.received);
        self.meters.cycles.tick();
        self.meters.arm_age.mark_at(arm.received);
        self.watch.count_missed(arm.message.cycle);
        self.latched = arm.message.activation_latched;
        self.position = (&arm.message.tool_pose.position).into();
        let other = driven_by_another(&arm.message, self.command.mark());
        self.ready = arm.message.ready && other.is_none();
        for slot in self.mailbox.waiting() {
            if let Some(letter) = self.mailbox.take(slot, begin) {
                self.deal_with(letter);
            }
        }
        self.take_parameters();
        let active = self.controller.phase().is_active();
        // A task keeps to the publishers that it was started on.
        self.inputs.hold(active);
        let another_arm = self.arm.is_another(arm.publisher, active);
        let names = self.controller.estimators().clone();
        let Some(mut input) = self.inputs.gather(arm, &names, self.command.mark()) else {
            // No answer: the bridge ramps the arm down by itself.
            self.watch.unusable();
            return;
        };
        // The bridge has ended this task: to it, all that is commanded for it is void.
        if another_arm || active && arm.message.activation_latched >= self.controller.activation() {
            input.arm_ready = false;
        }
        let output = self.controller.step(&input);
        self.command.publish(&messages::command(
            &arm.message,
            &output,
            self.source,
            now_ns(),
        ));
        let took = begin.elapsed();
        let mut state = messages::state(
            &arm.message,
            &input,
            &output,
            &self.controller,
            arm_age.as_secs_f64(),
            took.as_secs_f64(),
        );
        state.fault = self.watch.fault_text(output.fault, state.fault);
        let fault_text = state.fault;
        messages::tell_ages(&mut state, self.inputs.ages());
        self.state.publish(&state);
        self.meters.step.record(took);
        self.meters.wrench_age.set(output.wrench_age_s);
        self.meters.estimate_age.set(output.estimate_age_s);
        self.after(&output, fault_text, other);
    }

    fn deal_with(&mut self, mut letter: Letter<Program>) {
        let controller = &mut self.controller;
        let result = match letter.ask() {
            Ask::Start {
                program,
                said_clear,
            } => match start(
                controller,
                program,
                *said_clear,
                &self.position,
                self.latched,
            ) {
                Ok(()) => {
                    self.watch.said_clear = *said_clear;
                    self.show_parameters();
                    Ok(())
                }
                Err(error) => Err(Outcome::Refused(error)),
            },
            Ask::Pause => controller.pause().map_err(Outcome::Refused),
            Ask::Resume => controller.resume().map_err(Outcome::Refused),
            Ask::Stop if controller.is_left_on_surface() => {
                if self.ready {
                    controller.leave_surface(self.latched);
                    Ok(())
                } else {
                    Err(Outcome::Refused(cannot_leave(controller.phase())))
                }
            }
            Ask::Stop if !controller.phase().is_active() && !controller.clearance().is_free() => {
                Err(Outcome::MayTouch)
            }
            Ask::Stop => {
                controller.stop();
                Ok(())
            }
            Ask::Select { name, force } => {
                controller.listen_to(*name);
                controller
                    .select_estimator(name, *force)
                    .map_err(Outcome::SwitchRefused)
            }
            Ask::Listen(reader) => {
                if let Some(new) = reader.take() {
                    **reader = self.inputs.listen(new);
                }
                Ok(())
            }
        };
        let (activation, phase) = (self.controller.activation(), self.controller.phase());
        letter.answer(match result {
            Ok(()) => Outcome::Done { activation, phase },
            Err(refused) => refused,
        });
    }

    /// A parameter that was set since the last cycle goes to the law, which ramps it.
    fn take_parameters(&mut self) {
        for (i, parameter) in Parameter::ALL.into_iter().enumerate() {
            let value = self.live.parameters[i].get();
            if value != self.live.seen[i] {
                self.live.seen[i] = value;
                self.controller.set(parameter, value);
            }
        }
    }

    /// A task brought its own values.
    fn show_parameters(&mut self) {
        for (i, parameter) in Parameter::ALL.into_iter().enumerate() {
            let value = self.controller.get(parameter);
            self.live.parameters[i].set(value);
            self.live.seen[i] = value;
        }
    }

    fn after(&mut self, output: &ControlOutput, fault_text: Text, other: Option<Name>) {
        if let Some(name) = self.controller.estimators().get(output.estimator) {
            self.watch
                .estimator(*name, output.estimator_switches, messages::cause(output));
        }
        self.watch.after(&Told {
            phase: output.phase,
            fault: output.fault,
            fault_text,
            tare_requested: output.tare_requested,
            clearance: output.clearance,
            zero_withdrawn: output.zero_withdrawn,
            other,
        });
    }
}

/// Starts a program; what a person says of the tool counts only where the start does.
fn start(
    controller: &mut Controller,
    program: &mut Option<Program>,
    said_clear: bool,
    position: &Vector3<f64>,
    latched: u64,
) -> Result<(), ControlError> {
    if controller.phase().is_active() {
        return Err(ControlError::WrongPhase {
            request: "start a task",
            phase: controller.phase().name(),
            remedy: "stop the running task first",
        });
    }
    let known = controller.clearance();
    if said_clear {
        controller.set_clearance(Clearance::Assumed)?;
    }
    let started = controller
        .check_start(position)
        .and_then(|()| match program.take() {
            Some(new) => controller.start(new, latched),
            None => Ok(None),
        });
    match started {
        Ok(old) => *program = old,
        Err(error) => {
            controller.set_clearance(known)?;
            return Err(error);
        }
    }
    Ok(())
}
