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
        /// Seconds to wait until the cell runs and is ready, instead of failing at once.
        #[arg(long, value_name = "SECONDS", value_parser = waiting_time)]
        wait_s: Option<f64>,
        /// Wait for the end of the task and show its progress; Ctrl-C or SIGTERM retracts. Exit
        /// code 0 if the task is completed.
        #[arg(long)]
        follow: bool,
        /// State that you have checked that the tool hangs free. Overrides what the last task left.
        #[arg(long)]
        clear: bool,
    },
    /// Stop sliding, and keep the force.
    Pause,
    /// Continue after a pause.
    Resume,
    /// Retract and end the task.
    Stop,
    /// Show what the controller does now.
    Status,
}
