//! A Franka arm on sockets: the Franka Control Interface, version 5, around a simulated arm.
//!
//! [`SimulatedFranka`] is the running thing, for the service ([`run`]) and for tests; [`FciRobot`]
//! inside it is the robot's own controller without sockets and clock; [`TorquePlant`] is what it
//! moves.

mod bench;
mod config;
mod depth_eye;
mod fault;
mod plant;
mod protection;
mod robot;
#[cfg(test)]
mod robot_tests;
mod server;
mod service;
mod settings;
mod tactile;

pub use bench::{BenchPlant, Plane, PlantConfig};
pub use config::FciConfig;
pub use depth_eye::{DepthEye, Look};
pub use fault::{BadFault, FciFault};
pub use plant::{ArmReading, TorquePlant};
pub use robot::FciRobot;
pub use server::{FciStartError, SimulatedFranka, Snapshot};
pub use service::{FAULT_KEY, FciServiceError, run, run_with};
pub use tactile::TactileArm;
