//! A task with its law, as the torque loop runs it.

use std::time::Duration;

use nalgebra::Vector3;
use tangent_control::{Clearance, ControlError, EstimatorName, Phase, SwitchRefusal, Task};
use tangent_schemas::JointArray;
use tangent_schemas::tangent::ArmState;

use crate::inputs::WrenchNow;
use crate::runner::Report;

/// One packet of the arm, with the wrench as it is then.
#[derive(Clone, Copy, Debug)]
pub struct TorqueInput<'a> {
    /// The packet.
    pub arm: &'a ArmState,
    /// Time since the one before, s, by the robot's clock.
    pub dt_s: f64,
    /// Time since it came.
    pub since_packet: Duration,
    /// Time of this cycle, s, on a clock that does not jump.
    pub time_s: f64,
    /// Whether a command would move the arm now.
    pub arm_ready: bool,
    /// The wrench at the tool.
    pub wrench: WrenchNow,
}

impl TorqueInput<'_> {
    /// Way that the tool slid since the packet before, m, where it is in `phase`.
    pub fn slid_m(&self, phase: Phase) -> f64 {
        if phase != Phase::Slide {
            return 0.0;
        }
        let v = &self.arm.tool_twist.linear;
        (v.x * v.x + v.y * v.y + v.z * v.z).sqrt() * self.dt_s
    }
}

/// What the law answers.
#[derive(Clone, Debug)]
pub struct TorqueAnswer {
    /// Nm, base to flange.
    pub torque: JointArray,
    /// Without what the loop knows of the task.
    pub report: Report,
}

/// A task made ready: its law, what it reads, what it remembers. Made and dropped outside the loop;
/// nothing in it allocates.
pub trait TorqueProgram: Send {
    /// What it was made from.
    fn task(&self) -> &Task;

    /// Whether it may start with the tool at `position` (base axes, m) after what is known of it.
    ///
    /// # Errors
    /// Why not.
    fn check_start(
        &self,
        clearance: &Clearance,
        position: &Vector3<f64>,
    ) -> Result<(), ControlError>;

    /// Begins with what is known of the tool.
    fn begin(&mut self, clearance: Clearance);

    /// Answers one packet; none when the arm's state makes no sense.
    fn step(&mut self, input: &TorqueInput<'_>) -> Option<TorqueAnswer>;

    /// Stands still, keeps the force of what presses; false goes on.
    ///
    /// # Errors
    /// Where there is no path.
    fn pause(&mut self, paused: bool) -> Result<(), ControlError>;

    /// The task is paused.
    fn is_paused(&self) -> bool;

    /// Ends the task with a retraction.
    fn stop(&mut self);

    /// The task has ended, and the tool may still be where it touched.
    fn is_left_on_surface(&self) -> bool;

    /// Retracts a tool that is left on the surface.
    fn leave_surface(&mut self);

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
