//! How a tool leaves contact, and what is known about whether it is in contact.

pub mod clearance;
pub mod config;
pub(crate) mod departure;
pub(crate) mod leave_watch;
mod moves_in;
pub(crate) mod retreat;
pub mod tare_permission;
pub(crate) mod yielding;
