//! `tangent check`.

use std::path::PathBuf;

use clap::Args;

/// Options of `tangent check`.
#[derive(Debug, Args)]
pub struct Check {
    /// Cells, tasks, scenarios, robot models, in any order. A task is checked on the cell that
    /// --cell names.
    #[arg(required = true)]
    pub files: Vec<PathBuf>,
    /// Kind of the files; by default it is recognised by their keys.
    #[arg(long, value_enum)]
    pub kind: Option<FileKind>,
    /// Joint positions from which tasks start, rad, from base to flange, separated by commas; by
    /// default those of the scenario that the cell simulates. Reach and workspace are checked only
    /// if a start is known.
    #[arg(
        long,
        value_name = "Q1,Q2,...",
        value_delimiter = ',',
        allow_hyphen_values = true
    )]
    pub start: Vec<f64>,
}

/// Kinds of files.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum FileKind {
    /// A cell: robot, sensor, tool, limits, network.
    Cell,
    /// A task: force, path, estimators.
    Task,
    /// A scenario of the simulator.
    Scenario,
    /// A robot model.
    Model,
}

impl From<FileKind> for tangent_check::FileKind {
    fn from(kind: FileKind) -> Self {
        match kind {
            FileKind::Cell => Self::Cell,
            FileKind::Task => Self::Task,
            FileKind::Scenario => Self::Scenario,
            FileKind::Model => Self::Model,
        }
    }
}
