//! Reasons why a part of a cell does not run.

use std::error::Error;
use std::io;
use std::path::PathBuf;

use tangent_mechanics::ModelError;
use tangent_runtime::BusError;

/// A part of a cell cannot be started, or has failed. The cause is the error's source.
#[derive(Debug, thiserror::Error)]
pub enum ComposeError {
    /// No arm model of this name is built in.
    #[error("[robot] model: {0}")]
    ModelName(ModelError),
    /// The model file cannot be read, or is not a model.
    #[error("robot model {path}: {reason}")]
    ModelFile {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// A service or simulator refuses the cell file, or the scenario.
    #[error("{0}")]
    Refused(String),
    /// No service has this name.
    #[error("there is no service \"{0}\"")]
    UnknownService(String),
    /// The system cannot start another thread.
    #[error("starting the thread of {what}")]
    Thread {
        /// Purpose of the thread.
        what: &'static str,
        /// Error of the operating system.
        source: io::Error,
    },
    /// The service has failed.
    #[error("{name}")]
    Failed {
        /// Its name.
        name: &'static str,
        /// The error with which it ended.
        source: Box<dyn Error + Send + Sync>,
    },
    /// The bus refuses.
    #[error(transparent)]
    Bus(#[from] BusError),
}

impl ComposeError {
    /// Whether the user has to change the cell file or the command. Every other error is a failure
    /// of the machine or of a device.
    pub fn is_usage(&self) -> bool {
        match self {
            Self::ModelName(_) | Self::ModelFile { .. } => true,
            Self::Refused(_) | Self::UnknownService(_) => true,
            Self::Thread { .. } | Self::Failed { .. } | Self::Bus(_) => false,
        }
    }

    pub(crate) fn refused(error: impl std::fmt::Display) -> Self {
        Self::Refused(error.to_string())
    }
}

/// Formats an error and all its causes in one line.
pub fn with_causes(error: &dyn Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        text.push_str(": ");
        text.push_str(&error.to_string());
        cause = error.source();
    }
    text
}
