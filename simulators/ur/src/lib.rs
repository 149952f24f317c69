//! A Universal Robots controller on sockets around a simulated arm: RTDE, dashboard, script and
//! robot-state ports of a CB3 or an e-Series.
//!
//! The service `tangent-simulator` starts a [`SimulatedUr`] around the plant of a scenario and puts
//! a Net F/T box beside it. Tests of other crates start one in their own process, on free ports,
//! around a [`plant::BareArm`]. The failure tables step [`controller::Controller`] and
//! [`rtde_server::Session`] without sockets and clock.
//!
//! The controller *interprets* the URScript that it is sent (`tangent-urscript`), so the program
//! that a real arm would run is the program that runs here.
//!
//! ```
//! use std::time::Duration;
//! use tangent_simulated_ur::plant::BareArm;
//! use tangent_simulated_ur::{ControllerConfig, Fault, Listeners, Place, SimulatedUr};
//! use tangent_simulation::ServoConfig;
//!
//! let arm = Box::new(BareArm::builtin("ur5", &ServoConfig::cb3())?);
//! let (config, listeners) = (ControllerConfig::default(), Listeners::default());
//! let robot = SimulatedUr::start(Place::default(), &config, "ur5", arm, listeners)?;
//! println!("RTDE at {}", robot.endpoints().rtde);
//! robot.fault(Fault::ProtectiveStop);
//! let stopped = |s: &tangent_simulated_ur::Snapshot| !s.summary.safety.allows_motion();
//! assert!(robot.wait_for(Duration::from_secs(20), stopped));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod config;
pub mod connection;
pub mod controller;
pub mod dashboard;
pub mod fault;
pub mod kinematics;
pub mod modes;
pub mod motion;
pub mod network;
pub mod own_sensor;
pub mod plant;
pub mod primary;
pub mod registers;
#[cfg(test)]
mod rig;
pub mod rtde_server;
pub mod script_ports;
mod simulated_ur;

pub use config::{ControllerConfig, Flavour};
pub use fault::Fault;
pub use own_sensor::{OwnReading, OwnSensor, OwnSensorConfig};
pub use simulated_ur::{
    Endpoints, FlangeListener, Listeners, OdometryListener, Place, SimulatedUr, Snapshot,
    StartError, TruthListener,
};
