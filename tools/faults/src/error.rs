//! Reasons why a fault cannot be provoked or measured.

use std::io;

use tangent_compose::ComposeError;
use tangent_recorder::RecorderError;
use tangent_runtime::{BusError, ConfigError};
use tangent_simulation::ScenarioError;

/// Result of this crate's functions.
pub type Result<T> = std::result::Result<T, FaultsError>;

/// A private cell cannot be started, or does not do what a fault or its measurement needs.
#[derive(Debug, thiserror::Error)]
pub enum FaultsError {
    /// The user has to change the command: what is wrong, and what is allowed.
    #[error("{0}")]
    Usage(String),
    /// The cell, or this machine, did not behave as the measurement needs.
    #[error("{0}")]
    Failed(String),
    /// A step failed; the source says why.
    #[error("{step}")]
    Step {
        /// The step that failed.
        step: String,
        /// Why it failed.
        source: Box<FaultsError>,
    },
    /// The operating system refuses.
    #[error(transparent)]
    Io(#[from] io::Error),
    /// A system call failed.
    #[error(transparent)]
    System(#[from] nix::Error),
    /// The bus refuses, or no service answers.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The cell file of the private cell is invalid.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The cell file of the private cell is not TOML.
    #[error(transparent)]
    Toml(#[from] toml::de::Error),
    /// The scenario of the private cell is invalid.
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
    /// The simulator failed.
    #[error(transparent)]
    Compose(#[from] ComposeError),
    /// A recording cannot be read.
    #[error(transparent)]
    Recording(#[from] RecorderError),
}

/// Names the step that failed.
pub(crate) trait Context<T> {
    /// Wraps the error as the source of an error with the text `step`.
    fn context(self, step: impl Into<String>) -> Result<T>;

    /// Wraps the error as the source of an error whose text is created only when needed.
    fn with_context(self, step: impl FnOnce() -> String) -> Result<T>;
}

impl<T, E: Into<FaultsError>> Context<T> for std::result::Result<T, E> {
    fn context(self, step: impl Into<String>) -> Result<T> {
        self.with_context(|| step.into())
    }

    fn with_context(self, step: impl FnOnce() -> String) -> Result<T> {
        self.map_err(|error| FaultsError::Step {
            step: step(),
            source: Box::new(error.into()),
        })
    }
}

impl<T> Context<T> for Option<T> {
    fn context(self, step: impl Into<String>) -> Result<T> {
        self.ok_or_else(|| FaultsError::Failed(step.into()))
    }

    fn with_context(self, step: impl FnOnce() -> String) -> Result<T> {
        self.ok_or_else(|| FaultsError::Failed(step()))
    }
}

/// Returns an error that describes the missing behaviour of the cell.
macro_rules! bail {
    ($($words:tt)*) => {
        return Err($crate::error::FaultsError::Failed(format!($($words)*)))
    };
}
pub(crate) use bail;
