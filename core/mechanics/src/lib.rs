//! Spatial algebra with frames as types, robot models from plain data, kinematics and dynamics.
//!
//! Everything above this crate (estimation, control, simulation, the services) takes its poses, wrenches and arm
//! models from here. Nothing here reads a clock, allocates in a step or does I/O.

pub mod spatial;

pub use spatial::{
    Aligned, Base, Camera, Contact, Flange, Frame, Pose, Sensor, Tool, Twist, World, Wrench,
};

/// Joint vector of an arm with `N` joints: rad, rad/s, rad/s² or Nm, base to flange.
pub type Joints<const N: usize> = nalgebra::SVector<f64, N>;
