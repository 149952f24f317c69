//! A Franka Emika Robot ("Panda") on sockets: the Franka Control Interface, version 5, around a
//! simulated arm.
//!
//! The service `tangent-simulator` starts a [`SimulatedFranka`] around the plant of a scenario.
//! Tests of other crates start one on free ports, with a tool in front of a plane ([`BenchPlant`]).
//! The failure table steps [`FciRobot`], the robot's own controller without sockets and clock.
//! [`TorquePlant`] is the interface of the arm that it moves.
//!
//! ```
//! use std::time::Duration;
//! use tangent_simulated_device::Ports;
//! use tangent_simulated_franka::{FciConfig, FciFault, SimulatedFranka};
//!
//! let config = FciConfig { ports: Ports::Ephemeral, ..FciConfig::default() };
//! let robot = SimulatedFranka::start(&config)?;
//! println!("FCI at {}", robot.address());
//! robot.fault(FciFault::UserStop(true));
//! let stopped = tangent_franka::fci::RobotMode::UserStopped;
//! assert!(robot.wait_for(Duration::from_secs(20), |s| s.state.mode() == stopped));
//! # Ok::<(), tangent_simulated_franka::FciStartError>(())
//! ```

mod bench;
mod config;
mod fault;
mod plant;
mod protection;
mod robot;
mod server;
mod settings;
mod simulated_franka;
mod tactile;

pub use bench::{BenchPlant, Plane, PlantConfig};
pub use config::FciConfig;
pub use fault::{BadFault, FciFault};
pub use plant::{ArmReading, TorquePlant};
pub use robot::FciRobot;
pub use server::{FciTruthListener, Snapshot};
pub use simulated_franka::{FciStartError, SimulatedFranka};
pub use tactile::TactileArm;
