//! A robot cell on sockets: UR controller and Net F/T box around the simulated plant, or ([`fci`])
//! a Franka arm.
//!
//! [`service::run`] is the service; tests of other crates start a [`SimulatedCell`] in their own
//! process, on free ports.

pub mod arm_plant;
#[cfg(test)]
mod bridge_program_tests;
pub mod cell;
pub mod config;
pub mod connection;
pub mod controller;
pub mod dashboard;
pub mod fault;
pub mod fci;
#[cfg(test)]
mod hostile_input_tests;
pub mod kinematics;
pub mod modes;
pub mod motion;
pub mod netb;
pub mod primary;
pub mod registers;
#[cfg(test)]
mod rig;
pub mod rtde_server;
pub mod script_ports;
pub mod service;
pub mod torque_cell;
pub mod urscript;

pub use cell::{Endpoints, SimulatedCell, Snapshot, StartError};
pub use config::{Config, ControllerConfig, Flavour, Ports};
pub use fault::Fault;
pub use service::run;
pub use torque_cell::{TorqueCellConfig, TorqueCellError, run_torque_cell};
