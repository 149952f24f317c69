//! `tangent faults`.

use std::path::PathBuf;

use clap::Args;

/// Options of `tangent faults`.
#[derive(Debug, Args)]
pub struct Faults {
    /// Faults to provoke; all if none is named.
    pub faults: Vec<String>,
    /// List the faults, and provoke none.
    #[arg(long)]
    pub list: bool,
    /// Delay that a busy machine may add to every bound, ms.
    #[arg(long, default_value_t = 30.0)]
    pub allow_ms: f64,
    /// Folder in which the logs and recordings are kept.
    #[arg(long)]
    pub folder: Option<PathBuf>,
    /// Number added to every port of the private cell.
    #[arg(long, default_value_t = 4000)]
    pub port_offset: u16,
    /// Seed of the simulator's noise.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
}
