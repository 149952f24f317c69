//! `tangent robot`.

use clap::Subcommand;

use super::seconds::waiting_time;

/// What to do with the robot.
#[derive(Clone, Copy, Debug, PartialEq, Subcommand)]
pub enum RobotCommand {
    /// Leave a protective stop (UR) or a reflex (Franka). Look for the cause first.
    Unlock {
        /// Wait so many seconds for the arm to be ready after it.
        #[arg(long, value_name = "SECONDS", default_value_t = 20.0, value_parser = waiting_time)]
        wait_s: f64,
    },
    /// Send the bridge's program to the robot again, and leave a latched stop.
    Reset {
        /// Wait so many seconds for the arm to be ready after it.
        #[arg(long, value_name = "SECONDS", default_value_t = 20.0, value_parser = waiting_time)]
        wait_s: f64,
    },
    /// Switch the arm's power on and release the brakes.
    PowerOn {
        /// Wait so many seconds for the arm to be ready after it.
        #[arg(long, value_name = "SECONDS", default_value_t = 40.0, value_parser = waiting_time)]
        wait_s: f64,
    },
    /// Switch the arm's power off; the brakes close. Refused while a task runs.
    PowerOff,
    /// What the robot says of itself: mode, safety, program, and why it is not ready.
    Status,
}
