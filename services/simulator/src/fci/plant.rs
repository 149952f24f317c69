//! What the robot's controller moves.

use tangent_mechanics::{Flange, Joints, Pose, Tool};
use tangent_simulation::Truth;

/// What the robot's sensors say.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArmReading {
    /// rad.
    pub q: Joints<7>,
    /// rad/s.
    pub qd: Joints<7>,
    /// What the environment does to the joints, as the robot estimates it, Nm.
    pub external: Joints<7>,
}

/// An arm under torques, and what it touches.
pub trait TorquePlant: Send {
    /// One period (1 ms) under motor torques, Nm; what carries the arm's weight is among them.
    fn step(&mut self, torque: &Joints<7>);
    /// What the sensors say now.
    fn reading(&self) -> ArmReading;
    /// The truth about the contact, if there is a surface.
    fn truth(&self) -> Option<Truth>;
    /// Where the tool really sits.
    fn flange_from_tool(&self) -> Pose<Flange, Tool>;
    /// Something pushes the tool from now on: force at the tool's origin, base axes, N. Zero ends
    /// it.
    fn push(&mut self, force_n: [f64; 3]);
}
