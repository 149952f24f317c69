//! A task with its law, as the torque loop runs it.

use tangent_control::{ControlError, EstimatorName, Fault, Phase, SwitchRefusal, Task};
use tangent_schemas::tangent::{ArmState, ControlState, ShapingState};
use tangent_schemas::{JointArray, Text};

use crate::inputs::WrenchNow;

/// One packet of the arm, with the wrench as it is then.
#[derive(Clone, Copy, Debug)]
pub struct TorqueInput<'a> {
    /// The packet.
    pub arm: &'a ArmState,
    /// Time of this cycle, s, on a clock that does not jump.
    pub time_s: f64,
    /// Whether a command would move the arm now.
    pub arm_ready: bool,
    /// The wrench at the tool.
    pub wrench: WrenchNow,
}

/// What the law answers.
#[derive(Clone, Debug)]
pub struct TorqueAnswer {
    /// Nm, base to flange.
    pub torque: JointArray,
    /// For `control/state`, all but what is the same for every law.
    pub state: ControlState,
    /// For `control/shaping`, all but the header; none for a law that does not shape.
    pub shaping: Option<ShapingState>,
    /// Phase after this cycle.
    pub phase: Phase,
    /// The last fault since the task started.
    pub fault: Option<Fault>,
    /// A tare is due.
    pub tare_requested: bool,
    /// Estimator in use, how often it changed, and why this one.
    pub estimator: (EstimatorName, u32, Text),
}

/// A task made ready: its law, what it reads, what it remembers. Made and dropped outside the loop; nothing in it allocates.
pub trait TorqueProgram: Send {
    /// What it was made from.
    fn task(&self) -> &Task;

    /// Answers one packet; none when the arm's state makes no sense.
    fn step(&mut self, input: &TorqueInput<'_>) -> Option<TorqueAnswer>;

    /// Stops the path, keeps the force; false goes on.
    ///
    /// # Errors
    /// Where there is no path.
    fn pause(&mut self, paused: bool) -> Result<(), ControlError>;

    /// Ends the task with a retraction.
    fn stop(&mut self);

    /// Takes another of the task's estimators; `force` waives its validity and agreement.
    ///
    /// # Errors
    /// Why not.
    fn select(&mut self, name: &EstimatorName, force: bool) -> Result<(), SwitchRefusal>;

    /// Pressing force from now on, N.
    fn set_force_reference(&mut self, force_n: f64);

    /// Phase after the last step.
    fn phase(&self) -> Phase;
}
