//! What the controller is asked for between cycles: to start, pause, resume and stop a task, to
//! choose an estimator, and to change a live parameter.

use nalgebra::Vector3;

use super::super::moving_base::MovingBase;
use super::super::percept::Requests;
use super::super::run::Run;
use super::super::travel::TravelPoses;
use super::Controller;
use crate::error::ControlError;
use crate::estimator_choice::switching::{ChoiceRules, SwitchRefusal};
use crate::leaving::clearance::Clearance;
use crate::parameters::live::Parameter;
use crate::phase_machine::Phase;
use crate::task::Task;
use crate::task::program::{EstimatorName, Program};

impl<const N: usize> Controller<N> {
    /// Makes a program from a task and starts it. Allocates: for the closed loop and tests, not for
    /// the robot's cycle.
    pub fn start_task(&mut self, task: &Task) -> Result<(), ControlError> {
        let program = Program::new(task, &self.config)?;
        self.start(program, 0).map(drop)
    }

    /// Starts a program from idle, done or fault. Returns the previous one, which must be dropped
    /// outside the loop. `latched` is the activation that the bridge has latched out: the new one
    /// is greater.
    pub fn start(
        &mut self,
        mut program: Program,
        latched: u64,
    ) -> Result<Option<Program>, ControlError> {
        if self.run.phase.is_active() {
            return Err(self.wrong_phase("start a task", "stop the running task first"));
        }
        if self.run.clearance == Clearance::Unknown {
            return Err(ControlError::MayTouch { moved_m: None });
        }
        self.poses = TravelPoses::of(&program.task)?;
        self.activation = self.activation.max(latched).saturating_add(1);
        self.requests = Requests::default();
        self.run = Run::start(&program, self.run.clearance);
        self.moving_base = MovingBase::default();
        self.names = program.estimators.clone();
        self.config = program.config;
        self.speed_m_per_s = program.task.path.speed_m_per_s();
        self.targets = [
            program.task.force.reference_n,
            self.speed_m_per_s,
            self.config.alignment.gain_per_s,
            self.config.force.damping_n_s_per_m,
        ];
        let new = std::mem::take(&mut program.memory);
        let learner = new.learner.as_ref();
        self.run.knows_surface = learner.is_some_and(|learner| learner.knows_surface());
        let old = std::mem::replace(&mut self.memory, new);
        let mut before = self.program.replace(program);
        if let Some(before) = &mut before {
            before.memory = old;
        }
        Ok(before)
    }

    /// Whether a task may start with the tool at `position` (base axes, m).
    ///
    /// # Errors
    /// [`ControlError::MayTouch`] if the tool may touch something and the direction away from it is
    /// not known.
    pub fn check_start(&self, position: &Vector3<f64>) -> Result<(), ControlError> {
        let leave = &self.config.leave;
        self.run.clearance.way_out(leave, position).map(drop)
    }

    /// Sets the clearance known from an earlier controller or confirmed by a person.
    ///
    /// # Errors
    /// A task runs.
    pub fn set_clearance(&mut self, clearance: Clearance) -> Result<(), ControlError> {
        if self.run.phase.is_active() {
            return Err(self.wrong_phase("state that the tool hangs free", "stop the task first"));
        }
        self.run.clearance = clearance;
        Ok(())
    }

    /// Stands still in every phase: the path stops where it is, a pressing tool keeps its force,
    /// and no time limit runs.
    ///
    /// # Errors
    /// No task runs, or it is leaving the surface.
    pub fn pause(&mut self) -> Result<(), ControlError> {
        if !self.run.phase.is_active() || self.run.phase == Phase::Retract {
            return Err(self.wrong_phase("pause", "there is no path to stop"));
        }
        self.requests.paused = true;
        Ok(())
    }

    /// Resumes after [`Controller::pause`].
    pub fn resume(&mut self) -> Result<(), ControlError> {
        if !self.run.phase.is_active() || self.run.phase == Phase::Retract {
            return Err(self.wrong_phase("resume", "start the task again"));
        }
        self.requests.paused = false;
        Ok(())
    }

    /// Whether a task is paused.
    pub fn is_paused(&self) -> bool {
        self.requests.paused && self.run.phase.is_active() && self.run.phase != Phase::Retract
    }

    /// Ends the task: retracts, then done. No effect if no task runs.
    pub fn stop(&mut self) {
        self.requests.stopping = true;
    }

    /// Ends the task with a retraction along `away` (base axes) instead of the last good normal:
    /// for tests with a wrong direction.
    #[doc(hidden)]
    pub fn stop_along(&mut self, away: Vector3<f64>) {
        self.run.way_off = Some(away);
        self.stop();
    }

    /// Whether the task has ended with the tool possibly still on the surface, after a fault in
    /// which nothing could move.
    pub fn is_left_on_surface(&self) -> bool {
        self.run.is_left_on_surface()
    }

    /// Retracts a tool that [is left on the surface](Self::is_left_on_surface) along the last good
    /// normal, by the retraction distance of the task. `latched` as in [`Controller::start`]: the
    /// motion has its own activation.
    pub fn leave_surface(&mut self, latched: u64) {
        if self.run.is_left_on_surface() {
            self.activation = self.activation.max(latched) + 1;
            self.requests = Requests::default();
            self.run.leave_again();
        }
    }

    fn wrong_phase(&self, request: &'static str, remedy: &'static str) -> ControlError {
        ControlError::WrongPhase {
            request,
            phase: self.run.phase.name(),
            remedy,
        }
    }

    /// Adds an estimator to [`Controller::estimators`] without using it. Returns its place in the
    /// list, `None` if the list is full.
    pub fn listen_to(&mut self, name: EstimatorName) -> Option<usize> {
        if let Some(index) = self.names.iter().position(|n| *n == name) {
            return Some(index);
        }
        self.names.try_push(name).ok()?;
        Some(self.names.len() - 1)
    }

    /// Switches to another estimator of [`Controller::estimators`] if it is fresh, valid and near
    /// the normal in use; `force` waives the last two conditions. The normal then turns at a
    /// bounded rate.
    pub fn select_estimator(&mut self, name: &str, force: bool) -> Result<(), SwitchRefusal> {
        if !self.run.phase.is_active() {
            return Err(SwitchRefusal::NoTask);
        }
        let index = self
            .names
            .iter()
            .position(|n| n.as_str() == name)
            .ok_or(SwitchRefusal::Unknown)?;
        let program = self.program.as_ref().ok_or(SwitchRefusal::NoTask)?;
        self.run.choice.select(
            &ChoiceRules::new(
                &self.config.normal,
                &self.config.patience,
                &program.task.switching,
            ),
            &self.estimates,
            &self.run.surface.normal,
            index,
            force,
        )
    }

    /// Sets a live parameter, clamped to its range; it takes effect over a ramp. A task's start
    /// sets all of them to the values of the task and the preset.
    pub fn set(&mut self, parameter: Parameter, value: f64) {
        let (lower, upper) = parameter.range();
        if value.is_finite() {
            self.targets[parameter as usize] = value.clamp(lower, upper);
        }
    }

    /// Value of a live parameter, or its target during a ramp.
    pub fn get(&self, parameter: Parameter) -> f64 {
        self.targets[parameter as usize]
    }
}
