//! How a tool leaves contact, and what is known about whether it is in contact.

pub mod clearance;
pub(crate) mod departure;
pub mod tare_permission;
