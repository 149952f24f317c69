//! What the loop runs: the law for one kind of arm, with what it reads beside the arm's state.

use nalgebra::Vector3;
use tangent_control::{
    Clearance, CommandKind, ControlError, EstimatorName, Fault, Phase, SwitchRefusal,
};
use tangent_schemas::tangent::{ControlState, ShapingState};
use tangent_schemas::{JointArray, Text};

use crate::inputs::{EstimateReader, Packet};

/// Circumstances of a task start.
#[derive(Clone, Copy, Debug)]
pub struct Start {
    /// Whether a person says that the tool hangs free.
    pub said_clear: bool,
    /// Position of the tool, base axes, m.
    pub position: Vector3<f64>,
    /// Activation that the arm has latched out.
    pub latched: u64,
}

/// The part of a command that depends on the law.
#[derive(Clone, Debug)]
pub struct Motion {
    /// What the values are.
    pub kind: CommandKind,
    /// rad/s or Nm, base to flange.
    pub values: JointArray,
    /// Acceleration of the joints, rad/s²; 0 for torques.
    pub acceleration: f64,
}

/// The result of one cycle, for publication.
#[derive(Clone, Debug)]
pub struct Report {
    /// Without the times of the cycle and the fault's text.
    pub state: ControlState,
    /// Without header and cycle; `None` for a law that does not shape.
    pub shaping: Option<ShapingState>,
    /// Phase after this cycle.
    pub phase: Phase,
    /// The last fault since the task started.
    pub fault: Option<Fault>,
    /// Whether a tare is due.
    pub tare_requested: bool,
    /// Whether the tool may touch something.
    pub clearance: Clearance,
    /// Whether the zero in force was taken in contact.
    pub zero_withdrawn: bool,
    /// Estimator in use, number of changes, and cause of the last one; `None` without a task.
    pub estimator: Option<(EstimatorName, u32, Text)>,
}

/// A law with its inputs, called by the loop in each cycle. Nothing in it locks or allocates,
/// except where a program is replaced.
pub trait Runner: Send {
    /// A task made ready outside the loop.
    type Program: Send;
    /// What the law computes in one cycle.
    type Output;

    /// Phase after the last step.
    fn phase(&self) -> Phase;

    /// Number of task starts.
    fn activation(&self) -> u64;

    /// Whether the tool may touch something. Outlasts the tasks.
    fn clearance(&self) -> Clearance;

    /// Starts a program. What is left in `program` is dropped outside the loop. Called only while
    /// no task is active.
    ///
    /// # Errors
    /// The task may not start here. Nothing has changed then.
    fn start(
        &mut self,
        program: &mut Option<Self::Program>,
        start: &Start,
    ) -> Result<(), ControlError>;

    /// Stands still and keeps the force.
    ///
    /// # Errors
    /// No task can be paused now.
    fn pause(&mut self) -> Result<(), ControlError>;

    /// Continues after a pause.
    ///
    /// # Errors
    /// No task is paused.
    fn resume(&mut self) -> Result<(), ControlError>;

    /// Ends the task with a retraction.
    fn stop(&mut self);

    /// Whether the task has ended and the tool may still be where it touched.
    fn is_left_on_surface(&self) -> bool;

    /// Retracts a tool that is left on the surface.
    fn leave_surface(&mut self, latched: u64);

    /// Switches to another estimator; `force` waives the checks of validity and agreement.
    ///
    /// # Errors
    /// The estimator cannot be used now.
    fn select(&mut self, name: &EstimatorName, force: bool) -> Result<(), SwitchRefusal>;

    /// Also listens to this estimator; returns a reader that is not needed.
    fn listen(&mut self, reader: EstimateReader) -> Option<EstimateReader>;

    /// Takes the live parameters that were set since the last cycle.
    fn take_parameters(&mut self);

    /// While held, no other publisher of an input takes the place of the present one.
    fn hold(&mut self, held: bool);

    /// Runs the law for one packet; `None` if the arm's state is not usable. The arm then comes to
    /// rest by itself.
    fn step(&mut self, packet: &Packet<'_>) -> Option<Self::Output>;

    /// The command of this cycle.
    fn motion(&self, output: &Self::Output) -> Motion;

    /// The report of this cycle. Called after the command is published.
    fn report(&self, output: Self::Output) -> Report;
}
