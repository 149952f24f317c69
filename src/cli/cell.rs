//! `tangent cell`.

use std::path::PathBuf;

use anyhow::{Context, Result, ensure};
use clap::{Args, Subcommand, ValueEnum};

/// What to do with cell files.
#[derive(Debug, Subcommand)]
pub enum CellCommand {
    /// Write the file of a new cell: asks for what is not given as an option, checks the answers,
    /// and marks what has to be measured.
    New(NewCell),
}

/// Options of `tangent cell new`.
#[derive(Debug, Args)]
pub struct NewCell {
    /// File to write; by default `NAME.toml`.
    pub file: Option<PathBuf>,
    /// Name of the cell: letters, digits, `_` and `-`.
    #[arg(long)]
    pub name: Option<String>,
    /// Model of the arm, as in `tangent model list`.
    #[arg(long)]
    pub model: Option<String>,
    /// Host name or IP address of the robot's controller.
    #[arg(long, value_name = "HOST")]
    pub robot_address: Option<String>,
    /// The force/torque sensor.
    #[arg(long, value_enum)]
    pub sensor: Option<NewSensor>,
    /// Host name or IP address of the Net F/T box.
    #[arg(long, value_name = "HOST")]
    pub sensor_address: Option<String>,
    /// Topic of a sensor that another program publishes, relative to the cell.
    #[arg(long, value_name = "TOPIC")]
    pub sensor_topic: Option<String>,
    /// Messages per second on that topic.
    #[arg(long, value_name = "HZ")]
    pub sensor_rate_hz: Option<f64>,
    /// Force and torque beyond which the sensor saturates, N and Nm, from its data sheet. Not for a
    /// Net F/T box.
    #[arg(long, value_name = "N,NM", value_parser = ranges)]
    pub sensor_range: Option<(f64, f64)>,
    /// Overwrite an existing file.
    #[arg(long)]
    pub force: bool,
    /// Ask nothing; what is not given and has no default is an error.
    #[arg(long)]
    pub yes: bool,
}

/// Kinds of sensors.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum NewSensor {
    /// An ATI Net F/T box.
    Netft,
    /// The sensor in the flange of an e-Series arm.
    Ur,
    /// A WrenchStamped that another program publishes.
    Topic,
    /// None: the arm (a Franka) estimates the wrench from its joints.
    Joints,
}

/// Reads `N,NM`.
fn ranges(text: &str) -> Result<(f64, f64)> {
    let (force, torque) = text
        .split_once(',')
        .context("two numbers, force in N and torque in Nm, for instance 50,10")?;
    let (force, torque): (f64, f64) = (force.trim().parse()?, torque.trim().parse()?);
    ensure!(
        force > 0.0 && torque > 0.0 && force.is_finite() && torque.is_finite(),
        "both numbers are above 0"
    );
    Ok((force, torque))
}
