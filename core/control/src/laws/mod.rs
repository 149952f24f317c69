//! The control laws.

pub mod hybrid_admittance;
pub mod hybrid_dynamics;
pub(crate) mod stacked;
pub(crate) mod torque_task;
pub mod unified_force_impedance;
