//! `tangent doctor`.

use clap::Args;

/// Options of `tangent doctor`.
#[derive(Debug, Args)]
pub struct Doctor {
    /// Check this machine only, not the cell's robot and sensor or the network to them.
    #[arg(long)]
    pub machine: bool,
}
