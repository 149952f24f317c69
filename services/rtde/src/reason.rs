//! Why the arm does not follow commands.

use std::fmt;

use tangent_runtime::health::State;
use tangent_runtime::robot_loop::NotReady;

use crate::program::cause_text;
use crate::status::{robot_mode_text, runtime_state_text, safety_mode_text};

/// Why the arm does not follow commands now.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Reason {
    /// No state from the controller.
    NoLink,
    /// Value of `robot_mode` in which the robot does not run.
    RobotMode(i32),
    /// Value of `safety_mode` in which the robot must not move.
    Safety(i32),
    /// Value of `runtime_state` although the bridge's program should run.
    Runtime(u32),
    /// A program that is not the bridge's runs.
    OtherProgram,
    /// The bridge's program ran, and another has replaced it.
    Replaced,
    /// The bridge's program was sent and is not ready yet.
    Starting,
    /// The bridge's program was sent and did not become ready.
    NotStarting {
        /// Number of attempts.
        attempts: u32,
    },
    /// The bridge's program is present, but its loop does not advance.
    Hung,
    /// The bridge's program decelerates or is latched.
    Stopped {
        /// Cause, as for [`cause_text`].
        cause: i32,
    },
    /// The bridge's program has ended.
    Ended {
        /// Cause, as for [`cause_text`].
        cause: i32,
    },
    /// The robot needs `rtde/reset` before it moves again.
    ResetNeeded {
        /// Cause, as for [`cause_text`].
        cause: i32,
    },
    /// The robot's speed scaling is below the cell's minimum.
    Scaling {
        /// Product of limiter and speed slider.
        scaling: f64,
    },
    /// The robot's clock skipped several cycles.
    Gap {
        /// Number of cycles skipped.
        lost: u64,
    },
    /// The arm is not the cell's model: anything computed from that model would be wrong.
    WrongModel,
    /// A hand guides the arm.
    Guided,
    /// A stop of `rtde` was requested.
    StopAsked,
    /// `rtde` is shutting down.
    ShuttingDown,
}

impl NotReady for Reason {
    fn service_state(&self) -> State {
        match self {
            Self::Starting | Self::NoLink => State::Starting,
            Self::ShuttingDown => State::Stopping,
            _ => State::Degraded,
        }
    }
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoLink => write!(f, "no connection to the controller"),
            Self::RobotMode(mode) => write!(f, "robot is {}", robot_mode_text(*mode)),
            Self::Safety(mode) => write!(f, "{}", safety_mode_text(*mode)),
            Self::Runtime(state) => write!(f, "robot program is {}", runtime_state_text(*state)),
            Self::OtherProgram => write!(
                f,
                "another program runs on the robot: stop it there, or replace it with `tangent robot reset`"
            ),
            Self::Replaced => write!(
                f,
                "the bridge's program was replaced by another one: stop that program, or replace it with `tangent robot reset`"
            ),
            Self::Starting => write!(f, "robot program is starting"),
            Self::NotStarting { attempts } => write!(
                f,
                "robot program did not start ({attempts} tries): remote control mode on? message on the pendant?"
            ),
            Self::Hung => write!(f, "robot program hangs"),
            Self::Stopped { cause } => write!(f, "robot program stopped: {}", cause_text(*cause)),
            Self::Ended { cause } => write!(f, "robot program ended: {}", cause_text(*cause)),
            Self::ResetNeeded { cause } => {
                write!(
                    f,
                    "{}; find the cause, then run `tangent robot reset`",
                    cause_text(*cause)
                )
            }
            Self::Scaling { scaling } => write!(
                f,
                "robot runs at {:.0} % speed, less than the cell allows: speed slider or a limit",
                scaling * 100.0
            ),
            Self::Gap { lost } => write!(f, "{lost} robot packets in a row were lost"),
            Self::WrongModel => write!(
                f,
                "the robot is not the model that the cell file names: correct [robot] model or address"
            ),
            Self::Guided => write!(
                f,
                "a hand guides the arm (freedrive): end that before a task is started"
            ),
            Self::StopAsked => write!(f, "stop requested"),
            Self::ShuttingDown => write!(f, "rtde ends"),
        }
    }
}
