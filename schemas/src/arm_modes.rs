//! Numbers in the mode fields of [`crate::tangent::ArmState`].
//!
//! All vendors use the numbers of RTDE, since all readers of `arm/state` use them. A bridge to
//! another robot translates its own modes into them.

/// `robot_mode` in which the arm is powered and its brakes are off.
pub const ROBOT_RUNNING: i32 = 7;

/// `safety_mode` without a restriction.
pub const SAFETY_NORMAL: i32 = 1;
/// `safety_mode` of a protective stop.
pub const PROTECTIVE_STOP: i32 = 3;
/// `safety_mode` of a safeguard stop.
pub const SAFEGUARD_STOP: i32 = 5;

/// `runtime_state` while no program runs.
pub const RUNTIME_STOPPED: u32 = 1;
/// `runtime_state` while a program runs.
pub const RUNTIME_PLAYING: u32 = 2;

/// `program_state` while no program of the bridge is on the robot.
pub const NO_PROGRAM: u8 = 255;
