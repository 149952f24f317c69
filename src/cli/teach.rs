//! `tangent teach`.

use std::ops::RangeInclusive;
use std::path::PathBuf;

use clap::Args;
use tangent_teach::{CLEARANCE_M, SPACING_M, TOLERANCE_M};

/// Options of `tangent teach`.
#[derive(Debug, Args)]
pub struct Teach {
    /// Name of the task.
    #[arg(value_name = "NAME", value_parser = name)]
    pub name: String,
    /// Through the points, in their order (the default).
    #[arg(long, group = "shape")]
    pub points: bool,
    /// Along an outline: the path returns to its first point.
    #[arg(long, group = "shape")]
    pub polygon: bool,
    /// Fill the region inside the outline with rows, this far apart, m: 0.0005 to 0.5.
    #[arg(long, value_name = "M", requires = "polygon", value_parser = spacing)]
    pub spacing_m: Option<f64>,
    /// Along a stroke: Enter begins and ends one too.
    #[arg(long, group = "shape")]
    pub stroke: bool,
    /// Pressing force, N.
    #[arg(long, value_name = "N", default_value_t = 5.0)]
    pub force_n: f64,
    /// Speed along the path, m/s.
    #[arg(long, value_name = "M_PER_S", default_value_t = 0.02)]
    pub speed: f64,
    /// Height of the start pose above the first point, m: 0.005 to 0.3.
    #[arg(long, value_name = "M", default_value_t = 0.03, value_parser = clearance)]
    pub clearance_m: f64,
    /// Largest distance of a stroke from the path that is made of it, m: 0.0002 to 0.02.
    #[arg(long, value_name = "M", default_value_t = 0.002, value_parser = tolerance)]
    pub tolerance_m: f64,
    /// File to write; by default NAME.toml.
    #[arg(long, short, value_name = "FILE")]
    pub output: Option<PathBuf>,
    /// Replace the file if it exists.
    #[arg(long)]
    pub force: bool,
    /// Leave the arm as it is: it is guided with its own buttons, or moved from the pendant.
    #[arg(long)]
    pub no_freedrive: bool,
}

fn name(text: &str) -> Result<String, String> {
    if text.is_empty() || text.len() > 64 {
        return Err("a task's name has 1 to 64 bytes".to_owned());
    }
    Ok(text.to_owned())
}

fn clearance(text: &str) -> Result<f64, String> {
    within(text, CLEARANCE_M)
}

fn spacing(text: &str) -> Result<f64, String> {
    within(text, SPACING_M)
}

fn tolerance(text: &str) -> Result<f64, String> {
    within(text, TOLERANCE_M)
}

fn within(text: &str, allowed: RangeInclusive<f64>) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if allowed.contains(&value) => Ok(value),
        _ => Err(format!(
            "allowed is {} to {}",
            allowed.start(),
            allowed.end()
        )),
    }
}
