//! Why a scenario cannot be played, or a cell cannot be simulated.

use std::io;
use std::path::PathBuf;

use tangent_compose::ComposeError;
use tangent_mechanics::ModelError;
use tangent_runtime::ConfigError;
use tangent_runtime::config::{Law, RobotDriver};
use tangent_simulation::ScenarioError;

/// A scenario cannot be read or played, or a cell cannot be simulated with it.
#[derive(Debug, thiserror::Error)]
pub enum SimulatedCellError {
    /// No scenario of this name is built in, and there is no such file.
    #[error("scenario \"{name}\": not built in{suggestion} ({known}), and as a file: {reason}")]
    NoScenario {
        /// Name or path as given.
        name: String,
        /// The built-in name that was perhaps meant, in words; empty if none is near.
        suggestion: String,
        /// The built-in names.
        known: String,
        /// Why it cannot be read as a file.
        reason: io::Error,
    },
    /// The scenario, or an override of one of its keys, is bad.
    #[error("{0}")]
    Scenario(ScenarioError),
    /// The scenario's arm is not built in.
    #[error("{0}")]
    ArmName(ModelError),
    /// The scenario's arm does not have the joints that its system needs.
    #[error("arm")]
    Arm(#[source] ModelError),
    /// The cell's law or arm is not that of the scenario.
    #[error(
        "cell {cell}: [controller] law = \"{law}\" and [robot] driver = \"{driver}\" do not fit the scenario {scenario}, \
         which is for law \"{scenario_law}\" and driver \"{scenario_driver}\": choose another with --scenario, or leave \
         it out to run the cell's own"
    )]
    Mismatch {
        /// The cell's name.
        cell: String,
        /// The cell's law.
        law: Law,
        /// The protocol of the cell's arm.
        driver: RobotDriver,
        /// The scenario's name.
        scenario: String,
        /// The law that the scenario is for.
        scenario_law: Law,
        /// The protocol of the scenario's arm.
        scenario_driver: RobotDriver,
    },
    /// The cell's arm is a model file of the user's own, which no simulator supports.
    #[error(
        "cell {cell}: robot.model_file = {file}: only built-in arms can be simulated; name one of them as robot.model, or \
         run the cell's services with `tangent run` against the real arm"
    )]
    OwnArm {
        /// The cell's name.
        cell: String,
        /// The model file.
        file: PathBuf,
    },
    /// A port would be too high.
    #[error("--port-offset {by}: must keep every port below 65536; 0 to 16383 is allowed")]
    PortOffset {
        /// Added to every port.
        by: u16,
    },
    /// The cell file as it would run is refused.
    #[error("{0}")]
    Cell(ConfigError),
    /// A shipped cell file is not TOML, which is a defect.
    #[error("{file}")]
    Shipped {
        /// The file.
        file: &'static str,
        /// Error of the parser.
        source: toml::de::Error,
    },
    /// A value cannot be written as TOML, which is a defect.
    #[error("writing {key}")]
    Write {
        /// Dotted name of the key.
        key: String,
        /// Error of the writer.
        source: toml::ser::Error,
    },
    /// The folder of the recordings cannot be listed.
    #[error("listing recordings in {folder}")]
    Recordings {
        /// The folder.
        folder: PathBuf,
        /// Error of the system.
        source: io::Error,
    },
    /// The recorder ran, but left no file.
    #[error("no recording was written to {folder}")]
    NoRecording {
        /// The folder.
        folder: PathBuf,
    },
    /// A service or a simulated device does not run.
    #[error(transparent)]
    Compose(#[from] ComposeError),
}

impl SimulatedCellError {
    /// Whether the command, the scenario or the cell file has to be changed. Everything else is a
    /// failure of the machine, or a defect.
    pub fn is_usage(&self) -> bool {
        match self {
            Self::NoScenario { .. } | Self::Scenario(_) | Self::ArmName(_) => true,
            Self::Mismatch { .. } | Self::OwnArm { .. } => true,
            Self::PortOffset { .. } | Self::Cell(_) => true,
            Self::Arm(_) | Self::Shipped { .. } | Self::Write { .. } => false,
            Self::Recordings { .. } | Self::NoRecording { .. } => false,
            Self::Compose(error) => error.is_usage(),
        }
    }
}
