//! `tangent doctor`.

use clap::Args;

/// Options of `tangent doctor`.
#[derive(Debug, Args)]
pub struct Doctor {
    /// Look at this machine only, not at the cell's robot and sensor and the way to them.
    #[arg(long)]
    pub machine: bool,
}
