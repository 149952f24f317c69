//! An operator's client of a running cell: a session on its bus, requests to its services, and the
//! state that they report.
//!
//! Every verb of the `tangent` command that talks to a live cell starts with [`session::join`]. It
//! opens the bus as an operator, without real-time priority. [`session::ask`] sends one request
//! and returns the answer. [`status`] subscribes to the reports of all services, and [`health`]
//! decides whether given services are healthy. [`topics`] shows what is published.
//!
//! ```no_run
//! # fn main() -> Result<(), tangent_client::ClientError> {
//! use tangent_client::{session, status};
//!
//! let cell = tangent_runtime::CellConfig::default_cell();
//! let bus = session::join(&cell)?;
//! let answer = session::ask(&bus, "control/task", "status", "")?;
//! println!("{}", answer.message);
//! for service in status::of_cell(&cell, &bus)?.services {
//!     println!("{} is {}", service.name, service.state);
//! }
//! # Ok(())
//! # }
//! ```

mod error;
pub mod health;
pub mod session;
pub mod status;
pub mod topics;

pub use error::ClientError;
