//! Common part of the loops of all robot bridges: connection, log lines, and `arm/state`.
//!
//! A bridge (the crate of one vendor) implements [`RobotLoop`] and passes it to [`run_robot_loop`],
//! which connects, lets the bridge serve the connection, and connects again. In each cycle the
//! bridge fills `arm/state` through an [`ArmStateWriter`], takes the commands with
//! [`crate::arm_commands::newest_command`], and reports whether the arm is ready through
//! [`Readiness`]. Protocol, session and the vendor's own limits stay in the bridge.
//!
//! ```
//! use tangent_runtime::robot_loop::{Backoff, PAUSE_MAX, PAUSE_MIN};
//!
//! let mut backoff = Backoff::default();
//! assert_eq!(backoff.pause(false), PAUSE_MIN);
//! assert_eq!(backoff.pause(false), 2 * PAUSE_MIN);
//! // A connection that brought the arm's state starts over.
//! assert_eq!(backoff.pause(true), PAUSE_MIN);
//! assert!((0..10).all(|_| backoff.pause(false) <= PAUSE_MAX));
//! ```

mod arm_state;
mod connection;
mod meters;
mod notes;
mod readiness;

pub use arm_state::{ArmReading, ArmStateWriter, ToolMotion};
pub use connection::{Backoff, Endpoint, PAUSE_MAX, PAUSE_MIN, RobotLoop, run_robot_loop};
pub use meters::{CycleFigures, LoopMeters};
pub use notes::{Note, Notes};
pub use readiness::{NotReady, Readiness};
