//! Reasons why a cell file is not written.

use std::path::PathBuf;

/// The file is not written.
#[derive(Debug, thiserror::Error)]
pub enum NewCellError {
    /// There is no such arm.
    #[error("robot model \"{model}\" is not built in{suggestion}; there are: {known}")]
    Model {
        /// The name given.
        model: String,
        /// Names the nearest one, or empty.
        suggestion: String,
        /// All built-in arms.
        known: String,
    },
    /// The arm has no such sensor.
    #[error("sensor \"{sensor}\" does not fit robot model \"{model}\": use {allowed}")]
    Sensor {
        /// Name of the sensor.
        sensor: &'static str,
        /// Name of the arm.
        model: String,
        /// Sensors that fit.
        allowed: String,
    },
    /// The file exists.
    #[error("{} exists: name another file, or overwrite it with --force", file.display())]
    Exists {
        /// The file.
        file: PathBuf,
    },
    /// The cell would be refused.
    #[error("the answers make no cell:\n  {}", errors.join("\n  "))]
    Refused {
        /// Errors, each with key, value and what is allowed.
        errors: Vec<String>,
    },
    /// The file cannot be written.
    #[error("{}: {source}", file.display())]
    Write {
        /// The file.
        file: PathBuf,
        /// Reason of the system.
        source: std::io::Error,
    },
}

impl NewCellError {
    /// Whether the user has to change the answers.
    pub fn is_usage(&self) -> bool {
        !matches!(self, Self::Write { .. })
    }
}
