//! Wrench conditioning: from what a force/torque sensor reads to what the environment does to the tool.
//!
//! Called by the `netft` service for every record, and by the closed loop of `evaluate`.

mod validity;

pub use validity::Validity;
