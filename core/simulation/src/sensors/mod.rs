//! Simulated sensors: force and torque at the wrist, a torque-controlled arm's own wrench estimate,
//! and cameras.

pub mod arm_force;
pub mod camera;
pub mod depth_camera;
pub mod depth_source;
pub mod fault;
pub mod force_torque;
pub(crate) mod load;
pub mod normal_camera;
pub(crate) mod records;
pub mod sample;
pub mod target_image;
pub(crate) mod watched;
pub(crate) mod wrench_channel;
pub mod wrench_estimate;
