//! `hybrid_dynamics`: inverse-dynamics motion control before contact, constrained hybrid
//! force/position control on it, with the constraint from an estimated object pose. Lippiello,
//! Siciliano, Villani, section IV, for torque-controlled arms.
//!
//! Called once per control period by the closed loop of `evaluate`, and by the service that holds
//! an arm's torque interface.

mod config;
mod controller;
mod estimate_follower;
mod interface;
mod joint_disturbance;
mod law;
mod reference;

pub use config::{
    EstimateUseConfig, ForceChannel, ForceGains, FrictionDoubtConfig, HybridDynamicsConfig,
    MotionGains, TouchConfig,
};
pub use controller::HybridDynamics;
pub use interface::{HybridInput, HybridOutput};
