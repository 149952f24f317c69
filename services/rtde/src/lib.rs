//! Universal Robots bridge over RTDE: state out, guarded joint velocity in.

pub mod codec;
pub mod guard;
#[cfg(test)]
mod guard_tests;
pub mod program;
