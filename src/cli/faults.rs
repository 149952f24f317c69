//! `tangent faults`.

use std::path::PathBuf;

use clap::Args;

/// Options of `tangent faults`.
#[derive(Debug, Args)]
pub struct Faults {
    /// Which ones; all if none is named.
    pub faults: Vec<String>,
    /// Only name them.
    #[arg(long)]
    pub list: bool,
    /// Allowed beyond every bound, ms: what a machine that is busy with other things may take.
    #[arg(long, default_value_t = 30.0)]
    pub allow_ms: f64,
    /// Keep the logs and recordings here.
    #[arg(long)]
    pub folder: Option<PathBuf>,
    /// Added to every port of the private cell.
    #[arg(long, default_value_t = 4000)]
    pub port_offset: u16,
    /// Seed of the simulator's noise.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
}
