//! The gate before an arm: decides which commands are accepted, and what is sent to the robot.
//!
//! Each robot bridge checks three things for each command, in this order, and sends nothing to the
//! robot in any other way:
//!
//! 1. [`lease`]: does the source hold the arm? One source at a time does.
//! 2. [`admission`]: is the command new, in time, of a kind that moves this arm, and of a task that
//!    has not ended?
//! 3. [`velocity`] or [`torque`]: do the values keep every limit of the cell? What is let through
//!    does.
//!
//! All of it is pure: no clock, no socket, no allocation. A bridge calls it once per packet of the
//! robot.
//!
//! ```
//! use nalgebra::{SMatrix, Vector3};
//! use tangent_actuation::lease::{Lease, LeaseDecision, Source};
//! use tangent_actuation::velocity::{Permission, Posture, VelocityGate, VelocityLimits};
//! use tangent_actuation::{Command, MotionLimits, Refusal};
//! use tangent_mechanics::Joints;
//! use tangent_schemas::CommandKind;
//!
//! let limits = VelocityLimits::<6> {
//!     motion: MotionLimits {
//!         speed_rad_per_s: Joints::repeat(1.0),
//!         position_lower_rad: Joints::repeat(-3.0),
//!         position_upper_rad: Joints::repeat(3.0),
//!         tool_speed_max_m_per_s: 0.25,
//!         tool_turn_rate_max_rad_per_s: 1.0,
//!         workspace_lower_m: Vector3::repeat(-1.0),
//!         workspace_upper_m: Vector3::repeat(1.0),
//!     },
//!     acceleration_rad_per_s2: Joints::repeat(4.0),
//!     response_s: 0.04,
//!     patience_cycles: 2,
//!     silence_latch_s: 0.1,
//! };
//! let mut gate = VelocityGate::new(limits, 0.008);
//! let mut lease = Lease::default();
//! let posture = Posture {
//!     q: Joints::<6>::zeros(),
//!     tool_m: Vector3::zeros(),
//!     tool_jacobian: SMatrix::zeros(),
//! };
//!
//! // 1. The source takes the lease. What it was doing before is not carried on.
//! let source = Source {
//!     publisher: [1; 16],
//!     ..Source::default()
//! };
//! assert_eq!(lease.admit(&source, 0.0, true), LeaseDecision::Taken);
//! gate.admission.change_hands(0);
//!
//! // 2. and 3. A command of a new activation is followed, at the acceleration of the cell.
//! let command = Command {
//!     cycle: 1,
//!     kind: CommandKind::JointVelocity.number(),
//!     values: &[0.5, 0.0, 0.0, 0.0, 0.0, 0.0],
//!     acceleration: 0.0,
//!     activation: 1,
//! };
//! let allowed = gate.step(1, Permission::Move, &posture, Some(&command));
//! assert!(allowed.streaming);
//! assert!((allowed.qd[0] - 4.0 * 0.008).abs() < 1e-12);
//!
//! // A command beyond a limit is refused, and the arm slows down.
//! let too_fast = Command {
//!     cycle: 2,
//!     values: &[9.0, 0.0, 0.0, 0.0, 0.0, 0.0],
//!     ..command
//! };
//! let allowed = gate.step(2, Permission::Move, &posture, Some(&too_fast));
//! assert_eq!(allowed.qd, Joints::<6>::zeros());
//! assert!(matches!(gate.admission.refusal(), Some(Refusal::Speed { joint: 0, .. })));
//! ```

mod account;
pub mod admission;
mod command;
pub mod lease;
mod motion_limits;
mod refusal;
pub mod torque;
#[cfg(test)]
mod torque_tests;
pub mod velocity;
#[cfg(test)]
mod velocity_tests;

pub use account::CommandAccount;
pub use command::Command;
pub use motion_limits::MotionLimits;
pub use refusal::Refusal;
