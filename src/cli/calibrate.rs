//! `tangent calibrate`.

use std::path::PathBuf;

use clap::{Args, Subcommand};

/// What to measure.
#[derive(Debug, Subcommand)]
pub enum CalibrateCommand {
    /// Identify mass and centre of mass of the payload on the sensor, from readings in several
    /// orientations of the arm.
    Payload(CalibratePayload),
}

/// Number of poses of a calibration, if not given.
pub const POSES: u16 = 9;

/// Options of `tangent calibrate payload`.
#[derive(Debug, Args)]
pub struct CalibratePayload {
    /// Number of poses, each taken when Enter is pressed: well spread, the last equal to the first.
    #[arg(long, default_value_t = POSES, value_parser = clap::value_parser!(u16).range(6..=200))]
    pub poses: u16,
    /// Take the poses from a recording instead: every place where the arm rests.
    #[arg(long, value_name = "FILE", conflicts_with = "poses")]
    pub from: Option<PathBuf>,
}
