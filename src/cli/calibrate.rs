//! `tangent calibrate`.

use std::path::PathBuf;

use clap::{Args, Subcommand};

/// What to measure.
#[derive(Debug, Subcommand)]
pub enum CalibrateCommand {
    /// Mass and centre of mass of what hangs on the sensor, from readings in several orientations
    /// of the arm.
    Payload(CalibratePayload),
}

/// Options of `tangent calibrate payload`.
#[derive(Debug, Args)]
pub struct CalibratePayload {
    /// Poses to take, each at an Enter: well spread, the first once more at the end.
    #[arg(long, default_value_t = 9, value_parser = clap::value_parser!(u16).range(6..=200))]
    pub poses: u16,
    /// Take every stand of the arm from a recording instead.
    #[arg(long, value_name = "FILE", conflicts_with = "poses")]
    pub from: Option<PathBuf>,
}
