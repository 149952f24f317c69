//! `tangent up`.

use std::net::SocketAddr;
use std::path::PathBuf;

use clap::Args;

/// Options of `tangent up`.
#[derive(Debug, Args)]
pub struct Up {
    /// Task file, or a system's name: tugal, lippiello, karacan. Without it, the scenario's own
    /// task.
    pub task: Option<PathBuf>,
    /// Scenario that the simulator runs: a name from `scenarios/`, or a file. By default the
    /// system's own, or pipe_realistic.
    #[arg(long)]
    pub scenario: Option<String>,
    /// Seed of the simulator's noise.
    #[arg(long)]
    pub seed: Option<u64>,
    /// Override one key of the scenario, `KEY.PATH=VALUE`; may be repeated.
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
    /// Folder for the recording and the report.
    #[arg(long, default_value = "recordings")]
    pub folder: PathBuf,
    /// Number added to every port of the simulated robot and sensor, and to the router's port.
    #[arg(long, default_value_t = 0)]
    pub port_offset: u16,
    /// Show the cell to ROS 2 as well, as `[ros2]` of the cell file says: the router listens at its
    /// port for programs of ROS 2 (rmw_zenoh).
    #[arg(long)]
    pub ros2: bool,
    /// Serve live viewers (Foxglove, Lichtblick) at this address, by default foxglove.address of
    /// the cell file: 127.0.0.1:8765.
    #[arg(long, value_name = "ADDRESS", num_args = 0..=1)]
    pub foxglove: Option<Option<SocketAddr>>,
    /// Keep the system running after the task, until Ctrl-C.
    #[arg(long)]
    pub stay: bool,
}
