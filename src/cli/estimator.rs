//! `tangent estimator`.

use std::path::PathBuf;

use clap::{Args, Subcommand};

use super::seconds::measuring_time;

/// What to do with estimators.
#[derive(Debug, Subcommand)]
pub enum EstimatorCommand {
    /// List the estimators that publish normals, with host, age, and angle to the normal in use.
    List,
    /// Compare all estimators, live or from a recording.
    Compare(Compare),
    /// Switch to another estimator.
    Use {
        /// Name of the estimator, as in `estimate/NAME/normal`.
        name: String,
        /// Switch even if the estimate is invalid or disagrees with the one in use; this is
        /// recorded. A silent estimator is refused all the same.
        #[arg(long)]
        force: bool,
    },
}

/// Options of `tangent estimator compare`.
#[derive(Debug, Args)]
pub struct Compare {
    /// Recording (`.mcap`) to read; without it, the live cell.
    pub file: Option<PathBuf>,
    /// Seconds for which to observe the live cell.
    #[arg(long, default_value_t = 5.0, value_parser = measuring_time)]
    pub seconds: f64,
}
