//! Universal Robots bridge over RTDE: state out, guarded joint velocity in.

pub mod bridge;
#[cfg(test)]
mod bridge_tests;
pub mod codec;
pub mod dashboard;
pub mod guard;
#[cfg(test)]
mod guard_tests;
pub mod link;
pub mod primary;
pub mod program;
pub mod sample;
pub mod status;
pub mod supervisor;
