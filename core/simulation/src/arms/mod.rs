//! Simulated arms: a velocity servo, an arm under torques, and the mobile platform below an arm.

pub mod loaded_arm;
pub mod measurement;
pub(crate) mod own_hold;
pub mod platform;
pub mod servo;
pub mod torque_arm;
