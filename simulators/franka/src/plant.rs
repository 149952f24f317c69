//! The arm that the robot's controller moves.

use tangent_mechanics::{Flange, Joints, Payload, Pose, Tool};
use tangent_simulation::Truth;

/// Measurements of the robot's sensors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArmReading {
    /// Joint positions, rad.
    pub q: Joints<7>,
    /// Joint speeds, rad/s.
    pub qd: Joints<7>,
    /// External joint torques as the robot estimates them, Nm.
    pub external: Joints<7>,
}

/// An arm under torques, with its environment.
pub trait TorquePlant: Send {
    /// Steps one period (1 ms) under motor torques, Nm, which include gravity compensation.
    fn step(&mut self, torque: &Joints<7>);
    /// Present measurements of the sensors.
    fn reading(&self) -> ArmReading;
    /// The truth about the contact, if there is a surface.
    fn truth(&self) -> Option<Truth>;
    /// The tool on the flange as it was declared when the robot was installed. The robot
    /// compensates its weight until a client sets another load.
    fn declared_load(&self) -> Payload;
    /// Inertia of the motors as the joints carry it, kg m².
    fn motor_inertia(&self) -> Joints<7>;
    /// True pose of the tool on the flange.
    fn flange_from_tool(&self) -> Pose<Flange, Tool>;
    /// Applies an external force to the tool from now on: force at the tool's origin, base axes, N.
    /// Zero ends it.
    fn push(&mut self, force_n: [f64; 3]);
}
