//! The grammar of the command line, and its help text. One file per verb.

mod bench;
mod calibrate;
mod cell;
mod check;
mod completions;
mod doctor;
mod endpoint;
mod estimator;
mod evaluate;
mod faults;
mod keys;
mod model;
mod param;
mod region;
mod report;
mod robot;
mod run;
mod scan;
mod seconds;
mod status;
mod task;
mod teach;
#[cfg(test)]
mod tests;
mod topic;
mod ui;
mod up;

use std::path::PathBuf;

use clap::{Parser, Subcommand};

pub use bench::{Bench, BenchRole};
pub use calibrate::{CalibrateCommand, CalibratePayload, POSES};
pub use cell::{CellCommand, NewCell, NewSensor};
pub use check::Check;
pub use completions::Completions;
pub use doctor::Doctor;
pub use estimator::{Compare, EstimatorCommand};
pub use evaluate::{Evaluate, Reproduce};
pub use faults::Faults;
pub use keys::{KeysCommand, NewKeys};
pub use model::ModelCommand;
pub use param::ParamCommand;
pub use region::{Region, RegionPattern};
pub use report::Report;
pub use robot::RobotCommand;
pub use run::{Record, Run};
pub use scan::Scan;
pub use status::{Health, Status};
pub use task::TaskCommand;
pub use teach::Teach;
pub use topic::{Echo, Hz, TopicCommand};
pub use ui::{Ui, UiRole};
pub use up::Up;

/// Keep a robot's tool pressed on a surface of unknown shape.
#[derive(Debug, Parser)]
#[command(name = "tangent", version, arg_required_else_help = true)]
pub struct Cli {
    /// The command.
    #[command(subcommand)]
    pub command: Command,

    /// Print one JSON object on standard output instead of text.
    #[arg(long, global = true)]
    pub json: bool,

    /// The cell's configuration file; without it, the built-in simulated cell. For `report`, also a
    /// cell's name.
    #[arg(long, global = true, value_name = "FILE", env = "TANGENT_CELL")]
    pub cell: Option<PathBuf>,

    /// Router of the cell, in place of `zenoh.connect` in the cell file; may be repeated. Only for
    /// commands that talk to a running cell.
    #[arg(long, global = true, value_name = "ENDPOINT", value_parser = endpoint::endpoint)]
    pub connect: Vec<String>,

    /// Identity of this process on a network with certificates, as in `tangent keys list`; by
    /// default the one for the services that it runs.
    #[arg(long, global = true, value_name = "NAME")]
    pub identity: Option<String>,
}

/// The commands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Run the whole system against the simulator on this machine: approach, wipe, retract, record
    /// and report.
    Up(Up),
    /// Run one or more services in this process.
    Run(Run),
    /// Start, pause, resume or stop the cell's task.
    #[command(subcommand)]
    Task(TaskCommand),
    /// List estimators, compare them, and switch to another one.
    #[command(subcommand)]
    Estimator(EstimatorCommand),
    /// Set the force sensor's zero; the tool must hang free.
    Tare {
        /// State that you have checked that the tool hangs free. Overrides evidence of contact, but
        /// not a controller that moves or presses.
        #[arg(long)]
        clear: bool,
    },
    /// Measure the values that the cell file states about the sensor.
    #[command(subcommand)]
    Calibrate(CalibrateCommand),
    /// Show a path by hand: the arm is guided, points and strokes are taken with keys, and a task
    /// file is written.
    Teach(Teach),
    /// Let the depth camera see a surface, and write its points for `region`.
    Scan(Scan),
    /// Make a task of a region of a mesh or a scan: strokes whose distances are measured along the
    /// surface.
    Region(Box<Region>),
    /// Read or set live parameters.
    #[command(subcommand)]
    Param(ParamCommand),
    /// Serve the operator's page: the cell in a browser, with its commands.
    Ui(Ui),
    /// Show what is published on the cell's bus: topics, their messages and rates.
    #[command(subcommand)]
    Topic(TopicCommand),
    /// Show the cell's services, rates, ages and faults.
    Status(Status),
    /// Check the health of services. Exit code 0 if all are healthy, else 1.
    Health(Health),
    /// Record every topic of the cell until Ctrl-C.
    Record(Record),
    /// Evaluate a recording: print its figures, and write a page with plots.
    Report(Report),
    /// Manage certificates and access rules for the network of one or more cells.
    #[command(subcommand)]
    Keys(KeysCommand),
    /// Run a scenario in a closed loop without hardware or network, faster than real time.
    Evaluate(Evaluate),
    /// Reproduce a paper's tables, beside the published ones.
    Reproduce(Reproduce),
    /// Provoke faults on a private simulated cell, and measure when each is detected and when the
    /// arm is safe.
    Faults(Faults),
    /// Check whether this machine can run the cell: scheduling, memory, kernel, network, ports,
    /// disk, clock, robot and sensor. Prints what to do about each problem.
    Doctor(Doctor),
    /// Write cell files.
    #[command(subcommand)]
    Cell(CellCommand),
    /// Check files offline for everything that would be refused later: cells, tasks, scenarios and
    /// robot models. Exit code 0 or 2.
    Check(Check),
    /// Change the robot's modes: leave a protective stop, switch power, restart the bridge's
    /// program.
    #[command(subcommand)]
    Robot(RobotCommand),
    /// List robot models, show one, or check them against reference values.
    #[command(subcommand)]
    Model(ModelCommand),
    /// Measure times on this machine: single steps, messages over the bus, or requests.
    #[command(subcommand)]
    Bench(Bench),
    /// Print the completions of this command for a shell.
    Completions(Completions),
}

impl Command {
    /// Whether the command talks to a running cell, so that `--connect` has a meaning.
    pub fn talks_to_a_cell(&self) -> bool {
        match self {
            Self::Scan(args) => args.recording.is_none(),
            Self::Run(_)
            | Self::Task(_)
            | Self::Estimator(_)
            | Self::Tare { .. }
            | Self::Calibrate(_)
            | Self::Teach(_)
            | Self::Param(_)
            | Self::Ui(_)
            | Self::Topic(_)
            | Self::Status(_)
            | Self::Health(_)
            | Self::Record(_)
            | Self::Robot(_)
            | Self::Doctor(_) => true,
            Self::Up(_)
            | Self::Region(_)
            | Self::Report(_)
            | Self::Keys(_)
            | Self::Evaluate(_)
            | Self::Reproduce(_)
            | Self::Faults(_)
            | Self::Cell(_)
            | Self::Check(_)
            | Self::Model(_)
            | Self::Bench(_)
            | Self::Completions(_) => false,
        }
    }

    /// Whether the command has a result only from the services of a running cell.
    pub fn asks_a_cell(&self) -> bool {
        // These bring services of their own, look at the machine, or read a recording.
        let has_its_own = match self {
            Self::Run(_) | Self::Ui(_) | Self::Record(_) | Self::Doctor(_) => true,
            Self::Scan(args) => args.recording.is_some(),
            _ => false,
        };
        self.talks_to_a_cell() && !has_its_own
    }
}
