//! The simulator service: composes a robot cell out of the simulated devices in `simulators/`, and
//! puts its ground truth and its faults on the bus.
//!
//! `tangent run simulator` and `tangent up` call one of these functions: [`run`] for a UR with a
//! Net F/T box around one plant, [`run_franka`] or [`run_franka_with`] for a Franka, and
//! [`run_torque_cell`] for an arm with a torque interface and a Net F/T box. Tests of other crates
//! start a [`SimulatedCell`] in their own process, on free ports.
//!
//! ```
//! use tangent_simulated_device::Ports;
//! use tangent_simulator::{Config, SimulatedCell};
//!
//! let mut config: Config = toml::from_str(
//!     r#"
//!     [plant]
//!     robot = "ur5"
//!     [plant.surface]
//!     shape = "plane"
//!     position_m = [0.0, 0.0, 0.1]
//!     [plant.start]
//!     near_m = [0.4, -0.05, 0.1]
//!     seed_rad = [3.14, -1.57, 1.57, -1.57, -1.57, 0.0]
//!     "#,
//! )?;
//! config.ports = Ports::Ephemeral;
//! let cell = SimulatedCell::start(&config)?;
//! println!("RTDE at {}", cell.robot().endpoints().rtde);
//! println!("RDT at {}", cell.sensor_box().rdt_address());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod cell;
mod config;
mod franka;
mod service;
mod torque_cell;

pub use cell::{CellError, SimulatedCell};
pub use config::Config;
pub use franka::{FrankaError, run_franka, run_franka_with};
pub use service::{Error, run};
pub use torque_cell::{TorqueCellConfig, TorqueCellError, run_torque_cell};
