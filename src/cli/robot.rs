//! `tangent robot`.

use clap::Subcommand;

use super::seconds::waiting_time;

/// What to do with the robot.
#[derive(Clone, Copy, Debug, PartialEq, Subcommand)]
pub enum RobotCommand {
    /// Leave a protective stop (UR) or a reflex (Franka). Look for the cause first.
    Unlock {
        /// Seconds to wait until the arm is ready.
        #[arg(long, value_name = "SECONDS", default_value_t = 20.0, value_parser = waiting_time)]
        wait_s: f64,
    },
    /// Send the bridge's program to the robot again, and leave a latched stop.
    Reset {
        /// Seconds to wait until the arm is ready.
        #[arg(long, value_name = "SECONDS", default_value_t = 20.0, value_parser = waiting_time)]
        wait_s: f64,
    },
    /// Switch the arm's power on and release the brakes.
    PowerOn {
        /// Seconds to wait until the arm is ready.
        #[arg(long, value_name = "SECONDS", default_value_t = 40.0, value_parser = waiting_time)]
        wait_s: f64,
    },
    /// Switch the arm's power off; the brakes close. Refused while a task runs.
    PowerOff,
    /// Show the robot's mode, safety state and program, and why it is not ready.
    Status,
}
