//! `tangent task`.

use std::path::PathBuf;

use clap::Subcommand;

use super::seconds::waiting_time;

/// What to do with a task.
#[derive(Debug, Subcommand)]
pub enum TaskCommand {
    /// Start the task in a file.
    Start {
        /// Task file (TOML).
        file: PathBuf,
        /// Wait so many seconds for the cell to be there and ready, instead of failing at once.
        #[arg(long, value_name = "SECONDS", value_parser = waiting_time)]
        wait_s: Option<f64>,
        /// Stay until the task ends, and show it; Ctrl-C or SIGTERM retracts. Exit code 0 when the
        /// task is done.
        #[arg(long)]
        follow: bool,
        /// You have looked: the tool hangs free, whatever the last task left.
        #[arg(long)]
        clear: bool,
    },
    /// Stop sliding, keep the force.
    Pause,
    /// Go on after a pause.
    Resume,
    /// Retract and end the task.
    Stop,
    /// What the controller does now.
    Status,
}
