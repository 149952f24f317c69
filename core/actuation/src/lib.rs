//! The gate before an arm: which commands are taken, and what of them goes to the robot.
//!
//! Each robot bridge asks three questions of a command, in this order, and nothing reaches the
//! robot on another way:
//!
//! 1. [`lease`]: does the source hold the arm? One source at a time does.
//! 2. [`admission`]: is the command new, in time, of a kind that moves this arm, and of a task that
//!    has not ended?
//! 3. [`velocity`] or [`torque`]: do the values keep every limit of the cell? What is let through
//!    does.
//!
//! All of it is pure: no clock, no socket, no allocation. A bridge calls it once per packet of the
//! robot.

mod account;
pub mod admission;
mod command;
pub mod lease;
mod refusal;
pub mod torque;
#[cfg(test)]
mod torque_tests;
pub mod velocity;
#[cfg(test)]
mod velocity_tests;

pub use account::CommandAccount;
pub use command::Command;
pub use refusal::Refusal;
