//! The law for arms that take joint velocities, with the wrench, the base's pose and the estimates.

use tangent_control::{
    Clearance, ControlError, ControlInput, ControlOutput, Controller, EstimatorName, Parameter,
    Phase, Program, SwitchRefusal,
};
use tangent_runtime::Parameter as LiveParameter;
use tangent_schemas::convert::joint_array;

use crate::inputs::{EstimateReader, Inputs, Packet};
use crate::messages;
use crate::runner::{Motion, Report, Runner, Start};

/// Live parameters in the order of [`Parameter::ALL`], with the value last seen of each.
pub struct Live {
    parameters: [LiveParameter; 4],
    seen: [f64; 4],
}

impl Live {
    /// As they are now.
    pub fn new(parameters: [LiveParameter; 4]) -> Self {
        let seen = [0, 1, 2, 3].map(|i: usize| parameters[i].get());
        Self { parameters, seen }
    }

    /// Shows the values of the task that was started.
    fn show(&mut self, controller: &Controller) {
        for (i, parameter) in Parameter::ALL.into_iter().enumerate() {
            let value = controller.get(parameter);
            self.parameters[i].set(value);
            self.seen[i] = value;
        }
    }
}

/// Hybrid admittance with what it reads.
pub struct VelocityRunner {
    pub controller: Controller,
    pub inputs: Inputs,
    pub live: Live,
}

impl Runner for VelocityRunner {
    type Program = Program;
    type Output = (ControlInput, ControlOutput);

    fn phase(&self) -> Phase {
        self.controller.phase()
    }

    fn activation(&self) -> u64 {
        self.controller.activation()
    }

    fn clearance(&self) -> Clearance {
        self.controller.clearance()
    }

    fn start(&mut self, program: &mut Option<Program>, start: &Start) -> Result<(), ControlError> {
        let controller = &mut self.controller;
        let known = controller.clearance();
        if start.said_clear {
            controller.set_clearance(Clearance::Assumed)?;
        }
        let started = controller
            .check_start(&start.position)
            .and_then(|()| match program.take() {
                Some(new) => controller.start(new, start.latched),
                None => Ok(None),
            });
        match started {
            Ok(old) => *program = old,
            Err(error) => {
                controller.set_clearance(known)?;
                return Err(error);
            }
        }
        self.live.show(controller);
        Ok(())
    }

    fn pause(&mut self) -> Result<(), ControlError> {
        self.controller.pause()
    }

    fn resume(&mut self) -> Result<(), ControlError> {
        self.controller.resume()
    }

    fn stop(&mut self) {
        self.controller.stop();
    }

    fn is_left_on_surface(&self) -> bool {
        self.controller.is_left_on_surface()
    }

    fn leave_surface(&mut self, latched: u64) {
        self.controller.leave_surface(latched);
    }

    fn select(&mut self, name: &EstimatorName, force: bool) -> Result<(), SwitchRefusal> {
        self.controller.listen_to(*name);
        self.controller.select_estimator(name, force)
    }

    fn listen(&mut self, reader: EstimateReader) -> Option<EstimateReader> {
        self.inputs.listen(reader)
    }

    /// The law moves to a new value on a ramp.
    fn take_parameters(&mut self) {
        for (i, parameter) in Parameter::ALL.into_iter().enumerate() {
            let value = self.live.parameters[i].get();
            if value != self.live.seen[i] {
                self.live.seen[i] = value;
                self.controller.set(parameter, value);
            }
        }
    }

    fn hold(&mut self, held: bool) {
        self.inputs.hold(held);
    }

    fn step(&mut self, packet: &Packet<'_>) -> Option<Self::Output> {
        let names = self.controller.estimators().clone();
        let input = self.inputs.gather(packet, &names)?;
        let output = self.controller.step(&input);
        Some((input, output))
    }

    fn motion(&self, (_, output): &Self::Output) -> Motion {
        Motion {
            kind: output.kind,
            values: joint_array(&output.qd),
            acceleration: output.acceleration,
        }
    }

    fn report(&self, (input, output): Self::Output) -> Report {
        let mut state = messages::state(&input, &output, &self.controller);
        messages::tell_ages(&mut state, self.inputs.ages());
        let name = self.controller.estimators().get(output.estimator);
        Report {
            state,
            shaping: None,
            phase: output.phase,
            fault: output.fault,
            tare_requested: output.tare_requested,
            clearance: output.clearance,
            zero_withdrawn: output.zero_withdrawn,
            estimator: name
                .map(|name| (*name, output.estimator_switches, messages::cause(&output))),
        }
    }
}
