//! Implements [`Law`] for the hybrid admittance, for arms that take joint velocities.

use super::config::ControllerConfig;
use super::controller::Controller;
use crate::coverage::CoverageResult;
use crate::error::ControlError;
use crate::estimator_choice::switching::SwitchRefusal;
use crate::law::{EstimatorInUse, JointCommand, Law, LawInput, LawOutput, Start};
use crate::learning::EndedPass;
use crate::leaving::clearance::Clearance;
use crate::parameters::live::Parameter;
use crate::phase_machine::Phase;
use crate::task::Task;
use crate::task::program::{EstimatorName, Program};

impl<const N: usize> Law<N> for Controller<N> {
    type Config = ControllerConfig;

    const PARAMETERS: &'static [Parameter] = &Parameter::ALL;

    const COVERS: bool = true;

    fn step(&mut self, input: &LawInput<N>) -> LawOutput<N> {
        let output = Controller::step(self, input);
        let estimator = Controller::estimators(self).get(output.estimator);
        LawOutput {
            command: JointCommand {
                kind: output.kind,
                values: output.qd,
                acceleration: output.acceleration,
            },
            phase: output.phase,
            fault: output.fault,
            tare_requested: output.tare_requested,
            clearance: output.clearance,
            zero_withdrawn: output.zero_withdrawn,
            estimator: estimator.map(|name| EstimatorInUse {
                name: *name,
                switches: output.estimator_switches,
                cause: output.estimator_cause,
            }),
            estimate_age_s: Some(output.estimate_age_s),
            normal: output.normal,
            force_reference_n: output.force_reference_n,
            force_n: output.force_n,
            wrench: output.wrench,
            wrench_age_s: output.wrench_age_s,
            zero_age_s: input.bias_age_s,
            zero_bound_n: input.zero_bound_n,
            path_reference: output.path_reference,
            path_error_m: output.path_error_m,
            path_progress: output.path_progress,
            alignment_error_rad: output.alignment_error_rad,
            manipulability: output.manipulability,
            contact_lost_count: output.contact_lost_count,
            motion_tank_j: 0.0,
            force_tank_j: output.force_tank_j.unwrap_or_default(),
            shaping: None,
        }
    }

    fn start(&mut self, program: &mut Option<Program>, start: &Start) -> Result<(), ControlError> {
        let known = Controller::clearance(self);
        if start.said_clear {
            self.set_clearance(Clearance::Assumed)?;
        }
        let started = self
            .check_start(&start.position)
            .and_then(|()| match program.take() {
                Some(new) => Controller::start(self, new, start.latched),
                None => Ok(None),
            });
        match started {
            Ok(old) => *program = old,
            Err(error) => {
                self.set_clearance(known)?;
                return Err(error);
            }
        }
        Ok(())
    }

    fn pause(&mut self, paused: bool) -> Result<(), ControlError> {
        if paused {
            Controller::pause(self)
        } else {
            self.resume()
        }
    }

    fn is_paused(&self) -> bool {
        Controller::is_paused(self)
    }

    fn stop(&mut self) {
        Controller::stop(self);
    }

    fn is_left_on_surface(&self) -> bool {
        Controller::is_left_on_surface(self)
    }

    fn leave_surface(&mut self, latched: u64) {
        Controller::leave_surface(self, latched);
    }

    fn take_pass(&mut self) -> Option<EndedPass> {
        Controller::take_pass(self)
    }

    fn take_coverage(&mut self) -> Option<CoverageResult> {
        Controller::take_coverage(self)
    }

    fn select(&mut self, name: &EstimatorName, force: bool) -> Result<(), SwitchRefusal> {
        self.listen_to(*name);
        self.select_estimator(name, force)
    }

    fn estimators(&self) -> &[EstimatorName] {
        Controller::estimators(self)
    }

    fn set(&mut self, parameter: Parameter, value: f64) {
        Controller::set(self, parameter, value);
    }

    fn get(&self, parameter: Parameter) -> f64 {
        Controller::get(self, parameter)
    }

    fn phase(&self) -> Phase {
        Controller::phase(self)
    }

    fn activation(&self) -> u64 {
        Controller::activation(self)
    }

    fn clearance(&self) -> Clearance {
        Controller::clearance(self)
    }

    fn task(&self) -> Option<&Task> {
        Controller::task(self)
    }
}
