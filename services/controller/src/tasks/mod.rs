//! Preparation of tasks for the loop, by law: checked, timed, with the readers of their estimators.

pub mod hybrid_admittance;
pub mod hybrid_dynamics;
pub mod start_check;
pub mod torque;
pub mod unified_force_impedance;
