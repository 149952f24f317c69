//! Reasons why a check cannot be made, or why a start is refused beforehand.

use tangent_compose::ComposeError;
use tangent_runtime::ConfigError;
use tangent_simulated_cell::SimulatedCellError;

/// The user has to change the command or a file that it names.
#[derive(Debug, thiserror::Error)]
pub enum CheckError {
    /// The cell file on which tasks are to be checked cannot be used.
    #[error("{0}")]
    Cell(ConfigError),
    /// The cell's arm model cannot be used.
    #[error(transparent)]
    Model(#[from] ComposeError),
    /// The cell's scenario cannot be used.
    #[error("{0}")]
    Scenario(SimulatedCellError),
    /// The start does not fit the arm.
    #[error("--start has {given} joint positions; arm {arm} has {wanted}")]
    Start {
        /// Number of joint positions given.
        given: usize,
        /// Name of the arm.
        arm: String,
        /// Number of joints of the arm.
        wanted: usize,
    },
    /// The scenario's plant cannot be built.
    #[error("{0}")]
    Plant(String),
    /// A service refuses the cell.
    #[error("{0}")]
    CellRefused(String),
    /// The controller refuses the task.
    #[error("task: {0}")]
    TaskRefused(String),
}
