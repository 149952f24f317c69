//! `tangent estimator`.

use std::path::PathBuf;

use clap::{Args, Subcommand};

use super::seconds::measuring_time;

/// What to do with estimators.
#[derive(Debug, Subcommand)]
pub enum EstimatorCommand {
    /// Who publishes normals, where, how old, how far from the one in use.
    List,
    /// All estimators side by side: live, or from a recording.
    Compare(Compare),
    /// Use another estimator from now on.
    Use {
        /// Its name, as in `estimate/NAME/normal`.
        name: String,
        /// Switch although the newcomer is invalid or disagrees; recorded. One that is silent is
        /// refused all the same.
        #[arg(long)]
        force: bool,
    },
}

/// Options of `tangent estimator compare`.
#[derive(Debug, Args)]
pub struct Compare {
    /// Recording (`.mcap`) to read; the live cell if none is named.
    pub file: Option<PathBuf>,
    /// Listen to the live cell for so long.
    #[arg(long, default_value_t = 5.0, value_parser = measuring_time)]
    pub seconds: f64,
}
