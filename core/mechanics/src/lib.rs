//! Spatial algebra with frames as types, robot models from plain data, kinematics and dynamics.
//!
//! Everything above this crate (estimation, control, simulation, the services) takes its poses,
//! wrenches and arm models from here. Nothing here reads a clock, allocates in a step or does I/O.

pub mod arm;
pub mod damped_least_squares;
pub mod golden;
pub mod inverse_kinematics;
mod joint_friction;
pub mod linear_solve;
pub mod manipulability;
pub mod model;
pub mod names;
pub mod spatial;

pub use arm::{Arm, Limits, Payload};
pub use damped_least_squares::{DampedLeastSquares, DampedSolution};
pub use inverse_kinematics::{InverseKinematics, InverseKinematicsError, inverse_kinematics};
pub use joint_friction::JointFriction;
pub use manipulability::{manipulability, smallest_singular_value};
pub use model::{ModelData, ModelError};
pub use spatial::{
    Aligned, Base, Camera, Contact, Flange, Frame, Object, Pose, Sensor, Tool, Twist, World, Wrench,
};

/// Joint vector of an arm with `N` joints: rad, rad/s, rad/s² or Nm, base to flange.
pub type Joints<const N: usize> = nalgebra::SVector<f64, N>;
