//! `tangent run` and `tangent record`.

use std::path::PathBuf;

use clap::Args;

/// Options of `tangent run`.
#[derive(Debug, Args)]
pub struct Run {
    /// Services to run: any of router, netft, rtde, franka, camera, estimator, controller,
    /// recorder, ros2, foxglove, ui, simulator.
    #[arg(required = true, value_parser = ["router", "netft", "rtde", "franka", "camera", "estimator", "controller", "recorder", "ros2", "foxglove", "ui", "simulator"])]
    pub services: Vec<String>,
    /// Estimators that the estimator service of this process runs, in place of the cell file's
    /// list; separated by commas.
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    pub estimators: Vec<String>,
}

/// Options of `tangent record`.
#[derive(Debug, Args)]
pub struct Record {
    /// Folder for the recording.
    #[arg(long, default_value = "recordings")]
    pub folder: PathBuf,
}
