//! `hybrid_admittance`: force along the surface normal, motion in the tangent plane, for arms that
//! take joint velocities. Tugal et al.
//!
//! Called once per cycle of the robot by the closed loop of `evaluate`, and by the service that
//! commands the arm.

mod acting_point;
pub mod admittance;
mod as_law;
mod config;
mod controller;
mod decisions;
mod delay_in_use;
pub mod force_integral;
pub mod force_law;
mod hops;
mod interface;
pub mod joint_velocity;
mod joint_way;
mod landing;
mod leaving;
mod ledge;
mod lift;
pub mod loop_delay;
mod losses;
mod motion;
mod moving_base;
mod pace;
mod percept;
mod recoil;
mod ringing;
mod rounds;
mod route;
mod run;
mod senses;
mod side_load;
pub mod stiffness;
pub mod surface;
pub(crate) mod surface_chart;
mod touchdown;
mod tracking;
mod travel;
mod urgent;
mod zero_doubt;

pub use config::{
    AlignmentConfig, ContactConfig, ControllerConfig, ForceConfig, NormalConfig, PathConfig,
    TorqueConfig,
};
pub use controller::Controller;
pub use interface::{ControlInput, ControlOutput};
