//! The grammar of the command line, and its help text. One file per verb.

mod bench;
mod calibrate;
mod check;
mod doctor;
mod estimator;
mod evaluate;
mod faults;
mod keys;
mod model;
mod param;
mod report;
mod robot;
mod run;
mod seconds;
mod status;
mod task;
#[cfg(test)]
mod tests;
mod up;

use std::path::PathBuf;

use clap::{Parser, Subcommand};

pub use bench::{Bench, BenchRole};
pub use calibrate::{CalibrateCommand, CalibratePayload};
pub use check::Check;
pub use doctor::Doctor;
pub use estimator::{Compare, EstimatorCommand};
pub use evaluate::{Evaluate, Reproduce};
pub use faults::Faults;
pub use keys::{KeysCommand, NewKeys};
pub use model::ModelCommand;
pub use param::ParamCommand;
pub use report::Report;
pub use robot::RobotCommand;
pub use run::{Record, Run};
pub use status::{Health, Status};
pub use task::TaskCommand;
pub use up::Up;

/// Keep a robot's tool pressed on a surface nobody has modelled.
#[derive(Debug, Parser)]
#[command(name = "tangent", version, arg_required_else_help = true)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,

    /// Print one JSON object on standard output instead of words.
    #[arg(long, global = true)]
    pub json: bool,

    /// The cell's configuration file; the built-in simulated cell if none is named. For `report`
    /// also a cell's name.
    #[arg(long, global = true, value_name = "FILE", env = "TANGENT_CELL")]
    pub cell: Option<PathBuf>,

    /// Who this process is on a network with certificates, as in `tangent keys list`; by default
    /// what it runs says it.
    #[arg(long, global = true, value_name = "NAME")]
    pub identity: Option<String>,
}

/// The commands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Run the whole system against the simulator on this machine: approach, wipe, retract,
    /// recording and report.
    Up(Up),
    /// Run one or more services in this process.
    Run(Run),
    /// Start, pause, resume or stop the cell's task.
    #[command(subcommand)]
    Task(TaskCommand),
    /// See who publishes normals, and choose whose are used.
    #[command(subcommand)]
    Estimator(EstimatorCommand),
    /// Set the force sensor's zero: the tool must hang free.
    Tare {
        /// You have looked: the tool hangs free. Overrides what speaks against it, but not a
        /// controller that moves or presses.
        #[arg(long)]
        clear: bool,
    },
    /// Measure what the cell file has to say about the sensor.
    #[command(subcommand)]
    Calibrate(CalibrateCommand),
    /// Read or set live parameters.
    #[command(subcommand)]
    Param(ParamCommand),
    /// Services, rates, ages and faults of the cell.
    Status(Status),
    /// Ask whether services are well: exit code 0 when all are, else 1.
    Health(Health),
    /// Record every topic of the cell until Ctrl-C.
    Record(Record),
    /// Read a recording: figures, and a page with plots.
    Report(Report),
    /// Certificates and access rules for the network of one or more cells.
    #[command(subcommand)]
    Keys(KeysCommand),
    /// Run a scenario in a closed loop without hardware or network, faster than real time.
    Evaluate(Evaluate),
    /// Reproduce a paper's tables beside ours.
    Reproduce(Reproduce),
    /// Provoke every failure on a private simulated cell, and measure who notices when, and when
    /// the arm is safe.
    Faults(Faults),
    /// Can this machine do it? Scheduling, memory, kernel, network, ports, disk, clock, robot and
    /// sensor, and what to do.
    Doctor(Doctor),
    /// Check files offline, with everything that would be refused later: cells, tasks, scenarios
    /// and robot models. Exit code 0 or 2.
    Check(Check),
    /// The robot's own modes: leave a protective stop, power, the bridge's program.
    #[command(subcommand)]
    Robot(RobotCommand),
    /// Robot models: list them, show one, or check them against reference values.
    #[command(subcommand)]
    Model(ModelCommand),
    /// Measure on this machine: each step by itself, or messages over the bus.
    #[command(subcommand)]
    Bench(Bench),
}
