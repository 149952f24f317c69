//! Shared by the torque laws: the task with its estimators and its phase, and the loop's requests
//! to it.
//!
//! Each law adds its own inputs, phases and torques. The motion off a surface is in `departure`.

use nalgebra::Vector3;

use crate::error::ControlError;
use crate::estimator_choice::list::EstimatorList;
use crate::estimator_choice::switching::{ChoiceRules, SwitchRefusal};
use tangent_mechanics::Joints;
use tangent_schemas::CommandKind;

use crate::joint_move::left_rad;
use crate::law::{JointCommand, Law, LawInput, LawOutput, Start};
use crate::leaving::clearance::Clearance;
use crate::leaving::config::LeaveConfig;
use crate::leaving::departure::{Departure, Rules};
use crate::limits::Limits;
use crate::limits::faults::Fault;
use crate::parameters::law_config::LawConfig;
use crate::parameters::live::Parameter;
use crate::parameters::{PathProfileConfig, PatienceConfig};
use crate::phase_machine::Phase;
use crate::task::Task;
use crate::task::program::{EstimatorName, Program};

/// Force limit, N, of the placeholder task before the first one. It is never started.
pub(crate) const IDLE_FORCE_N: f64 = 20.0;

/// Parameters of a torque law that its task needs.
pub trait TorqueConfig: LawConfig {
    /// Whether the estimators that a task names measure by sliding.
    const FELT_BY_SLIDING: bool;

    /// The parameters that every torque law has.
    fn shared(&self) -> SharedParameters<'_>;
}

/// Parameters that every torque law has.
#[derive(Clone, Copy, Debug)]
pub struct SharedParameters<'a> {
    /// Acceleration, jerk and clock of the path.
    pub path: &'a PathProfileConfig,
    /// Timeouts of missing and of invalid input.
    pub patience: &'a PatienceConfig,
    /// How the tool leaves a surface, and how it is shown to be free.
    pub leave: &'a LeaveConfig,
}

/// The running or last task of a law, and the state that outlasts it.
pub struct TorqueTask<C> {
    pub program: Program<C>,
    /// Estimators of the task, and the one in use.
    pub estimators: EstimatorList,
    /// Normal in use in the cycle before, base axes; `None` where the law uses no estimate.
    pub normal_in_use: Option<Vector3<f64>>,
    /// Number of task starts.
    activation: u64,
    /// Whether a task was started. Before, the arm holds itself.
    started: bool,
    pub phase: Phase,
    /// The last fault since the task started.
    pub fault: Option<Fault>,
    /// Time in the current phase without pauses, s.
    pub phase_s: f64,
    /// Time since the start without pauses, s.
    pub elapsed_s: f64,
    pub paused: bool,
    pub(crate) departure: Departure,
}

impl<C: TorqueConfig> TorqueTask<C> {
    /// A task that waits for its start in phase `Tare`.
    pub fn new(program: Program<C>) -> Self {
        Self {
            estimators: estimators(&program),
            program,
            normal_in_use: None,
            activation: 0,
            started: true,
            phase: Phase::Tare,
            fault: None,
            phase_s: 0.0,
            elapsed_s: 0.0,
            paused: false,
            departure: Departure::default(),
        }
    }

    /// Before the first task; `clearance` is what is known of the tool.
    pub fn idle(program: Program<C>, clearance: Clearance) -> Self {
        Self {
            started: false,
            phase: Phase::Idle,
            departure: Departure::new(clearance),
            ..Self::new(program)
        }
    }

    /// Begins the task. Unless the tool is known to be free, it first moves off the surface (phase
    /// `Clear`).
    pub fn begin(&mut self, clearance: Clearance) {
        self.estimators = estimators(&self.program);
        self.normal_in_use = None;
        self.phase = if clearance.is_free() {
            self.program.task.phase_at_rest()
        } else {
            Phase::Clear
        };
        self.fault = None;
        self.phase_s = 0.0;
        self.elapsed_s = 0.0;
        self.paused = false;
        self.departure = Departure::new(clearance);
    }

    /// Whether the task is paused and not moving off the surface.
    pub fn stands(&self) -> bool {
        self.paused && self.phase != Phase::Retract
    }

    /// Whether the task has just begun, and the arm does not stand in its start pose.
    fn begins_away<const N: usize>(&self, q: &Joints<N>) -> bool {
        let begins = self.phase.is_active() && self.elapsed_s == 0.0;
        let Some(start) = self.program.task.start.as_ref().filter(|_| begins) else {
            return false;
        };
        !start
            .joints::<N>("start")
            .is_ok_and(|target| left_rad(q, &target) <= start.tolerance_rad)
    }

    /// Counts the time of one period. No time limit runs while the task is paused.
    pub fn count(&mut self, dt_s: f64) {
        if !self.stands() {
            self.elapsed_s += dt_s;
            self.phase_s += dt_s;
        }
    }

    /// Enters a phase.
    pub fn enter(&mut self, phase: Phase) {
        if self.phase != phase {
            self.phase = phase;
            self.phase_s = 0.0;
        }
    }

    /// Retracts from the surface, then enters phase `then`. Enters it at once from `Tare`, before
    /// the tool has approached, and from `Clear`, which moves it off already.
    pub fn leave(&mut self, then: Phase) {
        if matches!(self.phase, Phase::Tare | Phase::Clear) {
            return self.enter(then);
        }
        self.departure.begin_retraction(then);
        self.enter(Phase::Retract);
    }

    /// Phase in which the task ends if it leaves the surface now.
    pub fn phase_at_end(&self) -> Phase {
        if self.fault.is_some() {
            Phase::Fault
        } else {
            Phase::Done
        }
    }

    /// Stands still in every phase; `false` resumes.
    ///
    /// # Errors
    /// No task runs, or it is retracting.
    pub fn pause(&mut self, paused: bool) -> Result<(), ControlError> {
        if !self.phase.is_active() || self.phase == Phase::Retract {
            return Err(ControlError::WrongPhase {
                request: if paused { "pause" } else { "resume" },
                phase: self.phase.name(),
                remedy: if self.started {
                    "start the task again"
                } else {
                    "start a task first"
                },
            });
        }
        self.paused = paused;
        Ok(())
    }

    /// Whether the task is paused.
    pub fn is_paused(&self) -> bool {
        self.phase.is_active() && self.stands()
    }

    /// Sets the desired pressing force, N.
    pub fn set_force_reference(&mut self, force_n: f64) {
        if force_n.is_finite() {
            self.program.task.force.reference_n = force_n.max(0.0);
        }
    }

    /// How the tool leaves the surface of this task, within the limits of the cell.
    pub(crate) fn rules(&self, limits: &Limits) -> Rules {
        let shared = self.program.config.shared();
        Rules::new(*shared.leave, *shared.path, &self.program.task, limits)
    }

    /// Output of one cycle with `torque` (Nm) as the command, and what follows from the task alone.
    /// The rest is that of [`LawOutput::idle`]: the law sets it.
    pub(crate) fn output<const N: usize>(
        &self,
        input: &LawInput<N>,
        torque: Joints<N>,
    ) -> LawOutput<N> {
        let kind = if self.phase.is_active() {
            CommandKind::JointTorque
        } else {
            CommandKind::Hold
        };
        LawOutput {
            command: JointCommand {
                kind,
                values: torque,
                acceleration: 0.0,
            },
            phase: self.phase,
            fault: self.fault,
            estimator: Some(self.estimators.in_use()),
            wrench_age_s: input.wrench_age_s,
            ..LawOutput::idle(input, self.departure.clearance)
        }
    }

    /// Stores the normal of this cycle for the choice of the next estimate. Until the tare is done
    /// the law may use no estimate at all.
    pub fn keep_normal(&mut self, phase: Phase, normal: Vector3<f64>) {
        let uses_estimate = phase.is_active() && phase != Phase::Tare;
        self.normal_in_use = uses_estimate.then_some(normal);
    }
}

fn estimators<C: TorqueConfig>(program: &Program<C>) -> EstimatorList {
    let (patience, switching) = (program.config.shared().patience, &program.task.switching);
    let rules = ChoiceRules::of_torques(patience, switching, C::FELT_BY_SLIDING);
    EstimatorList::new(program.estimators.iter().copied(), rules)
}

/// A torque law. All of them answer the loop's requests in the same way: through [`Law`], which is
/// implemented for every one of them.
pub trait TorqueLaw<const N: usize>: Send {
    /// Its parameters.
    type Config: TorqueConfig;

    /// Whether the law shapes its output, as [`Law::SHAPES`] states.
    const SHAPES: bool;

    /// The running or last task.
    fn torque_task(&self) -> &TorqueTask<Self::Config>;

    /// The running or last task.
    fn torque_task_mut(&mut self) -> &mut TorqueTask<Self::Config>;

    /// Sets the law's own state to that of a task that begins.
    fn reset(&mut self);

    /// Forgets where the tool stands still: the next phase that holds it takes the measured pose.
    fn release(&mut self);

    /// Whether the tool has touched the surface in this task.
    fn has_touched(&self) -> bool;

    /// Forgets integrals, motions and pushes: the arm may have been moved since the task ended.
    fn forget_motion(&mut self);

    /// Chooses among the estimates and runs one cycle.
    fn cycle(&mut self, input: &LawInput<N>) -> LawOutput<N>;

    /// Begins the program that the task has taken, with `clearance`. Unless the tool is known to be
    /// free, it first moves off the surface (phase `Clear`).
    fn begin(&mut self, clearance: Clearance) {
        self.torque_task_mut().begin(clearance);
        self.reset();
    }

    /// Begins the last task again, with the current clearance.
    fn restart(&mut self) {
        self.begin(self.torque_task().departure.clearance);
    }

    /// Whether a task may start with the tool at `position` (base axes, m), given its clearance.
    ///
    /// # Errors
    /// [`ControlError::MayTouch`] if the tool may touch something and the direction away from it is
    /// not known.
    fn check_start(
        &self,
        clearance: &Clearance,
        position: &Vector3<f64>,
    ) -> Result<(), ControlError> {
        let leave = self.torque_task().program.config.shared().leave;
        clearance.way_out(leave, position).map(drop)
    }

    /// Ends the task with a retraction along `away` (base axes) instead of the last good normal:
    /// for tests with a wrong direction.
    #[doc(hidden)]
    fn stop_along(&mut self, away: Vector3<f64>) {
        let task = self.torque_task_mut();
        task.departure.way_off = Some(away);
        if task.phase.is_active() {
            self.leave(Phase::Done);
        }
    }

    /// Retracts from the surface, then enters phase `then`. Enters it at once from `Tare`, before
    /// the tool has approached, and from `Clear`, which moves it off already.
    fn leave(&mut self, then: Phase) {
        self.release();
        self.torque_task_mut().leave(then);
    }

    /// Ends the task with a fault, after a retraction.
    fn fail(&mut self, fault: Fault) {
        self.torque_task_mut().fault = Some(fault);
        self.leave(Phase::Fault);
    }
}

impl<T: TorqueLaw<N>, const N: usize> Law<N> for T {
    type Config = T::Config;

    const PARAMETERS: &'static [Parameter] = &[Parameter::ForceReference];

    const SHAPES: bool = <T as TorqueLaw<N>>::SHAPES;

    fn step(&mut self, input: &LawInput<N>) -> LawOutput<N> {
        if self.torque_task().started {
            if self.torque_task().begins_away(&input.q) {
                let task = self.torque_task_mut();
                task.fault = Some(Fault::StartAway);
                task.enter(Phase::Fault);
            }
            self.cycle(input)
        } else {
            LawOutput::idle(input, self.torque_task().departure.clearance)
        }
    }

    fn start(
        &mut self,
        program: &mut Option<Program<Self::Config>>,
        start: &Start,
    ) -> Result<(), ControlError> {
        let task = self.torque_task_mut();
        let clearance = if start.said_clear {
            Clearance::Assumed
        } else {
            task.departure.clearance
        };
        let Some(new) = program else {
            return Ok(());
        };
        clearance.way_out(new.config.shared().leave, &start.position)?;
        std::mem::swap(&mut task.program, new);
        task.started = true;
        task.activation = task.activation.max(start.latched).saturating_add(1);
        self.begin(clearance);
        Ok(())
    }

    fn pause(&mut self, paused: bool) -> Result<(), ControlError> {
        self.torque_task_mut().pause(paused)
    }

    fn is_paused(&self) -> bool {
        self.torque_task().is_paused()
    }

    fn stop(&mut self) {
        if self.torque_task().phase.is_active() {
            self.leave(Phase::Done);
        }
    }

    fn is_left_on_surface(&self) -> bool {
        let task = self.torque_task();
        !task.phase.is_active() && self.has_touched() && task.departure.may_be_on_surface()
    }

    fn leave_surface(&mut self, latched: u64) {
        let task = self.torque_task_mut();
        if !task.started {
            return;
        }
        task.activation = task.activation.max(latched).saturating_add(1);
        if !self.is_left_on_surface() {
            return;
        }
        self.torque_task_mut().paused = false;
        self.forget_motion();
        self.leave(self.torque_task().phase_at_end());
    }

    fn select(&mut self, name: &EstimatorName, force: bool) -> Result<(), SwitchRefusal> {
        let task = self.torque_task_mut();
        if !task.started {
            return Err(SwitchRefusal::NoTask);
        }
        task.estimators.select(name, force)
    }

    fn estimators(&self) -> &[EstimatorName] {
        if self.torque_task().started {
            self.torque_task().estimators.names()
        } else {
            &[]
        }
    }

    fn set(&mut self, parameter: Parameter, value: f64) {
        if self.torque_task().started && parameter == Parameter::ForceReference {
            self.torque_task_mut().set_force_reference(value);
        }
    }

    fn get(&self, _: Parameter) -> f64 {
        self.torque_task().program.task.force.reference_n
    }

    fn phase(&self) -> Phase {
        self.torque_task().phase
    }

    fn activation(&self) -> u64 {
        self.torque_task().activation
    }

    fn clearance(&self) -> Clearance {
        self.torque_task().departure.clearance
    }

    fn task(&self) -> Option<&Task> {
        let task = self.torque_task();
        task.started.then_some(&task.program.task)
    }
}
