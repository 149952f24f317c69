//! Reasons why something cannot be measured.

use std::error::Error;
use std::io;
use std::path::PathBuf;
use std::time::Duration;

use tangent_faults::FaultsError;
use tangent_runtime::{BusError, ConfigError};

/// A measurement cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum BenchError {
    /// A process cannot be started.
    #[error("starting {command}")]
    Start {
        /// The command.
        command: String,
        /// Error of the operating system.
        source: io::Error,
    },
    /// There is no free port.
    #[error("finding a free port")]
    Port(#[source] io::Error),
    /// Standard input cannot be read.
    #[error("waiting for the end of standard input")]
    StandardInput(#[source] io::Error),
    /// The folder of a private cell cannot be removed.
    #[error("removing {folder}")]
    Remove {
        /// The folder.
        folder: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
    /// The other end of the bus does not answer.
    #[error("{name}: no answer within {:.1} s", .within.as_secs_f64())]
    NoAnswer {
        /// What was measured.
        name: String,
        /// Time allowed for an answer.
        within: Duration,
    },
    /// The measuring thread panicked.
    #[error("the measuring thread panicked; this is a defect")]
    Panicked,
    /// The measured system does not behave as required; the text says how.
    #[error("{0}")]
    Failed(String),
    /// A built-in scenario does not run, which is a defect.
    #[error(transparent)]
    Fixture(#[from] Box<dyn Error + Send + Sync>),
    /// The bus refuses, or no service answers.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The file of the private cell cannot be read.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The private cell fails.
    #[error(transparent)]
    Cell(#[from] FaultsError),
}
