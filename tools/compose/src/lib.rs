//! Puts the parts of a cell into one process: each service in a thread of its own, all on one bus.
//!
//! Services know each other only through topics, so any of them can share a process.
//! [`service`] starts one by its name with the settings that it takes from the cell file;
//! [`service`] starts a service by its name with its settings from the cell file; [`simulators`]
//! start simulated devices in place of real ones. Both return a [`Running`], which
//! `tangent faults` are composed with this crate.
//!
//! ```no_run
//! # fn main() -> Result<(), tangent_compose::ComposeError> {
//! use tangent_compose::{RecorderExtra, service};
//! use tangent_runtime::{Bus, CellConfig, Role, Stop};
//!
//! let (cell, stop) = (CellConfig::default_cell(), Stop::new());
//! let bus = Bus::open_until(&cell, Role::Router, None, &stop)?;
//! let recorder = service("recorder", &cell, &bus, &stop, &RecorderExtra::default())?;
//! recorder.end()?;
//! # Ok(())
//! # }
//! ```
//!
//! One rule applies to the order: if the controller starts before the arm's bridge, it answers each
//! robot packet within the bridge's own publish call.

mod error;
mod model;
mod running;
mod services;
pub mod simulators;

pub use error::{ComposeError, with_causes};
pub use model::{model, model_file};
pub use running::{Ended, Running};
pub use services::{RecorderExtra, router, service};
