//! `tangent scan`.

use std::path::PathBuf;

use clap::Args;

use super::seconds::measuring_time;

/// Options of `tangent scan`.
#[derive(Debug, Args)]
pub struct Scan {
    /// Name of the scan.
    #[arg(value_name = "NAME", default_value = "scan")]
    pub name: String,
    /// Take the images of a recording (.mcap) in place of the running cell.
    #[arg(long, value_name = "FILE", conflicts_with = "duration_s")]
    pub recording: Option<PathBuf>,
    /// End after this time, s: 0.1 to 3600; by default at Enter or Ctrl-C.
    #[arg(long, value_name = "S", value_parser = measuring_time)]
    pub duration_s: Option<f64>,
    /// File to write (.ply); by default NAME.ply.
    #[arg(long, short, value_name = "FILE")]
    pub output: Option<PathBuf>,
    /// Replace the file if it exists.
    #[arg(long)]
    pub force: bool,
}
